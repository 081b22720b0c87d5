"""A run folder of version 0.1.0, as it lay on the disk: every later version opens it, shows it and goes on with it.

If one of these fails, a file format has changed: go on reading the old one, and keep this folder as it is.
"""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest

from hts import api
from hts.cli.main import main
from hts.recordings.store import RecordingStore
from hts.testing.examples.robot.robot import SPEC, Tiny

KEPT = Path(__file__).parents[1] / "data" / "run-v1.zip"
"""Robot `tiny`, objective `fake`, world `known`: one iteration, one candidate, no figures."""


@pytest.fixture
def folder(tmp_path: Path, hts_kit: None, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The run, and the robot with the gains that it had then: policies are for those."""
    monkeypatch.setattr(Tiny, "spec", replace(SPEC, kp=(5.0, 5.0), action_scale=(0.25, 0.25)))
    with zipfile.ZipFile(KEPT) as kept:
        kept.extractall(tmp_path / "run")
    return tmp_path / "run"


def test_its_settings_summary_and_policies_are_read(folder):
    run = api.load(folder)
    assert (run.config.robot.name, run.config.world.name, list(run.config.objectives)) == ("tiny", "known", ["fake"])
    assert run.summary["final"]["objectives"]["fake"]["speeds"]["0.8"]["segments"] == 20
    assert run.policy("best").card.policy_hash == run.policy("00-00").card.policy_hash
    assert run.policy("best").card.policy_hash != run.policy("pretrained").card.policy_hash


def test_its_recordings_are_whole(folder):
    store = RecordingStore(folder / "data.zarr")
    assert store.validate() == []
    collected = json.loads((folder / "collect.json").read_text())["recordings"]
    summary = json.loads((folder / "summary.json").read_text())
    fitted_to = summary["iterations"][0]["measurement_models"]["fake"]["dataset"]
    assert store.dataset(collected).sha256 == fitted_to


def test_its_report_is_written(folder):
    assert main(["report", str(folder)]) == 0
    assert "20.0" in (folder / "report.html").read_text(encoding="utf-8")


def test_a_finished_run_that_is_resumed_says_so_and_changes_nothing(folder, capsys):
    before = (folder / "summary.json").read_bytes()
    assert main(["resume", str(folder)]) == 0
    assert "finished already" not in capsys.readouterr().out  # it was kept without its report, which is made
    assert main(["resume", str(folder)]) == 0
    told = f"{folder}: this run was finished already, nothing was left to do. Its result again:"
    assert told in capsys.readouterr().out.splitlines()
    assert (folder / "summary.json").read_bytes() == before


def test_a_run_that_was_stopped_before_its_last_head_to_head_goes_on(folder, capsys):
    finished = json.loads((folder / "summary.json").read_text())
    for name in ("final.json", "segments.json", "summary.json"):
        (folder / name).unlink()
    assert main(["resume", str(folder)]) == 0
    assert "finished already" not in capsys.readouterr().out
    again = json.loads((folder / "summary.json").read_text())
    assert again["iterations"] == finished["iterations"]
    speeds = again["final"]["objectives"]["fake"]["speeds"]
    assert speeds["0.8"]["improvement"] == pytest.approx(0.2, abs=0.01)  # what the world `known` saves, always
