"""Logs become recordings: mapping, joint order, signs, gaps, resampling, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from two_joint_log import TWO_JOINTS, LogOnly, a_log, a_mapping, read

from hts.errors import ConfigError, RecordingError
from hts.recordings.mapping import assumed_order, load_mapping
from hts.recordings.resample import window_mean

# ------------------------------------------------------------------------------------------------- what is read


def test_columns_become_channels_in_the_robots_joint_order_with_sign_and_scale(tmp_path: Path) -> None:
    recording = read(a_log(tmp_path), a_mapping())
    steps = np.arange(10)
    np.testing.assert_allclose(recording.time, steps / 50)
    np.testing.assert_allclose(recording.values("joint_torque"), np.stack([-steps, steps], axis=1), atol=1e-5)
    np.testing.assert_allclose(recording.values("draw"), steps, atol=1e-5)
    assert recording.values("draw").shape == (10,)
    assert recording.idle == {"draw": 1.5}
    assert (recording.robot, recording.kp, recording.rate_hz) == ("logger", (20.0, 20.0), 50.0)


def test_a_logs_unit_is_converted_to_the_robots_and_its_limits_with_it(tmp_path: Path) -> None:
    torque = {"columns": "{joint}_tau", "unit": "N*cm", "limits": [-9.5, 9.5]}
    recording = read(a_log(tmp_path), a_mapping(channels={"joint_torque": torque}))
    assert recording.channels["joint_torque"].channel.unit == "N*m"
    np.testing.assert_allclose(recording.values("joint_torque")[:, 1], np.arange(10) / 100, atol=1e-7)
    with pytest.raises(RecordingError, match="the mapping allows -0.08 to 0.08"):
        read(a_log(tmp_path), a_mapping(channels={"joint_torque": {**torque, "limits": [-8, 8]}}))


def test_a_file_without_a_header_is_read_by_numbers_and_joint_order(tmp_path: Path) -> None:
    mapping = a_mapping(
        header=False,
        time={"column": 0, "unit": "ms"},
        joint_order=["knee", "hip"],
        channels={"joint_torque": {"columns": "1..2", "unit": "N*m"}},
    )
    recording = read(a_log(tmp_path, header=""), mapping)
    np.testing.assert_allclose(recording.values("joint_torque")[:, 1], np.arange(10), atol=1e-5)


def test_nanosecond_stamps_of_today_keep_their_precision(tmp_path: Path) -> None:
    """1.76e18 ns needs 61 bits; a double has 53 and would round to 256 ns."""
    start = 1_763_146_355_421_617_551
    rows = [f"{start + 10_000 * i},{i},{-i},{-1000 * i}" for i in range(20)]
    recording = read(a_log(tmp_path, rows), a_mapping(rate_hz=1e5, time={"column": "t", "unit": "ns"}))
    np.testing.assert_allclose(recording.values("draw"), np.arange(20), atol=1e-6)


def test_a_fast_irregular_log_is_resampled_to_the_stated_rate(tmp_path: Path) -> None:
    stamps = [0, 3, 10, 11, 20, 29, 33, 40, 47, 60, 75, 80]
    recording = read(a_log(tmp_path, [f"{t},{t / 10},{-t / 10},{-t}" for t in stamps]), a_mapping(rate_hz=50))
    np.testing.assert_allclose(recording.values("draw"), [0.0, 0.02, 0.04, 0.06, 0.08], atol=1e-6)


def test_the_mean_over_a_window_is_exact_for_straight_lines() -> None:
    """f(t) = 6t on irregular stamps: the mean over [t - 1/2, t + 1/2] is 6t; at the ends over half a window."""
    times = np.array([0.0, 0.3, 1.1, 2.0, 3.0])
    means = window_mean(times, 6 * times[:, None], np.array([0.0, 1.0, 2.0, 3.0]), 1.0)
    np.testing.assert_allclose(means[:, 0], [1.5, 6.0, 12.0, 16.5])


def test_a_mean_removes_what_interpolation_would_fold_down(tmp_path: Path) -> None:
    """A 50 Hz square wave logged at 1 kHz: every 20 ms the instants see one phase, the means see the average."""
    rows = [f"{t},{t},{-t},{-1000.0 * (t % 20 < 10) - t}" for t in range(400)]
    file = a_log(tmp_path, rows)
    robot = LogOnly(("hip", "knee"), torque=1000.0)
    mapping = a_mapping()
    instants = read(file, mapping, robot).values("draw")[2:-2]
    mapping["channels"]["draw"]["resample"] = "mean"
    means = read(file, mapping, robot).values("draw")[2:-2]
    ramp = 0.02 * np.arange(2, 18)
    assert np.all(instants - ramp > 0.99)
    np.testing.assert_allclose(means - ramp, 0.5, atol=0.01)


def test_empty_rows_are_dropped_and_short_gaps_filled_and_both_are_noted(tmp_path: Path) -> None:
    rows = [f"{20 * i},{i},{-i},{-1000 * i}" for i in range(10)]
    rows[4], rows[6] = "80,,,", "120,6,-6,"
    recording = read(a_log(tmp_path, ["0,,,", *rows[1:]]), a_mapping())
    np.testing.assert_allclose(recording.values("draw"), np.arange(1, 10), atol=1e-5)
    assert recording.notes["empty_rows_dropped"] == "2"
    assert recording.notes["incomplete_rows_filled"] == "draw 1"


def test_one_recording_may_be_spread_over_several_files(tmp_path: Path) -> None:
    state = a_log(tmp_path, name="run_state.csv")
    command = a_log(tmp_path, [f"{990 + 20 * i},{i / 10},{-i / 10}" for i in range(12)], "t,K_q,H_q", "run_command.csv")
    mapping = a_mapping(files={"state": "*state*", "command": "*command*"})
    for channel in mapping["channels"].values():
        channel["file"] = "state"
    mapping["channels"]["joint_target"] = {"columns": "{joint}_q", "unit": "rad", "file": "command"}
    recording = read([command, state], mapping)
    # state stamps begin 10 ms after the command's: targets are half a sample further on
    np.testing.assert_allclose(recording.values("joint_target")[:, 1], (np.arange(10) + 0.5) / 10, atol=1e-6)
    np.testing.assert_allclose(recording.values("draw"), np.arange(10), atol=1e-5)
    with pytest.raises(ConfigError, match=r"files.command: pattern '\*command\*' fits 0 of the files"):
        read([state], mapping)


def test_what_the_log_cannot_say_comes_from_the_mapping(tmp_path: Path) -> None:
    facts = {
        "policy_hash": "f00",
        "mass_kg": 12.0,
        "role": "reference",
        "session": "s",
        "block": 3,
        "schedule": {"commands": [{"seconds": 0.2, "vx": 0.5}]},
    }
    recording = read(a_log(tmp_path), a_mapping(recording=facts))
    assert (recording.policy_hash, recording.mass_kg, recording.role, recording.block) == ("f00", 12.0, "reference", 3)
    assert recording.schedule.commands[0].vx == 0.5


def test_a_last_command_without_seconds_lasts_until_the_log_ends(tmp_path: Path) -> None:
    """Ten samples at 50 Hz are 0.2 s, of which the first command takes 0.08."""
    commands: list[dict[str, float]] = [{"seconds": 0.08, "vx": 0.5}, {"vx": 0.8}]
    recording = read(a_log(tmp_path), a_mapping(recording={"schedule": {"commands": commands}}))
    assert [(one.seconds, one.vx) for one in recording.schedule.commands] == [(0.08, 0.5), (pytest.approx(0.12), 0.8)]
    for seconds in (0.2, 5.0, float("inf")):
        commands[0]["seconds"] = seconds
        with pytest.raises(RecordingError, match=r"log.csv: the log lasts 0.20 s, but in recording.schedule .* take "):
            read(a_log(tmp_path), a_mapping(recording={"schedule": {"commands": commands}}))


# -------------------------------------------------------------------------------------------------- what is refused


def bad_logs() -> dict[str, tuple[list[str] | None, dict[str, Any], str]]:
    rows = [f"{20 * i},{i},{-i},{-1000 * i}" for i in range(20)]
    torque = {"columns": "{joint}_tau", "unit": "N*m"}
    draw = {"columns": "amps", "unit": "A", "idle": 1.5}

    def channels(**one: Any) -> dict[str, Any]:
        return {"channels": {"joint_torque": torque, **one}}

    return {
        "long gap": (rows[:5] + rows[12:], {}, "has nothing for 0.16 s, from 0.080 s on; gaps up to 0.1 s are filled"),
        "slow log": (rows[::2], {}, "was logged at 25 Hz, the mapping wants 50"),
        "time goes back": (
            rows[:5] + rows[3:],
            {},
            "time does not increase in line 7 of the file: column 't' reads 80, then 60",
        ),
        "text": (
            [*rows[:4], "80,4,high,3", *rows[5:]],
            {},
            "column 'H_tau': line 6 of the file: CSV conversion error to double: invalid value 'high'",
        ),
        "infinite": ([*rows[:4], "80,4,inf,3", *rows[5:]], {}, "column 'H_tau' is infinite in line 6 of the file"),
        "ragged": ([*rows[:4], "80,4", *rows[5:]], {}, "line 6 of the file: Expected 4 columns, got 2"),
        "no stamp": (
            [*rows[:4], ",4,-4,-4000", *rows[5:]],
            {},
            "line 6 of the file has data but no time in column 't'",
        ),
        "empty column": ([f"{20 * i},{i},{-i}," for i in range(20)], {}, "columns of 'draw' (amps) hold no numbers"),
        "empty file": ([], {}, "no row of data stands in it. Copy the log again"),
        "no such column": (
            None,
            channels(draw={**draw, "columns": "amp"}),
            "No column named 'amp'. Did you mean 'amps'?",
        ),
        "constant": ([f"{20 * i},{i},{-i},58" for i in range(20)], {}, "'draw' is -0.058 A in all 20 samples"),
        "limits": (
            rows,
            channels(draw={**draw, "limits": [-5, 5]}),
            "runs from -19000 to 0 A, the mapping allows -5 to 5",
        ),
        "too strong": (
            [f"{20 * i},{30 + i % 2},{31 + i % 2},{-1000 * i}" for i in range(20)],
            {},
            (
                "'joint_torque' of hip runs from 31 to 32 N*m, beyond its limit (20), and 1 more joint likewise; "
                "whole numbers that hardly change, as temperatures do"
            ),
        ),
    }


@pytest.mark.parametrize("name", list(bad_logs()))
def test_a_bad_log_is_refused_in_one_line_that_names_the_file(tmp_path: Path, name: str) -> None:
    rows, changes, expected = bad_logs()[name]
    file = a_log(tmp_path, rows)
    with pytest.raises(RecordingError) as refused:
        read(file, a_mapping(**changes))
    assert str(refused.value).startswith(str(file))
    assert expected in str(refused.value)
    assert "\n" not in str(refused.value)


def test_files_that_are_no_tables_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot be read"):
        read(tmp_path / "none.csv", a_mapping())
    (tmp_path / "binary.csv").write_bytes(bytes(range(256)) * 20)
    (tmp_path / "nothing.csv").write_bytes(b"")
    for name in ("binary.csv", "nothing.csv"):
        with pytest.raises(RecordingError, match=name):
            read(tmp_path / name, a_mapping())
    twice = a_log(tmp_path, header="t,K_tau,K_tau,amps")
    with pytest.raises(RecordingError, match="two columns are named 'K_tau'"):
        read(twice, a_mapping(channels={"joint_torque": {"columns": ["K_tau", "t"], "unit": "N*m"}}))


def bad_mappings() -> dict[str, tuple[dict[str, Any], str]]:
    torque = {"columns": "{joint}_tau", "unit": "N*m"}
    return {
        "misspelt key": (a_mapping(rate_htz=50), "rate_htz: there is no key 'rate_htz'. Did you mean 'rate_hz'?"),
        "unknown unit": (a_mapping(channels={"joint_torque": {**torque, "unit": "Nm"}}), "No unit named 'Nm'"),
        "other unit": (a_mapping(channels={"joint_torque": {**torque, "unit": "N"}}), "'joint_torque' is in N*m"),
        "no idle": (a_mapping(channels={"draw": {"columns": "amps", "unit": "A"}}), "give its `idle` level"),
        "misspelt channel": (
            a_mapping(channels={"joint_torqe": torque}),
            "No channel of robot 'logger' named 'joint_torqe'. Did you mean 'joint_torque'? Known: joint_position",
        ),
        "no joints": (a_mapping(joints=None), "'joint_torque' uses {joint}; give `joints`"),
        "wrong joint": (a_mapping(joints={"hip": "H", "kne": "K"}), "No joint named 'kne'. Did you mean 'knee'"),
        "missing joint": (a_mapping(joints={"hip": "H"}), "joints: knee missing"),
        "too few columns": (
            a_mapping(channels={"joint_torque": {**torque, "columns": ["K_tau"]}}),
            "1 columns for 2 joints. List one per joint, 'K_tau[0..1]' where the column 'K_tau' holds lists, or say",
        ),
        "bad range": (a_mapping(channels={"joint_torque": {**torque, "columns": "2..1"}}), "are no range of numbers"),
        "another robot's joint order": (a_mapping(joint_order=["a", "b"]), "joint_order: No joint named 'a'."),
        "joint order of none": (a_mapping(joint_order=["knee", "hip"]), "joint_order has no effect: no channel's"),
        "schedule without a beginning": (
            a_mapping(recording={"schedule": {"commands": [{"vx": 0.5}, {"seconds": 1, "vx": 0.8}]}}),
            "recording.schedule.commands.0.seconds: this key is needed",
        ),
        "no time": ({k: v for k, v in a_mapping().items() if k != "time"}, "time: this key is needed"),
    }


@pytest.mark.parametrize("name", list(bad_mappings()))
def test_a_wrong_mapping_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    mapping, expected = bad_mappings()[name]
    with pytest.raises(ConfigError) as refused:
        read(a_log(tmp_path), mapping)
    assert expected in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_mapping_that_is_no_yaml_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot read this"):
        load_mapping(tmp_path / "none.yaml")
    for content in ("a: [", "- 1"):
        (tmp_path / "m.yaml").write_text(content)
        with pytest.raises(ConfigError, match="m.yaml"):
            load_mapping(tmp_path / "m.yaml")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("rate_hz: 50\nrate_hz: 100\n", "m.yaml:2: not YAML: the key 'rate_hz' was written before, in line 1"),
        ("a: " + "[" * 20_000, "more than 30 levels"),
        ("a: " + "{b: " * 20_000, "more than 30 levels"),
    ],
)
def test_a_mapping_with_a_key_twice_or_bottomless_nesting_is_refused(tmp_path: Path, text: str, expected: str) -> None:
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(ConfigError) as refused:
        load_mapping(tmp_path / "m.yaml")
    assert expected in str(refused.value) and "\n" not in str(refused.value)


def test_a_stretch_is_cut_out(tmp_path: Path) -> None:
    """0.06 to 0.14 s after the first stamp: samples 3 to 7."""
    recording = read(a_log(tmp_path), a_mapping(cut=[0.06, 0.14]))
    np.testing.assert_allclose(recording.values("draw"), np.arange(3, 8), atol=1e-5)
    assert recording.notes["cut"] == "0.06 to 0.14 s"
    with pytest.raises(
        RecordingError, match="nothing is left between 5 and 9 s after the first stamp; it lasts 0.18 s"
    ):
        read(a_log(tmp_path), a_mapping(cut=[5, 9]))
    with pytest.raises(ConfigError, match="its end must come after its beginning"):
        read(a_log(tmp_path), a_mapping(cut=[9, 5]))


def test_single_broken_rows_are_dropped_where_limits_say_so_and_counted(tmp_path: Path) -> None:
    rows = [f"{20 * i},{i / 10},{-i / 10},{-1000 * i}" for i in range(200)]
    rows[70] = "1400,7.0,-7.0,9e9"
    draw = {"columns": "amps", "unit": "A", "sign": -1, "scale": 0.001, "idle": 1.5, "limits": [-1, 500]}
    torque = {"columns": "{joint}_tau", "unit": "N*m"}
    mapping = a_mapping(channels={"joint_torque": torque, "draw": draw})
    file = a_log(tmp_path, rows)
    with pytest.raises(RecordingError, match="the mapping allows -1 to 500"):
        read(file, mapping)
    draw["outside"] = "drop"
    recording = read(file, mapping)
    np.testing.assert_allclose(recording.values("draw"), np.arange(200), atol=1e-4)
    assert recording.notes["rows_outside_limits_dropped"] == "draw 1"
    assert "incomplete_rows_filled" not in recording.notes
    draw["limits"] = [-1, 100]
    with pytest.raises(RecordingError, match=r"'draw' lies outside -1 to 100 A in 100 of 200 rows; at most 1% are"):
        read(file, mapping)
    del draw["limits"]
    with pytest.raises(ConfigError, match="`outside: drop` needs `limits`"):
        read(file, mapping)


@pytest.mark.parametrize(
    ("changes", "noted"),
    [
        ({"channels": {"joint_torque": {"columns": ["H_tau", "K_tau"], "unit": "N*m"}}, "joints": None}, True),
        ({"channels": {"joint_torque": {"columns": "1..2", "unit": "N*m"}}, "joint_order": ["knee", "hip"]}, False),
        ({"channels": {"draw": {"columns": "amps", "unit": "A", "idle": 1.5}}, "joints": None}, False),
        ({}, False),
    ],
)
def test_columns_that_are_listed_without_an_order_are_noted(changes: dict[str, Any], noted: bool) -> None:
    note = assumed_order(a_mapping(**changes), TWO_JOINTS.spec.joint_names)
    assert note == ("no joint_order: columns taken in the robot's, hip, knee" if noted else None)


# ------------------------------------------------------------------------------------------------ where it is


def four_joints(tmp_path: Path, last: Callable[[int], str]) -> tuple[Path, dict[str, Any], LogOnly]:
    """A log of four joints whose last column holds what `last` says of each of its 40 rows."""
    joints = ("a", "b", "c", "d")
    rows = [f"{20 * i},{i % 7},{i % 5},{i % 3},{last(i)}" for i in range(40)]
    channels = {"joint_torque": {"columns": "{joint}_tau", "unit": "N*m"}}
    file = a_log(tmp_path, rows, header="t,a_tau,b_tau,c_tau,d_tau")
    return file, a_mapping(channels=channels, joints={one: one for one in joints}), LogOnly(joints, torque=20.0)


def test_a_hole_is_named_by_the_columns_that_have_it(tmp_path: Path) -> None:
    hole = four_joints(tmp_path, lambda i: "nan" if 10 <= i < 20 else str(i % 4))
    with pytest.raises(RecordingError, match=r"'joint_torque' \(d_tau\) has nothing for 0.22 s, from 0.180 s on"):
        read(*hole)
    empty = four_joints(tmp_path, lambda i: "")
    with pytest.raises(RecordingError, match=r"columns of 'joint_torque' \(d_tau\) hold no numbers"):
        read(*empty)
    file, mapping, robot = four_joints(tmp_path, lambda i: "99" if 10 <= i < 20 else str(i % 4))
    mapping["channels"]["joint_torque"] |= {"limits": [-20, 20], "outside": "drop"}
    file.write_text(file.read_text() + "".join(f"{20 * i},{i % 7},{i % 5},{i % 3},{i % 4}\n" for i in range(40, 1100)))
    with pytest.raises(RecordingError, match=r"'joint_torque' \(d_tau\) has nothing for 0.22 s"):
        read(file, mapping, robot)


@pytest.mark.parametrize("cell", ["inf", "high"])
def test_a_bad_cell_is_named_by_its_column_and_the_line_of_the_file(tmp_path: Path, cell: str) -> None:
    """Two lines of text, one empty; the header, units, an empty line: the fifth row is line 10."""
    rows = [f"{20 * i},{i},{-i},{-1000 * i}" for i in range(10)]
    rows[4] = f"80,4,{cell},3"
    file = a_log(tmp_path, ["ms,N*m,N*m,mA", rows[0], "", *rows[1:]], header="of a walk\n\nt,K_tau,H_tau,amps")
    with pytest.raises(RecordingError) as refused:
        read(file, a_mapping(preamble=2, units_row=True))
    assert file.read_text().splitlines()[9] == rows[4]
    assert "column 'H_tau'" in str(refused.value) and "line 10 of the file" in str(refused.value)


@pytest.mark.parametrize(("between", "said"), [(";", ";"), ("\t", "\\t")])
def test_another_delimiter_is_told(tmp_path: Path, between: str, said: str) -> None:
    file = a_log(tmp_path)
    file.write_text(file.read_text().replace(",", between))
    with pytest.raises(RecordingError, match="No column named 't'") as refused:
        read(file, a_mapping())
    assert f'If "{said}" stands between columns, say delimiter: "{said}".' in str(refused.value)
    with pytest.raises(RecordingError, match="no column 3.") as refused:
        read(file, a_mapping(header=False, time={"column": 3, "unit": "ms"}))
    assert f'say delimiter: "{said}".' in str(refused.value)
    file.write_text(file.read_text().replace("1000", "1000,5"))
    with pytest.raises(RecordingError, match="Expected 1 columns") as refused:
        read(file, a_mapping())
    assert f'say delimiter: "{said}". If numbers have a decimal comma, say decimal: "," too.' in str(refused.value)


def test_a_channel_that_dies_ends_the_recording_and_the_notes_say_what_that_cost(tmp_path: Path) -> None:
    rows = [f"{20 * i},{i / 10},{-i / 10},{-1000 * i}" for i in range(100)]
    rows[20] = "400,2,-2,"
    rows[40:] = [f"{20 * i},{i / 10},{-i / 10}," for i in range(40, 100)]  # the supply's logger has stopped
    recording = read(a_log(tmp_path, rows), a_mapping())
    assert recording.num_samples == 40
    assert recording.notes["ends_before_last_stamp"] == "1.200000 s ('draw' ends first)"
    assert recording.notes["incomplete_rows_filled"] == "draw 1"  # those after the end are not filled, they are gone


def test_a_log_whose_channels_end_together_says_nothing_of_it(tmp_path: Path) -> None:
    recording = read(a_log(tmp_path, [f"{20 * i},{i},{-i},{-1000 * i}" for i in range(10)]), a_mapping())
    assert "ends_before_last_stamp" not in recording.notes
