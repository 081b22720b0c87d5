"""A stranger's objective, from its entry point to the end of a whole run.

The package below offers an objective that is measured on a twin by an instrument of its own, in a unit of its own.
Nothing in the core or in the other plugins knows of it.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from hts.testing.packages import write_package

PLUGIN = '''
"""An objective for tests: how hard the legs work, as a meter on the robot shows it."""

from hts import hookimpl

HTS_API = 2


@hookimpl
def hts_objectives(register):
    register("fake", make_objective)


@hookimpl
def hts_instruments(register):
    register("fake_meter", make_meter)


def make_objective(settings):
    """How hard the legs work."""
    from fake_objective.effort import FakeObjective, FakeSettings

    return FakeObjective(FakeSettings(**settings))


def make_meter(settings, robot):
    """A meter of the legs' work, slow by 0.1 s."""
    from fake_objective.effort import FakeMeter

    return FakeMeter()
'''

EFFORT = '''
"""The objective and its instrument."""

import numpy as np

from hts.channels import Channel
from hts.config import Config, Named
from hts.contracts import Comparison, Instrument, Objective

IDLE = 5.0
EFFORT = Channel("fake_effort", "1", (), "idle level, plus mean absolute joint work rate of a joint")


class FakeSettings(Config):
    hidden: int = 8


class FakeObjective(Objective):
    name = "fake"
    unit = "1"
    inputs = ("joint_torque", "joint_velocity")
    target = EFFORT
    weights = (1.0,)
    baseline_weights = (0.01,)
    instrument = "fake_meter"

    def __init__(self, settings):
        self.settings = settings

    def measurement_model(self):
        return Named(name="lstm", hidden=self.settings.hidden, sequence=20, stream=100)

    def reward(self, prediction):
        return -prediction

    def score(self, segments):
        return {"net_effort": segments.values("fake_effort").mean(axis=1) - segments.idle("fake_effort")}

    def compare(self, policy, reference):
        saved = 1 - policy["net_effort"] / reference["net_effort"]
        return Comparison(saved, saved, {"net_effort": policy["net_effort"]})

    def proxy(self, channels):
        return (channels["joint_torque"] * channels["joint_velocity"]).abs().mean(-1)


class FakeMeter(Instrument):
    channels = (EFFORT,)

    def reset(self, num_worlds, rng):
        self.level = np.full(num_worlds, IDLE)

    def step(self, sample):
        now = IDLE + np.abs(sample.motor_torque * sample.joint_velocity).mean(axis=-1)
        self.level = self.level + (now - self.level) * min(1.0, sample.dt / 0.1)

    def read(self):
        return {"fake_effort": self.level}

    def idle(self):
        return {"fake_effort": IDLE}

    def describe(self):
        return {"idle": IDLE, "delay_seconds": 0.1}
'''


@pytest.fixture
def fake_objective(tmp_path: Path) -> Path:
    """The package as pip would have installed it: the folder to put on the path."""
    files = {
        "fake_objective/__init__.py": "",
        "fake_objective/plugin.py": PLUGIN,
        "fake_objective/effort.py": EFFORT,
    }
    return write_package(tmp_path / "installed", "fake-objective", files, {"fake": "fake_objective.plugin"})


def test_a_strangers_objective_is_listed(hts, fake_objective):
    done = hts("plugins", "--json", path=[fake_objective])
    listed = json.loads(done.stdout)
    assert {"name": "fake", "package": "fake-objective", "summary": "How hard the legs work."} in listed["objectives"]
    assert [row["name"] for row in listed["instruments"] if row["package"] == "fake-objective"] == ["fake_meter"]


def test_a_misspelt_setting_of_a_strangers_objective_ends_in_one_line(hts, fake_objective, tmp_path):
    done = hts(
        *("run", "--objective", "fake", "--robot", "go1", "--preset", "smoke"),
        *("--set", "objectives.fake.hiden=4", "--out", tmp_path / "run"),
        path=[fake_objective],
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "Did you mean 'hidden'?" in done.stderr and "fake-objective" in done.stderr
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_strangers_objective_runs_from_command_to_report(hts_here, small, fake_objective, tmp_path):
    folder = tmp_path / "run"
    command = ["run", "--objective", "fake", "--robot", "go1", "--preset", "smoke", "--out", folder, *small("twin")]
    done = hts_here(*command, path=[fake_objective])
    assert done.returncode == 0, done.stderr

    summary = json.loads((folder / "summary.json").read_text())
    assert summary["objectives"] == ["fake"]
    assert (summary["robot"], summary["world"], summary["preset"]) == ("go1", "twin", "smoke")
    (iteration,) = summary["iterations"]
    assert iteration["measurement_models"]["fake"]["dataset"]
    assert all(candidate["weights"] == {"fake": 1.0} for candidate in iteration["candidates"])
    measured = [one["real"]["fake"].values() for one in iteration["candidates"] if one["elite"] and one["real"]]
    measured += [one["speeds"].values() for one in summary["final"]["objectives"].values()]  # none if nobody was better
    assert measured
    for (numbers,) in measured:
        assert math.isfinite(numbers["improvement"])
        assert set(numbers["metrics"]) == {"net_effort"}
    for name in ("config.yaml", "provenance.json", "report.html"):
        assert (folder / name).is_file()

    from hts.recordings.store import RecordingStore

    store = RecordingStore(folder / "data.zarr")
    assert store.ids()
    for recording in store.ids():
        assert store.attributes(recording)["idle"]["fake_effort"] == 5.0
        assert store.read(recording, ["fake_effort"]).values("fake_effort").min() >= 0.0

    before = (folder / "summary.json").read_bytes()
    again = hts_here(*command, path=[fake_objective])
    assert again.returncode == 2
    assert f"hts resume {folder}" in again.stderr
    assert (folder / "summary.json").read_bytes() == before
