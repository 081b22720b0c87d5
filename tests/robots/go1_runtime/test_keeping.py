"""A disk that refuses for good: who cannot free it gets the rows in another folder, and the process ends."""

from __future__ import annotations

import importlib.util
import os
import signal
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from hts import plugins
from hts.recordings.mapping import load_mapping
from hts.recordings.reading import read_log

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)


@pytest.fixture
def elsewhere(tmp_path, monkeypatch) -> Path:
    """Where temporary files go."""
    place = tmp_path / "elsewhere"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    return place


@pytest.fixture
def refusing(bundle, monkeypatch) -> None:
    """No log of the bundle gets its name, as if the disk were gone for it."""
    real = Path.replace

    def replace(self, target):
        if Path(target) == bundle / "logs" / "00.csv":
            raise OSError(5, "Input/output error", str(target))
        return real(self, target)

    monkeypatch.setattr(Path, "replace", replace)


def pressed(bundle: Path, *said: str) -> threading.Thread:
    """A signal each time that the next of these was noted."""

    def work() -> None:
        for words in said:
            end = time.monotonic() + 60
            while words not in (bundle / "logs" / "events.jsonl").read_text() and time.monotonic() < end:
                time.sleep(0.05)
            time.sleep(0.3)
            os.kill(os.getpid(), signal.SIGINT)

    (bundle / "logs" / "events.jsonl").touch()
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


def test_a_signal_while_the_disk_refuses_writes_the_rows_elsewhere(bundle, visit, refusing, elsewhere, capsys):
    presses = pressed(bundle, "waiting for the disk")
    assert visit("--yes", "--rows", "00") == 2
    presses.join()
    (folder,) = elsewhere.iterdir()
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and str(folder) in line
    assert "move the .csv there into the bundle's logs" in line
    registry = plugins.load()
    mapping = load_mapping(folder / "mappings" / "00.yaml")
    found = read_log(registry, [folder / "00.csv"], mapping, registry.make_robot("go1"))
    assert found.num_samples == 50
    assert not (bundle / "logs" / "00.csv").exists()


def test_where_nothing_can_be_written_the_next_signal_gives_it_up(
    bundle, visit, refusing, elsewhere, monkeypatch, capsys
):
    elsewhere.rmdir()
    presses = pressed(bundle, "waiting for the disk", "cannot be written elsewhere")
    assert visit("--yes", "--rows", "00") == 2
    presses.join()
    assert "What the disk refused is lost: it was given up" in capsys.readouterr().err


@pytest.mark.parametrize("second", [signal.SIGHUP, signal.SIGINT], ids=["a terminal that goes", "Ctrl-C twice"])
def test_signals_that_come_before_the_question_are_no_answer_to_it(
    bundle, visit, refusing, elsewhere, monkeypatch, capsys, second
):
    """Both come while the other folder is tried; nothing is given up until somebody says so after it was said."""
    monkeypatch.setattr("hts_go1_runtime.keeping.PATIENCE", 0.2)
    monkeypatch.setattr("hts_go1_runtime.log.RowLog.write_elsewhere", lambda log, folder: os.kill(os.getpid(), second))
    events = bundle / "logs" / "events.jsonl"
    events.touch()
    given_up = []

    def work() -> None:
        while "waiting for the disk" not in events.read_text():
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGHUP)  # and the second as soon as this one is heeded
        while "cannot be written elsewhere" not in events.read_text():
            time.sleep(0.05)
        time.sleep(0.5)
        os.kill(os.getpid(), signal.SIGHUP)
        time.sleep(0.5)
        given_up.append("given up" in events.read_text())
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    assert visit("--yes", "--rows", "00") == 2
    thread.join()
    assert given_up == [False]
    assert "it was given up" in capsys.readouterr().err


def test_where_a_later_row_meets_the_full_disk_the_last_line_says_where_the_rows_are(
    bundle, visit, refusing, elsewhere, monkeypatch, capsys
):
    from hts_go1_runtime.errors import RuntimeFault
    from hts_go1_runtime.keeping import Keeper

    row = Keeper.walked

    def walked(self, log, this):
        row(self, log, this)
        raise RuntimeFault("logs/.01.csv.partial: cannot be written (No space left on device)")

    monkeypatch.setattr(Keeper, "walked", walked)
    presses = pressed(bundle, "waiting for the disk")
    assert visit("--yes", "--rows", "00,01") == 2
    presses.join()
    (folder,) = elsewhere.iterdir()
    assert str(folder) in capsys.readouterr().err.splitlines()[-1]


def test_times_of_a_step_are_its_own_however_long_a_visit_lasts(bundle, visit, monkeypatch):
    monkeypatch.setattr("hts_go1_runtime.loop.KEPT_TIMES", 20)
    assert visit("--yes", "--rows", "00") == 0
    lines = (bundle / "logs" / "00.csv").read_text().splitlines()
    took = np.array([float(line.split(",")[lines[0].split(",").index("step_ms")]) for line in lines[1:]])
    assert np.unique(took).size > 10
