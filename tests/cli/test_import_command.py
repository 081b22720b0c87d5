"""`hts import` and `hts data`: suggest, dry run and picture, runs of one file, recordings that go together, and use."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from hts.channels import Channel
from hts.cli.main import main
from hts.contracts import LogOnlyRobot, RobotSpec
from hts.recordings import RecordingStore
from hts.recordings.on_schedule import NOT_STATED
from hts.testing.known_signals import known_heat

STEPS = np.arange(600)


@pytest.fixture
def lab(tmp_path, monkeypatch, capsys):
    """lab(*arguments) -> exit code, lines on stdout, lines on stderr; a two-joint machine and its csv are there."""
    limits = {"torque_limit": (20.0, 20.0), "velocity_limit": (30.0, 30.0), "position_limit": ((-3.0, 3.0),) * 2}
    channels = [Channel("effort", "N*m", (2,)), Channel("rate", "rad/s", (2,)), Channel("base_velocity", "m/s", (3,))]

    class Registry:
        robot = LogOnlyRobot(RobotSpec.log_only("hinge", ("hip", "knee"), **limits, rate_hz=50), channels)

        def make_robot(self, name):
            return self.robot

        def make_log_reader(self, name, settings=None):
            from hts import builtin

            return getattr(builtin, f"make_{name}")({})

        def make_objective(self, name, settings=None):
            from hts.testing.known_signals import KnownHeat

            return KnownHeat()

    monkeypatch.setattr("hts.plugins.load", Registry)
    monkeypatch.chdir(tmp_path)
    random = np.random.default_rng(0)
    torque = random.normal(size=(600, 2))
    rows = [
        f"{20 * s},{a:.4f},{b:.4f},{3 + a * a + b * b:.4f},{s // 200}" for s, (a, b) in zip(STEPS, torque, strict=True)
    ]
    (tmp_path / "log.csv").write_text("t,tau_hip,tau_knee,watts,run\n" + "\n".join(rows) + "\n")
    mapping = {
        "time": {"column": "t", "unit": "ms"},
        "rate_hz": 50,
        "joints": {"hip": "hip", "knee": "knee"},
        "channels": {
            "effort": {"columns": "tau_{joint}", "unit": "N*m", "per_joint": True},
            "rate": {"columns": "tau_{joint}", "unit": "rad/s", "per_joint": True},
            "heat": {"columns": "watts", "unit": "W", "idle": 1.9},
        },
    }

    def run(*arguments, **changes):
        (tmp_path / "m.yaml").write_text(yaml.safe_dump({**mapping, **changes}))
        capsys.readouterr()
        code = main([str(one) for one in arguments])
        captured = capsys.readouterr()
        return code, captured.out.splitlines(), captured.err.splitlines()

    run.channels = mapping["channels"]
    return run


IMPORT = ["import", "log.csv", "--robot", "hinge"]
STORE = [*IMPORT, "--mapping", "m.yaml", "--to", "s.zarr"]
CHANNELS = ["--target", "heat", "--input", "effort", "--input", "rate"]


def test_a_suggestion_is_printed_and_stores_nothing(lab, tmp_path):
    code, out, _ = lab(*IMPORT, "--suggest")
    assert code == 0 and out[0].startswith("# Suggested for log.csv and robot hinge.")
    given = yaml.safe_load("\n".join(out))
    assert given["channels"]["joint_torque"]["columns"] == "tau_{joint}"
    assert given["channels"]["watts"]["unit"] == "W"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.csv", "m.yaml"]


def test_an_import_for_an_objective_says_what_logs_without_a_speed_are_not_good_for(lab, tmp_path):
    code, _, err = lab(*STORE, "--dry-run", "--objective", "cool")
    said = (
        "note: the log has no 'base_velocity', so nothing tells the forward speed. A fit and first data do without it;"
    )
    assert code == 0 and err == [f"{said} what compares policies or holds a speed needs it."]
    assert lab(*STORE, "--dry-run")[2] == []  # whoever names no objective asks for nothing
    rows = (tmp_path / "log.csv").read_text().splitlines()
    sides = ",vx,vy,vz", *(f",{0.1 * np.sin(s):.3f},{0.1 * np.cos(s):.3f},{0.01 * np.sin(3 * s):.3f}" for s in STEPS)
    (tmp_path / "log.csv").write_text("\n".join(a + b for a, b in zip(rows, sides, strict=True)) + "\n")
    speed = {"base_velocity": {"columns": ["vx", "vy", "vz"], "unit": "m/s"}}
    assert lab(*STORE, "--dry-run", "--objective", "cool", channels={**lab.channels, **speed})[::2] == (0, [])


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_a_dry_run_draws_what_would_be_stored_and_stores_nothing(lab, tmp_path, ending):
    code, out, err = lab(*STORE, "--dry-run", "--figure", f"p.{ending}")
    assert (code, err) == (0, [])
    assert out[0].startswith("not stored  log.csv: 12.00 s at 50 Hz, effort, heat, rate") and out[1] == f"p.{ending}"
    assert not (tmp_path / "s.zarr").exists()
    whole = (tmp_path / f"p.{ending}").read_bytes()
    assert len(whole) > 5000 and {"png": b"\x89PNG", "svg": b"<svg", "pdf": b"%PDF"}[ending] in whole[:2000]


def test_the_picture_shows_the_values(lab, tmp_path):
    """Another log, another picture: the line of the gauge moves."""
    lab(*STORE, "--dry-run", "--figure", "a.png")
    lab(*STORE, "--dry-run", "--figure", "b.png")
    (tmp_path / "log.csv").write_text((tmp_path / "log.csv").read_text().replace(",3.", ",4."))
    lab(*STORE, "--dry-run", "--figure", "c.png")
    a, b, c = ((tmp_path / f"{name}.png").read_bytes() for name in "abc")
    assert a == b != c


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (IMPORT, "--mapping M.yaml is needed; `hts import FILE --robot R --suggest > M.yaml` begins one"),
        ([*IMPORT, "--mapping", "m.yaml"], "--to STORE is needed, or --dry-run"),
        ([*STORE, "--figure", "s.zarr/p.png"], "--figure s.zarr/p.png: is inside of the store "),
        ([*STORE, "--dry-run", "--figure", "s.zarr/deep/../p.png"], "Choose a place outside of it."),
        ([*STORE, "--figure", "p.doc"], "expected a name that ends in .png, .svg, .pdf"),
        (["import", "none.csv", "--robot", "hinge", "--suggest"], "none.csv: cannot be read"),
    ],
)
def test_what_is_missing_is_one_line(lab, arguments, expected):
    code, _, err = lab(*arguments)
    assert code == 2 and len(err) == 1 and expected in err[0]
    assert not Path("s.zarr").exists()


def test_a_picture_inside_of_any_store_is_refused(lab, tmp_path):
    assert lab(*STORE)[0] == 0
    before = sorted(tmp_path.rglob("*"))
    for figure in ("s.zarr/p.png", f"s.zarr/{RecordingStore('s.zarr').ids()[0]}/p.png"):
        code, _, err = lab(*IMPORT, "--mapping", "m.yaml", "--to", "other.zarr", "--figure", figure)
        assert code == 2 and len(err) == 1 and f"is inside of the store {tmp_path}/s.zarr" in err[0]
    assert sorted(tmp_path.rglob("*")) == before


def test_runs_of_one_file_become_recordings(lab):
    code, out, _ = lab(*STORE, runs={"column": "run"})
    assert code == 0 and [line.split("run_run ")[1][0] for line in out] == ["0", "1", "2"]
    assert len(RecordingStore("s.zarr").ids()) == 3


def test_recordings_that_do_not_go_together_are_refused_and_nothing_is_stored(lab):
    assert lab(*STORE)[0] == 0
    (before,) = RecordingStore("s.zarr").ids()
    for changes, expected in (
        ({"rate_hz": 25}, "log.csv: it has 25 Hz, but s.zarr: its recording"),
        (
            {"channels": {"heat": {"columns": "watts", "unit": "V", "idle": 1.9}}},
            "its 'heat' is in V, but s.zarr: its recording",
        ),
    ):
        code, _, err = lab(*STORE, **changes)
        assert code == 2 and len(err) == 1 and expected in err[0], err
        assert RecordingStore("s.zarr").ids() == (before,)


def test_a_lag_is_shown(lab):
    assert lab(*STORE)[0] == 0
    code, out, _ = lab("data", "lag", "s.zarr", "--objective", "cool")
    assert code == 0 and out[0].startswith("'heat' is late by 0 s (0 to 0 s fit as well), R² 1.00")
    found = json.loads("\n".join(lab("data", "lag", "s.zarr", "--objective", "cool", "--json")[1]))
    assert found["seconds"] == 0.0 and found["r2"] > 0.99


def test_lag_and_verdict_need_no_objective(lab):
    assert lab(*STORE)[0] == 0
    told = [lab("data", "lag", "s.zarr", *which)[1] for which in (("--objective", "cool"), CHANNELS)]
    assert told[0] == told[1]
    code, out, _ = lab("data", "enough", "s.zarr", *CHANNELS)
    assert code == 1 and "missing: record 108 s more: there are 12 s, expected 120" in out
    for which, expected in (
        ((), "Say what to predict: --objective NAME, or --target CHANNEL with --input CHANNEL."),
        (("--objective", "cool", *CHANNELS), "--target and --input go without an objective"),
        (("--target", "heat"), "--target heat: say what to predict it from"),
        (("--target", "heet", "--input", "effort"), "No channel named 'heet'. Did you mean 'heat'?"),
    ):
        code, _, err = lab("data", "lag", "s.zarr", *which)
        assert code == 2 and len(err) == 1 and expected in err[0], err
    for which, expected in (
        ((*CHANNELS, "--input", "rate"), "--input rate: is there twice, expected each channel once"),
        ((*CHANNELS, "--speed", "nan"), "--speed nan: expected a number, m/s"),
    ):
        code, _, err = lab("data", "enough", "s.zarr", *which)
        assert code == 2 and len(err) == 1 and expected in err[0], err


def test_a_verdict_says_what_is_missing_and_exits_with_1(lab):
    assert lab(*STORE)[0] == 0
    code, out, _ = lab("data", "enough", "s.zarr", "--objective", "cool", "--speed", "0.5")
    assert code == 1 and out[-1] == "Not enough for a model to trust."
    assert "missing: record 108 s more: there are 12 s, expected 120" in out
    assert any("no policy is named" in line for line in out)
    found = json.loads("\n".join(lab("data", "enough", "s.zarr", "--objective", "cool", "--json")[1]))
    assert found["enough"] is False and found["seconds"] == 12.0


@pytest.mark.parametrize("named", [["--objective", "cool"], CHANNELS])
def test_a_verdict_without_stated_speeds_exits_with_0_and_with_3_where_one_is_asked_about(lab, tmp_path, named):
    """Three policies of known heat, 120 s each, as of a machine that has no commanded speed."""
    store = RecordingStore(tmp_path / "s.zarr", create=True)
    for seed, (policy, gait) in enumerate((("a", 0.8), ("b", 1.0), ("c", 1.3))):
        store.write(known_heat(seed, policy, seconds=120.0, gait=gait, notes={"schedule": NOT_STATED}))
    code, out, _ = lab("data", "enough", "s.zarr", *named)
    assert code == 0 and out[0].endswith("speeds not stated (recording.schedule in the mapping)")
    assert out[-1] == "Enough: nothing is missing."
    code, out, _ = lab("data", "enough", "s.zarr", *named, "--speed", "0.5")
    assert code == 3 and out[-1] == "Nothing is missing of what can be told."
    assert out[-2].startswith("cannot be said: whether there are 20 s at 0.5: 360 s")
    code, out, _ = lab("data", "enough", "s.zarr", *named, "--speed", "0.5", "--json")
    assert code == 3 and json.loads("\n".join(out))["enough"] is None


def test_what_was_commanded_is_listed_only_where_somebody_stated_it(lab):
    assert lab(*STORE)[0] == 0
    _, out, _ = lab("data", "ls", "s.zarr")
    assert "  not stated  " in out[1] and "speeds m/s" in out[0]
    (one,) = RecordingStore("s.zarr").ids()
    _, out, _ = lab("data", "show", "s.zarr", one)
    assert "  schedule: commands not stated" in out
    stood = {"schedule": {"commands": [{"seconds": 12, "vx": 0}]}}
    assert lab(*STORE[:-1], "t.zarr", recording=stood)[0] == 0
    _, out, _ = lab("data", "ls", "t.zarr")
    assert "  0  " in out[1] and "not stated" not in out[1]


def test_a_store_is_exported_and_imported_again(lab, tmp_path):
    assert lab(*STORE, runs={"column": "run"})[0] == 0
    code, out, _ = lab("data", "export", "s.zarr", "--to", "set", "--state", "effort", "--action", "rate")
    assert code == 0 and out == ["set: 3 episodes"]
    back = {
        "effort": {"columns": "observation.effort[{joint}]", "unit": "N*m", "per_joint": True},
        "heat": {"columns": "observation.heat", "unit": "W", "idle": 1.9},
    }
    (tmp_path / "m.yaml").write_text("")
    arguments = ["import", "set", "--robot", "hinge", "--mapping", "m.yaml", "--to", "t.zarr"]
    code, out, err = lab(*arguments, reader="lerobot", channels=back, time={"column": "timestamp", "unit": "s"})
    assert code == 0 and len(out) == 3, err
    first, again = RecordingStore("s.zarr"), RecordingStore("t.zarr")
    sums = [sorted(float(s.read(one).values("heat").sum()) for one in s.ids()) for s in (first, again)]
    np.testing.assert_allclose(*sums, rtol=1e-6)
    code, _, err = lab("data", "export", "s.zarr", "--to", "set")
    assert code == 2 and "set: exists already" in err[0]
