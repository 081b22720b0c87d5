"""Stages: each is done once, its result appears whole or not at all, and one process works in a folder."""

from __future__ import annotations

import errno
import io
import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from hts.config_loading import read_config
from hts.errors import RunError
from hts.run.algorithm import stages_around, stages_per_iteration
from hts.run.progress import Progress
from hts.run.stages import Stages, read_json, write_json


@pytest.fixture
def shown() -> io.StringIO:
    return io.StringIO()


@pytest.fixture
def stages(tmp_path: Path, shown: io.StringIO):
    made = Stages(tmp_path, Progress(3, Console(file=shown, width=200)))
    yield made
    made.close()


def test_a_stage_is_done_once(stages, tmp_path):
    calls = []

    def work(report):
        report(0.5)
        calls.append(1)
        return {"answer": 42}

    assert stages.do("iterations/00/fit", "fit", work) == {"answer": 42}
    before = (tmp_path / "iterations/00/fit.json").stat()
    assert stages.do("iterations/00/fit", "fit", work) == {"answer": 42}
    after = (tmp_path / "iterations/00/fit.json").stat()
    assert calls == [1]
    assert (before.st_ino, before.st_mtime_ns) == (after.st_ino, after.st_mtime_ns)


def test_a_stage_that_fails_leaves_no_result_and_runs_again(stages, tmp_path):
    def fail(report):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        stages.do("collect", "collect", fail)
    assert not (tmp_path / "collect.json").exists()
    assert stages.do("collect", "collect", lambda report: [1]) == [1]


def test_a_result_is_the_same_fresh_and_read_back(stages):
    fresh = stages.do("final", "final", lambda report: {"bound": math.inf, 0.8: (1, math.nan)})
    assert fresh == {"bound": None, "0.8": [1, None]}
    assert stages.do("final", "final", lambda report: None) == fresh


def test_finished_stages_count_when_the_next_is_numbered(stages, tmp_path, shown):
    write_json(tmp_path / "collect.json", {})
    stages.do("collect", "collect", lambda report: None)
    stages.do("final", "final", lambda report: None)
    assert shown.getvalue().startswith("[2/3] final\n[2/3] final: 0.0 s")


def test_a_stage_that_is_not_there_after_all_leaves_no_gap_in_the_numbers(stages, shown):
    stages.do("collect", "collect", lambda report: None)
    stages.progress.leave_out(1)
    stages.do("final", "final", lambda report: None)
    assert shown.getvalue().splitlines()[-1].startswith("[2/2] final: ")


def test_only_stages_that_its_configuration_has_are_counted(finished):
    config = read_config(finished.folder / "config.yaml")
    done = json.loads((finished.folder / "log" / "stages.json").read_text())
    counted = stages_around(config) + stages_per_iteration(config) * config.iterations
    assert counted == len(done) + 1  # the report is no JSON file


def test_the_time_of_each_stage_is_kept(stages):
    stages.do("a", "a", lambda report: None)
    stages.do("b", "b", lambda report: None)
    assert list(stages.seconds()) == ["a", "b"]
    assert all(seconds >= 0 for seconds in stages.seconds().values())


@pytest.mark.parametrize("text", ["", '{"cut": ', "[]", "3", '{"a": "long"}', '{"a": null}'])
def test_damaged_times_stop_nobody_and_are_said_once(stages, tmp_path, shown, text):
    path = tmp_path / "log/stages.json"
    path.parent.mkdir()
    path.write_text(text)
    stages.do("b", "b", lambda report: None)
    stages.do("c", "c", lambda report: stages.seconds())
    assert list(stages.seconds()) == ["b", "c"] == list(read_json(path))
    assert shown.getvalue().count(f"{path}: damaged. It says only how long stages took") == 1


@pytest.mark.parametrize("text", ["", '{"cut": ', b"\xff\xfe\x00"])
def test_a_damaged_result_is_one_line_that_says_what_to_delete(stages, tmp_path, text):
    (tmp_path / "collect.json").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(
        RunError, match=r"collect.json: damaged .* Delete it and resume: that stage runs again\."
    ) as caught:
        stages.do("collect", "collect", lambda report: None)
    assert "\n" not in str(caught.value)


def test_a_missing_result_is_one_line(tmp_path):
    with pytest.raises(RunError, match=r"collect.json: missing\. .* Resume"):
        read_json(tmp_path / "collect.json")


def test_a_write_that_fails_keeps_the_old_result_and_names_the_file(tmp_path, monkeypatch):
    path = tmp_path / "collect.json"
    write_json(path, {"old": True})

    def full(handle):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as caught:
        write_json(path, {"old": False})
    assert caught.value.filename == str(path)
    assert read_json(path) == {"old": True}
    assert [file.name for file in tmp_path.iterdir()] == ["collect.json"]


def test_a_number_that_json_cannot_hold_is_null(tmp_path):
    write_json(tmp_path / "x.json", [math.inf, -math.inf, math.nan, 1.5])
    assert json.loads((tmp_path / "x.json").read_text()) == [None, None, None, 1.5]


def test_only_one_process_works_in_a_folder(stages, tmp_path):
    code = (
        "import sys; from pathlib import Path; "
        "from hts.run.stages import Stages; from hts.run.progress import Progress\n"
        "Stages(Path(sys.argv[1]), Progress(1))"
    )
    done = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert f"{tmp_path}: another process is working in it." in done.stderr
    stages.close()
    assert subprocess.run([sys.executable, "-c", code, tmp_path], check=False).returncode == 0


@pytest.mark.parametrize("number", [errno.EROFS, errno.EACCES, errno.EPERM])
def test_a_finished_run_that_cannot_be_written_to_is_read_without_a_lock(tmp_path, monkeypatch, number):
    plain = Path.open

    def refused(self, *given, **named):
        if self.name == ".lock":
            raise OSError(number, os.strerror(number), str(self))
        return plain(self, *given, **named)

    monkeypatch.setattr(Path, "open", refused)
    (tmp_path / "summary.json").write_text('{"a": 1}')
    with pytest.raises(OSError, match=r"\.lock"):
        Stages(tmp_path, Progress(1))
    (tmp_path / "report.html").write_text("")
    stages = Stages(tmp_path, Progress(1))
    assert stages.do("summary", "summary", lambda report: None) == {"a": 1}
    stages.close()


def test_a_terminal_sees_a_bar_and_a_log_file_sees_lines():
    for terminal in (True, False):
        file = io.StringIO()
        with Progress(1, Console(file=file, force_terminal=terminal, width=100)).stage("walk") as report:
            report(0.5)
        assert "walk" in file.getvalue()
        assert ("\x1b" in file.getvalue()) is terminal


def test_a_log_file_is_told_how_long_it_takes_every_15_seconds(monkeypatch):
    now, file = [100.0], io.StringIO()
    monkeypatch.setattr("hts.run.progress.time.perf_counter", lambda: now[0])
    with Progress(1, Console(file=file, width=100)).stage("walk") as report:
        now[0] = 110.0
        report(0.2)
        now[0] = 120.0
        report(0.25)  # a quarter took 20 s, so three more take 60 s
    assert file.getvalue().splitlines() == ["[1/1] walk", "     25%, about 60 s left", "[1/1] walk: 20.0 s"]


@pytest.mark.parametrize("by", ["moved", "deleted", "another in its place"])
def test_a_folder_that_goes_away_while_a_stage_works_stops_the_run_and_is_not_made_anew(tmp_path, by):
    folder = tmp_path / "run"
    (folder / "iterations").mkdir(parents=True)
    (folder / "config.yaml").write_text("")
    stages = Stages(folder, Progress(3, Console(quiet=True)))

    def work(report):
        if by == "deleted":
            shutil.rmtree(folder)
        else:
            folder.rename(tmp_path / "elsewhere")
        if by == "another in its place":
            Stages(folder_of_another(folder), Progress(3, Console(quiet=True))).close()
        return 1

    with pytest.raises(RunError, match=r"run: was moved, renamed or deleted while .* Resume it where it lies now"):
        stages.do("iterations/00/fit", "fit", work)
    assert not (folder / "iterations").exists()
    with pytest.raises(RunError, match="was moved"):
        stages.do("collect", "collect", lambda report: pytest.fail("begun in a folder that is not there"))
    stages.close()


def folder_of_another(folder):
    folder.mkdir()
    (folder / "config.yaml").write_text("")
    return folder


def test_a_lock_that_somebody_deletes_stops_no_run(tmp_path):
    (tmp_path / "config.yaml").write_text("")
    stages = Stages(tmp_path, Progress(3, Console(quiet=True)))
    (tmp_path / ".lock").unlink()
    assert stages.do("collect", "collect", lambda report: [1]) == [1]
    stages.close()
