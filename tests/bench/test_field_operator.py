"""The script that plays the operator of a field run: it kills in the middle, once each, and forgets nothing."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from field import outcome, processes, stages
from field.books import Books
from field.killing import LAST_SHARE, SHARE, Killer
from field.visits import Line, Recorder

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def run(tmp_path):
    """A run of two iterations, the first of which is done up to its test."""
    folder = tmp_path / "run"
    (folder / "log").mkdir(parents=True)
    (folder / "config.yaml").write_text("iterations: 2\n")
    (folder / "data.zarr" / "a").mkdir(parents=True)
    times = {}
    for number, name in enumerate(stages.names(folder)[:6]):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.json").write_text("{}")
        times[name] = 0.2 + number
    (folder / "log" / "stages.json").write_text(json.dumps(times))
    return folder


@pytest.fixture
def sleeper(tmp_path, monkeypatch):
    """A process that does nothing for a minute."""
    (tmp_path / "sleeper.py").write_text("import time\ntime.sleep(60)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    made = processes.start("sleeper", [], subprocess.PIPE, None)
    yield made
    processes.kill(made)


def runs(process: int) -> bool:
    """Whether there is such a process; one that has ended and that nobody has waited for is none."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:  # it goes while it is looked at
        return False


def test_stages_are_those_of_a_run_in_order(run):
    assert stages.names(run)[:3] == ["collect", "iterations/00/fit", "iterations/00/finetune"]
    assert stages.current(run) == "iterations/01/fit"
    assert stages.current(run.parent) is None
    assert stages.begins("[2/14] iteration 00 (1 of 2): fit measurement models\n")
    assert not stages.begins("[2/14] iteration 00 (1 of 2): fit measurement models: 6.7 s\n")
    assert not stages.begins("Waiting for 3 of 3 logs\n")


def test_a_stage_is_killed_once_in_its_middle_and_what_was_finished_is_remembered(run, sleeper, tmp_path):
    books, clock = Books(tmp_path), [100.0]
    killer = Killer(("fit",), run, books, lambda: clock[0])
    assert not killer.look(sleeper)  # it has not begun
    (run / "log" / "stages.json").write_text(json.dumps({"iterations/00/fit": 2.0}))
    killer.line("[7/14] iteration 01 (2 of 2): fit measurement models\n")
    clock[0] += LAST_SHARE * 2.0 - 0.001
    assert not killer.look(sleeper)
    clock[0] += 0.002
    assert killer.look(sleeper)
    assert sleeper.returncode == -signal.SIGKILL
    (entry,) = Books(tmp_path).entries("kills")
    assert (entry["what"], entry["stage"]) == ("fit", "iterations/01/fit")
    assert len(entry["finished"]) == 6
    assert killer.pending == []
    assert not killer.look(sleeper)
    found = outcome.outcome(run, books, ("fit", "gate"))
    assert (found["not_killed"], found["stages_done_again"], found["finished"]) == (["gate"], [], False)
    (run / "iterations/00/fit.json").write_text("[]")  # as if it had been done twice
    os.utime(run / "iterations/00/fit.json", ns=(0, 0))
    assert outcome.outcome(run, books, ())["stages_done_again"] == ["iterations/00/fit"]


def test_nobody_is_killed_in_a_stage_of_which_no_time_is_known_unless_there_is_no_later_one(run, tmp_path):
    killer = Killer(("fit",), run, Books(tmp_path))
    (run / "log" / "stages.json").unlink()
    assert killer._moment("iterations/00/fit") is None
    (run / "config.yaml").write_text("iterations: 1\n")
    assert killer._moment("iterations/00/fit") == 1.0
    (run / "config.yaml").write_text("iterations: 3\n")
    (run / "log" / "stages.json").write_text(json.dumps({"iterations/00/fit": 2.0}))
    assert killer._moment("iterations/01/fit") == SHARE * 2.0


def test_what_was_started_ends_with_who_started_it(tmp_path):
    (tmp_path / "waits.py").write_text("import os, time\nprint(os.getpid(), flush=True)\ntime.sleep(600)\n")
    code = "from field import processes; import sys; made = processes.start('waits', [], None, None); made.wait()"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(BENCHMARKS), *sys.path[1:]])}
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment) as operator:
        assert operator.stdout is not None
        started = int(operator.stdout.readline())
        operator.kill()
    end = time.monotonic() + 60
    while runs(started):
        assert time.monotonic() < end
        time.sleep(0.005)


def test_a_stage_in_the_world_is_killed_while_recordings_are_stored(run, sleeper, tmp_path):
    (run / "collect.json").unlink()
    killer = Killer(("collect",), run, Books(tmp_path))
    killer.line("[1/14] collect real data of the pretrained policy\n")
    assert not killer.look(sleeper)
    (run / "data.zarr" / "b").mkdir()
    assert killer.look(sleeper)
    assert Books(tmp_path).entries("kills")[0]["recordings_stored"] == 1


def test_a_visit_is_killed_in_the_middle_of_a_row(tmp_path):
    logs = tmp_path / "logs"
    logs.mkdir()
    killer = Killer(("collect-visit",), tmp_path, Books(tmp_path))
    (logs / ".01.csv.partial").write_text("time\n")
    assert killer.visit("collect", logs, 1)
    assert not killer.visit("collect", logs, 4)  # the first of four
    (logs / "00.csv").touch()
    assert killer.visit("collect", logs, 4)
    assert not killer.visit("test", logs, 4)


def test_side_by_side_each_session_is_a_visit(tmp_path):
    rows = [{"log": f"{number:02d}", "session": session} for number, session in enumerate("aabbb")]
    (tmp_path / "manifest.json").write_text(json.dumps({"rows": rows}))
    for robots, expected in ((1, [5]), (4, [2, 3])):
        line = Line("dev-03", 0.0, 0.0, False, None, robots, 0)
        recorder = Recorder(line, tmp_path, tmp_path, Books(tmp_path), Killer((), tmp_path, Books(tmp_path)))
        assert [len(visit) for visit in recorder._split(tmp_path)] == expected


@pytest.mark.slow
def test_a_bundle_is_recorded_though_a_visit_is_killed(tmp_path):
    pytest.importorskip("hts_power", reason="the objective of this run is not installed")
    # Rows of 6 s: the killer looks every 20 ms whether one is being written, and a busy computer looks seldom.
    schedule = 'collection.schedule.commands=[{"seconds": 6, "vx": 0.6}]'
    small = ["--set", "collection.repeats=1", "--set", "collection.exploring=1", "--set", schedule]
    command = [sys.executable, str(BENCHMARKS / "field_operator.py"), "--out", str(tmp_path / "out"), "--bundles", "1"]
    done = subprocess.run(
        [*command, "--kill", "collect-visit", "--loss", "0.02", "--", "--preset", "smoke", *small],
        capture_output=True,
        text=True,
        timeout=1000,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads((tmp_path / "out" / "result.json").read_text())
    assert [one["what"] for one in found["kills"]] == ["collect-visit"]
    assert found["kills"][0]["whole_rows"] == 1
    assert found["visits"]["number"] == 2
    assert found["packets"]["states_lost"] > 0
    assert [one["code"] for one in found["imports"]] == [0]
    (logs,) = (tmp_path / "out" / "run").rglob("logs")
    assert sorted(path.name for path in logs.glob("*.csv")) == ["00.csv", "01.csv"]
