"""`hts import` and `hts data` on a log of two joints: what is stored, said and refused."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from two_joint_log import TWO_JOINTS, a_log, a_mapping

from hts.channels import Channel
from hts.cli import data, import_
from hts.cli.main import main
from hts.contracts import Robot
from hts.errors import ConfigError, HtsError, RecordingError
from hts.recordings import RecordingStore
from hts.recordings.csv_reader import make


class OneRobot:
    """A registry with one robot and the csv reader."""

    def make_robot(self, name: str) -> Robot:
        assert name == "logger"
        return TWO_JOINTS

    def make_objective(self, name: str) -> Any:
        channels = {
            "save": (Channel("draw", "mA"),),
            "haste": (Channel("draw", "m/s"),),
            "each": (Channel("draw", "A", (2,)),),
            "own": (Channel("joint_torque", "N*cm", (2,)),),
            "plain": (Channel("draw", "A"),),
        }
        return SimpleNamespace(name=name, inputs=("joint_torque",), real_channels=channels[name])

    def make_log_reader(self, name: str) -> Any:
        assert name == "csv"
        return make({})


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setattr("hts.plugins.load", OneRobot)
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(a_mapping()))
    return tmp_path


def hts_import(folder: Path, *files: Path, drop: list[str] | None = None) -> None:
    import_.command(list(files), "logger", folder / "m.yaml", folder / "data.zarr", drop)


def test_import_stores_one_recording_a_file_and_again_changes_nothing(
    commands: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [f"{20 * i},{i},{i},{-500 * i}" for i in range(10)]
    files = [a_log(commands), a_log(commands, rows, name="other.csv")]
    hts_import(commands, *files)
    hts_import(commands, *files)
    output = capsys.readouterr().out
    assert len(RecordingStore(commands / "data.zarr").ids()) == 2
    assert output.count("(was there already)") == 2
    assert "other.csv: 0.20 s at 50 Hz, draw, joint_torque" in output


def test_a_log_that_is_shorter_than_its_schedule_is_taken_and_told(
    commands: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ten samples at 50 Hz; up to half a second may be missing."""
    stated = {"schedule": {"commands": [{"seconds": 0.6, "vx": 0.5}]}}
    (commands / "m.yaml").write_text(yaml.safe_dump(a_mapping(recording=stated)))
    hts_import(commands, a_log(commands))
    assert capsys.readouterr().err == (
        "note: log.csv ends before its schedule does: 0.20 s of 0.6 s. What is missing counts for nothing. "
        "If a log was not copied whole, copy and import it again.\n"
    )
    stated["schedule"]["commands"][0]["seconds"] = 0.22
    (commands / "m.yaml").write_text(yaml.safe_dump(a_mapping(recording=stated)))
    hts_import(commands, a_log(commands))
    assert "ends before its schedule" not in capsys.readouterr().err


def test_import_stores_nothing_if_one_of_the_files_is_refused(commands: Path) -> None:
    bad = a_log(commands, [f"{20 * i},{i},{i},58" for i in range(10)], name="bad.csv")
    with pytest.raises(
        RecordingError, match=r"bad.csv: 'draw' is -0.058 A in all 10 samples.*--drop draw\. Nothing was stored"
    ):
        hts_import(commands, a_log(commands), bad)
    assert not (commands / "data.zarr").exists()


def test_every_refused_file_of_a_batch_is_named(commands: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = a_log(commands, [f"{20 * i},{i},{i},58" for i in range(10)], name="bad.csv")
    short = a_log(commands, ["0,1,1,1"], name="short.csv")
    with pytest.raises(RecordingError, match=r"^2 of 3 logs are refused, see above\. Nothing was stored"):
        hts_import(commands, bad, a_log(commands), short)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2 and "bad.csv: 'draw' is" in lines[0] and "short.csv: 1 rows with data" in lines[1]
    assert not (commands / "data.zarr").exists()


def test_a_pipe_is_refused_and_not_waited_for(commands: Path) -> None:
    os.mkfifo(commands / "pipe.csv")
    with pytest.raises(RecordingError, match=r"pipe.csv: a pipe or a device, expected a file"):
        hts_import(commands, commands / "pipe.csv")


def test_the_line_of_an_import_says_that_the_robots_order_was_taken(
    commands: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hts_import(commands, a_log(commands))
    assert "joint_order" not in capsys.readouterr().out
    listed = {"joint_torque": {"columns": ["H_tau", "K_tau"], "unit": "N*m"}}
    (commands / "m.yaml").write_text(yaml.safe_dump(a_mapping(channels=listed, joints=None)))
    hts_import(commands, commands / "log.csv")
    assert "[schedule not stated in the mapping; no joint_order: columns taken in the robot's, hip, knee]" in (
        capsys.readouterr().out
    )


def test_what_a_terminal_would_obey_is_written_as_escapes(commands: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [f"{20 * i},{i},{i},{-500 * i}" for i in range(10)]
    hts_import(commands, a_log(commands, rows, name="a\x1b[2J\udcff.csv"))
    shown = capsys.readouterr().out
    assert r"a\x1b[2J\udcff.csv: 0.20 s" in shown and "\x1b" not in shown
    store = commands / "data.zarr"
    assert main(["data", "show", str(store), RecordingStore(store).ids()[0][:8]]) == 0
    assert "\x1b" not in capsys.readouterr().out
    bad = a_log(commands, [*rows[:4], "80,4,\x1b]0;mine\x07high,3"], name="b.csv")
    assert main(["import", str(bad), "--robot", "logger", "--mapping", str(commands / "m.yaml"), "--to", "x"]) == 2
    said = capsys.readouterr().err
    assert r"\x1b]0;mine\x07high" in said and "\x1b" not in said


def test_a_channel_can_be_dropped_and_a_misspelt_one_is_named(commands: Path) -> None:
    bad = a_log(commands, [f"{20 * i},{i},{i},58" for i in range(10)])
    hts_import(commands, bad, drop=["draw"])
    store = RecordingStore(commands / "data.zarr")
    (recording_id,) = store.ids()
    assert list(store.read(recording_id).channels) == ["joint_torque"]
    with pytest.raises(ConfigError, match="--drop: No channel named 'drew'. Did you mean 'draw'"):
        hts_import(commands, bad, drop=["drew"])


def test_data_lists_shows_compares_and_validates(commands: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hts_import(
        commands, a_log(commands), a_log(commands, [f"{20 * i},{i},{i},{-500 * i}" for i in range(10)], name="b.csv")
    )
    path = commands / "data.zarr"
    first, second = RecordingStore(path).ids()
    capsys.readouterr()
    assert main(["data", "ls", str(path)]) == 0
    assert capsys.readouterr().out.count("logger") == 2
    assert main(["data", "show", str(path), first[:8]]) == 0
    shown = capsys.readouterr().out
    assert "joint hip: kp 20 N*m/rad" in shown and "draw" in shown
    assert main(["data", "compare", str(path), first, second]) == 0
    assert "mean 1" in capsys.readouterr().out
    assert main(["data", "validate", str(path)]) == 0
    assert "2 recordings, all whole" in capsys.readouterr().out
    (path / first / "draw" / "c" / "0").write_bytes(b"short")
    assert main(["data", "validate", str(path)]) == 2
    assert f"{first}/draw: damaged" in capsys.readouterr().out


def test_data_says_what_it_cannot_find(tmp_path: Path) -> None:
    with pytest.raises(HtsError, match="no recording store"):
        data.ls(tmp_path)
    RecordingStore(tmp_path / "s.zarr", create=True)
    with pytest.raises(HtsError, match="recording named 'abc'"):
        data.show(tmp_path / "s.zarr", "abc")


# -------------------------------------------------------------------------------------- what was commanded


def import_with(folder: Path, schedule: list[dict[str, float]], name: str = "log.csv", **facts: Any) -> None:
    """`hts import` of a log of 10 s with a schedule of these commands."""
    facts = {**facts, "schedule": {"commands": schedule}}
    (folder / "m.yaml").write_text(yaml.safe_dump(a_mapping(recording=facts)))
    hts_import(folder, a_log(folder, [f"{20 * i},{i % 7},{i % 5},{-1000 * (i % 9)}" for i in range(500)], name=name))


@pytest.mark.parametrize(
    ("schedule", "facts", "words"),
    [
        ([{"seconds": 2, "vx": 0.5}, {"seconds": 3, "vx": 0.8}], {}, "10.00 s, its recording.schedule 5 s: what was"),
        (
            [{"seconds": 5, "vx": 0.5}, {"seconds": 4, "vx": 0.8}],
            {"fell": True},
            "10.00 s, its recording.schedule 9 s: what",
        ),
        ([{"seconds": 100, "vx": 0.5}], {}, ".* 100 s: so it ends before its commands do.*recording.fell: true"),
    ],
)
def test_a_schedule_of_another_length_than_the_log_is_refused(
    commands: Path, schedule: list[dict[str, float]], facts: dict[str, Any], words: str
) -> None:
    with pytest.raises(RecordingError, match=f"log.csv: the log lasts {words}.*Nothing was stored") as refused:
        import_with(commands, schedule, **facts)
    assert "\n" not in str(refused.value) and not (commands / "data.zarr").exists()


@pytest.mark.parametrize(
    ("schedule", "name", "facts"),
    [
        ([{"seconds": 5, "vx": 0.5}, {"seconds": 5.4, "vx": 0.8}], "log.csv", {}),
        ([{"seconds": 5, "vx": 0.5}, {"vx": 0.8}], "log.csv", {}),
        ([{"seconds": 30, "vx": 0.5}], "log.csv", {"fell": True}),
        ([{"seconds": 30, "vx": 0.5}], ".00.csv.partial", {}),
    ],
)
def test_a_log_that_is_cut_at_a_fall_or_a_crash_or_by_hand_is_taken(
    commands: Path, schedule: list[dict[str, float]], name: str, facts: dict[str, Any]
) -> None:
    import_with(commands, schedule, name, **facts)
    assert len(RecordingStore(commands / "data.zarr").ids()) == 1


def test_each_run_of_a_file_is_held_against_the_schedule_and_named(commands: Path) -> None:
    rows = [f"{20 * i},{i % 7},{i % 5},{-1000 * (i % 9)},{1 + (i >= 150)}" for i in range(250)]
    file = a_log(commands, rows, header="t,K_tau,H_tau,amps,trial")
    mapping = a_mapping(runs={"column": "trial"}, recording={"schedule": {"commands": [{"seconds": 3, "vx": 0.5}]}})
    (commands / "m.yaml").write_text(yaml.safe_dump(mapping))
    with pytest.raises(RecordingError, match=r"log.csv \(run_trial 2\): the log lasts 2.00 s"):
        hts_import(commands, file)


def test_dropping_the_channel_that_an_order_was_for_drops_the_order(commands: Path) -> None:
    channels = {**a_mapping()["channels"], "joint_torque": {"columns": "1..2", "unit": "N*m"}}
    channels["draw"]["columns"] = 3
    given = a_mapping(channels=channels, header=False, time={"column": 0, "unit": "ms"}, joint_order=["knee", "hip"])
    (commands / "m.yaml").write_text(yaml.safe_dump(given))
    hts_import(commands, a_log(commands, header=""), drop=["joint_torque"])
    store = RecordingStore(commands / "data.zarr")
    assert list(store.read(store.ids()[0]).channels) == ["draw"]


# ----------------------------------------------------------------------------------- units of an objective


def test_an_objectives_unit_is_converted_to_with_the_idle_level(
    commands: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The mapping says A; the objective measures mA."""
    store = commands / "data.zarr"
    import_.command([a_log(commands)], "logger", commands / "m.yaml", store, objective=["save"])
    (recording_id,) = RecordingStore(store).ids()
    recording = RecordingStore(store).read(recording_id)
    assert recording.channels["draw"].channel.unit == "mA" and recording.idle == {"draw": 1500.0}
    assert recording.values("draw").tolist() == pytest.approx([1000.0 * i for i in range(10)])
    assert "units_converted draw A to mA" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("objectives", "words"),
    [
        (["haste"], "m.yaml: 'draw' is in A, objective 'haste' needs m/s: .*different quantities. Correct its unit"),
        (["each"], r"m.yaml: 'draw' has shape \(\), objective 'each' needs \(2,\)"),
        (["own"], r"'joint_torque' is in N\*m for the robot, objective 'own' needs N\*cm. They cannot share"),
        (["plain", "save"], "'draw' is in A for objective 'plain', objective 'save' needs mA. They cannot share"),
        (["save", "plain"], "'draw' is in mA for objective 'save', objective 'plain' needs A. They cannot share"),
    ],
)
def test_a_unit_that_an_objective_cannot_use_is_refused_also_before_anything_is_stored(
    commands: Path, objectives: list[str], words: str
) -> None:
    for to, dry in ((None, True), (commands / "data.zarr", False)):
        with pytest.raises(ConfigError, match=words) as refused:
            import_.command([a_log(commands)], "logger", commands / "m.yaml", to, None, objectives, dry)
        assert "\n" not in str(refused.value)
    assert not (commands / "data.zarr").exists()


def test_the_idle_level_of_one_of_the_robots_channels_is_converted_as_its_values_are(commands: Path) -> None:
    torque = {"columns": "{joint}_tau", "unit": "N*cm", "idle": 5.0, "limits": [-99, 99]}
    (commands / "m.yaml").write_text(yaml.safe_dump(a_mapping(channels={"joint_torque": torque})))
    hts_import(commands, a_log(commands))
    store = RecordingStore(commands / "data.zarr")
    assert store.read(store.ids()[0]).idle == {"joint_torque": pytest.approx(0.05)}


def test_what_an_objective_measures_is_real_and_said_so_before_a_log_is_read(commands: Path) -> None:
    mapping = a_mapping()
    del mapping["channels"]["draw"]["idle"]
    (commands / "m.yaml").write_text(yaml.safe_dump(mapping))
    nowhere, to = commands / "nowhere.csv", commands / "new.zarr"
    with pytest.raises(ConfigError, match="m.yaml: Mapping: .* named 'draw'.*give its `idle` level"):
        import_.command([nowhere], "logger", commands / "m.yaml", to)
    mapping["channels"]["draw"]["real"] = False
    (commands / "m.yaml").write_text(yaml.safe_dump(mapping))
    with pytest.raises(ConfigError, match="m.yaml: channels.draw: says real: false, but objective 'plain' measures it"):
        import_.command([nowhere], "logger", commands / "m.yaml", to, objective=["plain"])
    with pytest.raises(RecordingError, match="nowhere.csv: cannot be read"):
        import_.command([nowhere], "logger", commands / "m.yaml", to)


def test_import_names_the_mapping_that_lies_beside_a_log(commands: Path) -> None:
    log = a_log(commands)
    with pytest.raises(ConfigError, match=r"--suggest > M.yaml` begins one\.$"):
        import_.command([log], "logger", None, commands / "data.zarr")
    (commands / "mappings").mkdir()
    beside = commands / "mappings" / f"{log.stem}.yaml"
    beside.write_text("{}")
    with pytest.raises(ConfigError, match=rf"log\.csv has one beside it: --mapping {beside}\.$"):
        import_.command([log], "logger", None, commands / "data.zarr")
