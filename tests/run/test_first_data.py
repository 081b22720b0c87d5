"""Falls in first data, the first thing that walks on a robot, are counted and told."""

from __future__ import annotations

import json
import shutil

import pytest

from hts.api import load
from hts.testing.known_world import KnownWorld
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run


@pytest.fixture
def stumbling(monkeypatch):
    """The world's second recording of first data holds two falls."""
    plain = KnownWorld.collect

    def collect(self, policies, schedule):
        found = plain(self, policies, schedule)
        found[1] = found[1].replace(fell=True, notes={**found[1].notes, "falls": "2"})
        return found

    monkeypatch.setattr(KnownWorld, "collect", collect)


def test_falls_in_first_data_are_in_summary_and_report_and_told(stumbling, tmp_path, capsys):
    with kit_installed():
        run = tiny_run(tmp_path / "run", settings={"collection.repeats": 2})
    assert json.loads((run.folder / "collect.json").read_text())["falls"] == run.summary["first_data_falls"] == 2
    assert "2 falls in first data" in (run.folder / "report.html").read_text()
    assert "The pretrained policy fell 2 times in the first data; 1 of 3 recordings" in "".join(capsys.readouterr())


def test_a_run_of_before_they_were_counted_says_nothing_of_them(finished, tmp_path):
    with kit_installed():
        run = load(shutil.copytree(finished.folder, tmp_path / "run"))
        assert run.summary["first_data_falls"] == 0
        assert "first data" not in (run.folder / "report.html").read_text()
        (run.folder / "summary.json").unlink()
        stage = run.folder / "collect.json"
        before = {key: value for key, value in json.loads(stage.read_text()).items() if key != "falls"}
        stage.write_text(json.dumps(before))
        from hts.run import resume_run

        resume_run(run.folder)
    assert json.loads((run.folder / "summary.json").read_text())["first_data_falls"] is None
