"""A run goes on without its engine where nothing is left to simulate: beside the robot there may be no GPU."""

from __future__ import annotations

import json
import shutil

import pytest

from hts.errors import ConfigError
from hts.run import resume_run, simulates_yet
from hts.testing.packages import kit_installed


@pytest.fixture
def resumed(finished, tmp_path, monkeypatch):
    """resumed(names of stages that are still to be done): the run goes on where there is no engine."""

    def no_engine(name, device="auto", tell=None):
        raise ConfigError("there is no such engine here")

    def go_on(*undone):
        folder = tmp_path / "run"
        shutil.copytree(finished.folder, folder)
        for name in ("summary", *undone):
            (folder / f"{name}.json").unlink()
        monkeypatch.setattr("hts.sim.selection.select_engine", no_engine)
        with kit_installed():
            resume_run(folder)
        return json.loads((folder / "summary.json").read_text())

    return go_on


@pytest.mark.parametrize("undone", [("final",), ("final", "iterations/00/test")], ids=["final", "last trials"])
def test_what_is_left_on_the_robot_needs_no_engine(resumed, finished, undone):
    assert resumed(*undone)["final"] == finished.summary["final"]


@pytest.mark.parametrize("undone", ["gate", "simulate", "finetune"])
def test_whatever_simulates_does(resumed, undone):
    stages = ["finetune", "simulate", "gate", "test"]
    with pytest.raises(ConfigError, match="no such engine"):
        resumed("final", *(f"iterations/00/{name}" for name in stages[stages.index(undone) :]))


def test_where_real_samples_ended_the_iterations_nothing_simulates(finished, tmp_path):
    """The last iterations of a capped run never begin; its second trials and final are made beside the robot."""
    config = finished.config.model_copy(update={"iterations": 3})
    (tmp_path / "iterations/00").mkdir(parents=True)
    for stage in ("gate", "test"):
        (tmp_path / f"iterations/00/{stage}.json").write_text("{}")
    assert simulates_yet(config, tmp_path)
    (tmp_path / "iterations.json").write_text(json.dumps({"done": 1, "of": 3}))
    assert not simulates_yet(config, tmp_path)


def test_a_second_look_that_is_still_to_be_taken_simulates(finished, tmp_path):
    config = finished.config.model_copy(
        update={"gate": finished.config.gate.model_copy(update={"nearer": (0.5,), "strict": True})}
    )
    last = tmp_path / "iterations/00"
    last.mkdir(parents=True)
    whole = json.loads((finished.folder / "iterations/00/gate.json").read_text())
    (last / "gate.json").write_text(json.dumps(whole | {"strict": True, "elites": ["00-00"]}))
    assert not simulates_yet(config, tmp_path)
    (last / "gate.json").write_text(json.dumps(whole | {"strict": True, "elites": []}))
    assert simulates_yet(config, tmp_path)
    (last / "nearer.json").write_text("{}")
    assert not simulates_yet(config, tmp_path)
