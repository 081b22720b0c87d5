"""What log readers are made of: a reader in a few lines, and its parts one by one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hts.channels import Channel
from hts.errors import ConfigError, PluginError, RecordingError
from hts.recordings.csv_reader import make
from hts.recordings.logs import (
    check_idle,
    check_limits,
    common_grid,
    recording_from_columns,
    resampled,
    samples_of,
    table_of,
)
from hts.recordings.recording import Series
from hts.recordings.samples import interpolated


def json_columns(path: Path) -> dict[str, list]:
    """One JSON object a line."""
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return {name: [row.get(name) for row in rows] for name in rows[0]}


def json_log(path: Path, count: int = 20) -> Path:
    rows = [{"t": 1000 + 20 * i, "H_tau": -i / 2, "K_tau": i / 2, "amps": 2.0 + i / 10} for i in range(count)]
    path.write_text("\n".join(map(json.dumps, rows)))
    return path


# ---------------------------------------------------------------------------------------------- a reader in a few lines


def test_columns_and_a_mapping_are_a_reader(tmp_path, two_joints, mapping):
    log = json_log(tmp_path / "walk.jsonl")
    recording = recording_from_columns([log], mapping, two_joints, json_columns)
    steps = np.arange(20)
    np.testing.assert_allclose(recording.time, steps / 50)
    np.testing.assert_allclose(recording.values("joint_torque"), np.stack([-steps, steps], 1) / 2)
    np.testing.assert_allclose(recording.values("draw"), 2 + steps / 10, rtol=1e-6)
    assert recording.idle == {"draw": 1.5} and recording.notes["source"] == "walk.jsonl"


@pytest.mark.parametrize("given", [[{"t": 0.0}, {"t": 0.02}], None])
def test_rows_instead_of_columns_are_one_short_line(tmp_path, two_joints, mapping, given):
    with pytest.raises(PluginError) as refused:
        recording_from_columns([tmp_path / "walk.jsonl"], mapping, two_joints, lambda path: given)
    said = str(refused.value)
    assert f"gives its columns as a {type(given).__name__}, expected a mapping" in said and len(said) < 300


def test_such_a_reader_and_ours_for_csv_give_the_same(tmp_path, two_joints, mapping):
    log = json_log(tmp_path / "walk.jsonl")
    columns = json_columns(log)
    columns["amps"][7] = None
    csv = tmp_path / "walk.csv"
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join("" if v is None else repr(v) for v in row) for row in rows)]
    csv.write_text("\n".join(lines) + "\n")
    mine = recording_from_columns([log], mapping, two_joints, lambda path: columns)
    ours = make({}).read([csv], mapping, two_joints)
    for name in ("joint_torque", "draw"):
        assert np.array_equal(mine.values(name), ours.values(name))
    assert mine.notes | {"source": ""} == ours.notes | {"source": ""}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("t,tau\n", "not a log that the reader 'jsonl' knows (JSONDecodeError"),
        ("", "not a log that the reader 'jsonl' knows (IndexError"),
        ('{"t": 1}\n{"t": 2}', "No column named 'H_tau'"),
        ('{"t": 1, "H_tau": "a", "K_tau": 0, "amps": 1}', "column 'H_tau' does not hold numbers"),
        ('{"t": "noon", "H_tau": 1, "K_tau": 0, "amps": 1}', "time column 't' does not hold numbers"),
        ('{"t": [1], "H_tau": 1, "K_tau": 0, "amps": 1}', "time column 't' does not hold numbers"),
    ],
)
def test_what_such_a_reader_cannot_read_is_one_line_with_the_file(tmp_path, two_joints, mapping, text, expected):
    log = tmp_path / "walk.jsonl"
    log.write_text(text)
    with pytest.raises(RecordingError) as refused:
        recording_from_columns([log], {**mapping, "reader": "jsonl"}, two_joints, json_columns)
    assert str(refused.value).startswith(f"{log}: ") and expected in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_reader_is_only_asked_for_where_the_mapping_names_none(tmp_path, two_joints, mapping):
    log = tmp_path / "walk.jsonl"
    log.write_text("")
    unnamed = {key: value for key, value in mapping.items() if key != "reader"}
    with pytest.raises(RecordingError, match=r"Repair the file, or name its reader in the mapping\.$"):
        recording_from_columns([log], unnamed, two_joints, json_columns)
    with pytest.raises(RecordingError, match=r"Repair the file\.$"):
        recording_from_columns([log], {**unnamed, "reader": "jsonl"}, two_joints, json_columns)


def test_a_missing_file_and_a_wrong_mapping_are_told_apart(tmp_path, two_joints, mapping):
    with pytest.raises(RecordingError, match=r"none.jsonl: cannot be read \(No such file"):
        recording_from_columns([tmp_path / "none.jsonl"], mapping, two_joints, json_columns)
    with pytest.raises(ConfigError, match="there is no key 'rate'"):
        recording_from_columns([tmp_path / "none.jsonl"], {**mapping, "rate": 3}, two_joints, json_columns)


def test_dates_are_stamps_in_nanoseconds():
    start = np.datetime64("2026-03-01T12:00:00", "ns")
    columns = {"t": start + np.arange(3) * np.timedelta64(20_000_001, "ns"), "x": [1.0, 2.0, 3.0]}
    table = table_of(Path("log"), "t", "iso", ["x"], columns)
    assert np.diff(table.stamps).tolist() == [20_000_001, 20_000_001]
    with pytest.raises(RecordingError, match="say unit: iso for dates and times"):
        table_of(Path("log"), "t", "ms", ["x"], columns)
    with pytest.raises(RecordingError, match="does not hold dates and times"):
        table_of(Path("log"), "x", "iso", ["x"], columns)


# -------------------------------------------------------------------------------------------------------- the parts


def test_irregular_times_come_to_an_even_grid_where_all_have_data():
    slow = samples_of("a", [0.0, 0.1, 0.2, 0.3], [0.0, 1.0, 2.0, 3.0], "log")
    late = samples_of("b", np.arange(0.05, 0.30, 0.01), np.arange(25.0), "log")
    grid = common_grid({"a": slow, "b": late}, 10.0, 0.2)
    np.testing.assert_allclose(grid, [0.05, 0.15, 0.25])
    np.testing.assert_allclose(resampled(slow, grid, 10.0)[:, 0], [0.5, 1.5, 2.5])
    # over one period around each instant, cut at the first sample: a straight line's mean is its middle
    np.testing.assert_allclose(resampled(late, grid, 10.0, "mean")[:, 0], [2.5, 10.0, 19.5 - 0.5 * 0.0], atol=0.6)


def test_stamps_that_come_in_bursts_are_not_stretched_to_straight_lines():
    """As where each packet is stamped when it arrives: four rows at once every 80 ms, of a log of 50 Hz."""
    steps = np.arange(200)
    measured = steps / 50
    received = 0.08 * (steps // 4) + 0.0001 * (steps % 4)
    common_grid({"a": samples_of("a", measured, np.sin(steps), "log.csv")}, 50.0)
    lost = measured[steps % 5 != 3]
    common_grid({"a": samples_of("a", lost, lost, "log.csv")}, 50.0)
    with pytest.raises(
        RecordingError, match=r"147 of 197 samples of 'a'.*0.0001 s apart at the median and 0.0797 s at most"
    ):
        common_grid({"a": samples_of("a", received, np.sin(steps), "log.csv")}, 50.0)
    swapped = measured + 90.0 * (steps > 99)  # the battery, say
    with pytest.raises(RecordingError, match=r"nothing for 90 s.*two recordings of it \(runs: {gap_seconds: 1}\)"):
        common_grid({"a": samples_of("a", swapped, np.sin(steps), "log.csv")}, 50.0)
    with pytest.raises(RecordingError, match="4500 of 4700 samples.*90 s at most"):
        common_grid({"a": samples_of("a", swapped, np.sin(steps), "log.csv")}, 50.0, 120.0)


def test_instants_within_a_gap_are_counted_and_noted(tmp_path, two_joints, mapping):
    times = np.delete(np.arange(20) * 0.02, [5, 6, 11])  # 0.10, 0.12 and 0.22 s are lost
    gappy = samples_of("a", times, times, "log")
    assert interpolated(gappy, np.arange(20) * 0.02, 50.0) == 3
    assert interpolated(gappy, times, 50.0) == 0
    columns = {"t": times * 1000, "H_tau": times, "K_tau": times, "amps": 2 + times}
    recording = recording_from_columns([tmp_path], mapping, two_joints, lambda path: columns)
    assert recording.notes["samples_interpolated_in_gaps"] == "joint_torque 3, draw 3"


@pytest.mark.parametrize(
    ("times", "values", "expected"),
    [
        ([0.0, 0.1, 0.1], [1, 2, 3], "time does not increase at row 3 of 'a'"),
        ([0.0, 0.1], [1, 2, 3], "'a' has 3 rows for times of shape"),
        ([0.0, 0.1, 0.2], [1, np.inf, 3], "infinite values"),
        ([0.0, 0.1, 0.2], [1, np.nan, np.nan], "columns of 'a' hold no numbers"),
    ],
)
def test_samples_that_are_none_are_refused(times, values, expected):
    with pytest.raises(RecordingError, match=expected):
        samples_of("a", np.array(times), np.array(values), "log")


def test_seconds_read_as_milliseconds_are_noticed():
    """120 s at 50 Hz, said to be in ms: 0.12 s at 50 kHz."""
    squeezed = samples_of("a", np.arange(6000) * 2e-5, np.arange(6000), "log")
    with pytest.raises(RecordingError, match=r"logged at 5e\+04 Hz and lasts 0.12 s.*probably another \(time.unit\)"):
        common_grid({"a": squeezed}, 50.0)
    stretched = samples_of("a", np.arange(100) * 20.0, np.arange(100), "log")
    with pytest.raises(RecordingError, match="logged at 0.05 Hz.*unit of the stamps is probably another"):
        common_grid({"a": stretched}, 50.0)


def test_microseconds_read_as_milliseconds_are_noticed_in_a_log_that_is_to_be_thinned():
    """200 Hz, of which 50 Hz are wanted: 5000 us from row to row, said to be ms."""
    log = samples_of("a", np.arange(100) * 5.0, np.arange(100), "log")
    with pytest.raises(RecordingError, match=r"logged at 0.2 Hz.*probably another \(time.unit\); if not, set rate_hz"):
        common_grid({"a": log}, 50.0)
    slower = samples_of("a", np.arange(100) * 0.1, np.arange(100), "log")
    with pytest.raises(RecordingError, match=r"logged at 10 Hz.* Set rate_hz to 10 or less.*correct time.unit"):
        common_grid({"a": slower}, 50.0)


def current(median: float) -> dict[str, Series]:
    return {"draw": Series(Channel("draw", "A"), median + np.array([-0.1, 0.0, 0.1]) * abs(median))}


@pytest.mark.parametrize("median", [1.9, 0.5, 40.0])
def test_an_idle_level_of_the_same_size_passes(median):
    check_idle(current(median), {"draw": 1.9}, "log")


@pytest.mark.parametrize(
    ("median", "expected"),
    [(-6.0, "say sign: -1"), (6000.0, "mA are no A"), (0.006, "mA are no A")],
)
def test_an_idle_level_of_another_sign_or_unit_is_refused(median, expected):
    with pytest.raises(RecordingError, match=f"log: 'draw' is .* A at the median, its idle level 1.9 A.*{expected}"):
        check_idle(current(median), {"draw": 1.9}, "log")


def test_a_machine_that_gives_current_back_while_it_idles_is_counted_the_other_way():
    with pytest.raises(
        RecordingError, match=r"'draw' is -6 A at the median, its idle level -1.9 A. Both probably count"
    ):
        check_idle(current(-6.0), {"draw": -1.9}, "log")
    with pytest.raises(RecordingError, match=r"say sign: -1 and idle: 1\.9; if it is right, say so with `limits`"):
        check_idle(current(-6.0), {"draw": -1.9}, "log")
    warm = {"warmth": Series(Channel("warmth", "degC"), np.array([-6.0, -5.0, -4.0]))}
    check_idle(warm, {"warmth": -1.9}, "log")


@pytest.mark.parametrize("unit", ["A", "mA", "W"])
def test_whatever_is_drawn_is_counted_the_other_way_where_it_is_negative(unit):
    for level, expected in ((-3.0, "say sign: -1 and idle: 3"), (0.0, "say sign: -1; if")):
        with pytest.raises(RecordingError, match=expected):
            check_idle(walking(-6.0, unit), {"draw": level}, "log")
    check_idle(walking(0.0, unit), {"draw": 0.0}, "log")  # noise about nothing
    check_idle(walking(-6.0, unit, speed=0.5), {"draw": 0.0}, "log")  # it stands, and a sensor has an offset


def warmth(median: float, unit: str = "degC") -> dict[str, Series]:
    return {"warmth": Series(Channel("warmth", unit), np.array([median - 1, median, median + 1]))}


@pytest.mark.parametrize(
    ("median", "level", "unit"),
    [(-6, 1.9, "degC"), (25, 0.1, "degC"), (0.01, 20, "degC"), (85, 0, "degC"), (-20, 10, "degF")],
)
def test_the_ratio_of_two_temperatures_says_nothing(median, level, unit):
    check_idle(warmth(median, unit), {"warmth": level}, "log")


@pytest.mark.parametrize(("median", "level"), [(313, 22), (313, 0), (40, 295)])
def test_a_temperature_far_from_its_idle_level_is_in_another_unit(median, level):
    with pytest.raises(
        RecordingError, match=f"'warmth' is {median} degC at the median, its idle level {level} degC.*K"
    ):
        check_idle(warmth(median), {"warmth": level}, "log")


def walking(level: float, unit: str = "A", speed: float = 5.0, swing: float = 1.0) -> dict[str, Series]:
    """What is drawn, about `level`, while the fastest joint reaches `speed`, rad/s."""
    steps = np.arange(400)
    velocity = speed * np.stack([np.sin(steps / 3), np.cos(steps / 3)], 1)
    return {
        "draw": Series(Channel("draw", unit), level + swing * np.sin(steps / 5)),
        "joint_velocity": Series(Channel("joint_velocity", "rad/s", (2,)), velocity),
    }


@pytest.mark.parametrize(("unit", "scale"), [("A", 1), ("mA", 1000), ("W", 25)])
def test_an_idle_level_above_what_moving_draws_is_refused(unit, scale):
    with pytest.raises(RecordingError) as refused:
        check_idle(walking(9.9 * scale, unit, swing=scale), {"draw": 12.1 * scale}, "log")
    assert f"its idle level {12.1 * scale:g} {unit}. While the joints move 100% of its samples lie" in str(
        refused.value
    )
    assert str(refused.value).endswith("standing is not idle); if it is right, say so with `limits`.")


@pytest.mark.parametrize(
    ("channels", "level"),
    [
        (walking(9.9), 9.0),
        (walking(9.9, "V"), 12.1),  # a battery sags while one walks
        (walking(9.9, speed=0.1), 12.1),  # it stands, or lies
        (walking(9.9, swing=0.2), 10.5),  # too near: idle was measured on another day
        (walking(9.9, swing=8.0), 12.1),  # some of it is more than idle
        ({"draw": walking(9.9)["draw"]}, 12.1),  # nothing says that it moves
    ],
    ids=["less", "voltage", "standing", "near", "swings", "unknown"],
)
def test_an_idle_level_that_may_be_right_passes(channels, level):
    check_idle(channels, {"draw": level}, "log")


def test_milliamperes_in_a_csv_are_noticed_unless_limits_say_they_are_right(tmp_path, two_joints, mapping):
    log = json_log(tmp_path / "walk.jsonl")
    columns = json_columns(log)
    columns["amps"] = [1000 * value for value in columns["amps"]]
    with pytest.raises(RecordingError, match="'draw' is 2950 A at the median"):
        recording_from_columns([log], mapping, two_joints, lambda path: columns)
    mapping["channels"]["draw"]["limits"] = [0, 1e4]
    assert recording_from_columns([log], mapping, two_joints, lambda path: columns).num_samples == 20


def test_a_single_sample_that_no_machine_makes_is_refused(two_joints):
    values = np.random.default_rng(0).normal(size=(155_000, 2))
    velocity = Channel("joint_velocity", "rad/s", (2,))
    check_limits({"joint_velocity": Series(velocity, values)}, two_joints.spec, "log")
    values[77, 1] = 292_000
    with pytest.raises(
        RecordingError, match=r"of knee is 292000 rad/s in sample 77 \(1 such sample\), its limit is 30"
    ):
        check_limits({"joint_velocity": Series(velocity, values)}, two_joints.spec, "log")


def test_what_no_machine_makes_is_dropped_without_stated_limits_and_counted(tmp_path, two_joints, mapping):
    """20 N·m is the limit, 400 N·m is twenty times that."""
    columns = {"t": 20 * np.arange(400), "H_tau": np.sin(np.arange(400) / 9), "K_tau": np.cos(np.arange(400) / 9)}
    columns["amps"] = 3 + columns["H_tau"]
    columns["H_tau"][[7, 200]] = [292_000, -5000]
    del mapping["channels"]["draw"]["idle"]
    mapping["channels"]["draw"]["real"] = False
    with pytest.raises(RecordingError, match=r"broken rows are left out by `limits` and `outside: drop`"):
        recording_from_columns([tmp_path], mapping, two_joints, lambda path: columns)
    mapping["channels"]["joint_torque"]["outside"] = "drop"
    recording = recording_from_columns([tmp_path], mapping, two_joints, lambda path: columns)
    assert recording.notes["rows_outside_limits_dropped"] == "joint_torque 2"
    assert np.abs(recording.values("joint_torque")).max() <= 1.0
    mapping["channels"]["joint_torque"] |= {"unit": "N*cm"}
    columns["H_tau"][7] = 39_000  # 390 N·m: too much for the robot, not absurd
    mapping["channels"]["draw"]["outside"] = "drop"
    with pytest.raises(ConfigError, match="channel 'draw': `outside: drop` needs `limits`; the robot's own are"):
        recording_from_columns([tmp_path], mapping, two_joints, lambda path: columns)
    columns["H_tau"][20:60] = 1e6
    mapping["channels"]["draw"]["outside"] = "refuse"
    with pytest.raises(RecordingError, match=r"lies outside -40000 to 40000 N\*cm in 40 of 400 rows; at most 1% are"):
        recording_from_columns([tmp_path], mapping, two_joints, lambda path: columns)


# ------------------------------------------------------------------------------------------------------ csv dialects


def test_a_spreadsheets_csv_is_read(tmp_path, two_joints, mapping):
    """Text before the table, units below the names, semicolons, decimal commas, dates."""
    rows = [f"2026-03-01 12:00:00.{20 * i:03d};{-i / 2};{i / 2};{2 + i / 10}".replace(".", ",") for i in range(20)]
    rows = [row.replace(",", ".", 1) for row in rows]  # the date's own point
    text = ["Robot log", "made by a spreadsheet; v2", "t;H_tau;K_tau;amps", "-;N*m;N*m;A", *rows]
    log = tmp_path / "walk.csv"
    log.write_text("\n".join(text))
    mapping |= {"preamble": 2, "units_row": True, "delimiter": ";", "decimal": ","}
    mapping["time"]["unit"] = "iso"
    recording = make({}).read([log], mapping, two_joints)
    np.testing.assert_allclose(recording.values("draw"), 2 + np.arange(20) / 10, rtol=1e-6)
    np.testing.assert_allclose(recording.values("joint_torque")[:, 1], np.arange(20) / 2)


@pytest.mark.parametrize(
    ("text", "delimiter", "hint"),
    [
        ("t,H_tau,K_tau,amps\nms,N*m,N*m,A\n0,1,2,3\n20,1,2,4\n", ",", "say units_row: true"),
        ("t;H_tau;K_tau;amps\n0;1,5;2;3\n20;1,5;2;4\n", ";", 'say decimal: ","'),
        ("t H_tau K_tau amps\n0 1 2 3\n20 1 2 4\n", ",", 'say delimiter: " "'),
        ("made by me\nt,H_tau,K_tau,amps\n0,1,2,3\n20,1,2,4\n", ",", "say preamble: "),
        ("t,H_tau,K_tau,amps\n2026-03-01 12:00:00,1,2,3\n2026-03-01 12:00:01,1,2,4\n", ",", "say unit: iso"),
    ],
)
def test_a_dialect_that_the_mapping_does_not_state_is_named(tmp_path, two_joints, mapping, text, delimiter, hint):
    log = tmp_path / "walk.csv"
    log.write_text(text)
    with pytest.raises(RecordingError) as refused:
        make({}).read([log], {**mapping, "delimiter": delimiter}, two_joints)
    assert hint in str(refused.value) and "\n" not in str(refused.value)
