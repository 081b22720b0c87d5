"""What a visit notes is on the disk, whoever reads what it says aloud."""

from __future__ import annotations

import errno
import io
import json
import os
import subprocess
import sys
import threading
import time

from hts_go1_runtime.events import Events
from hts_go1_runtime.terminal import StreamThatMayGo


def test_events_of_a_full_disk_wait_in_order_and_are_said_at_once(tmp_path, monkeypatch, capsys):
    real, full = os.write, threading.Event()
    full.set()

    def write(handle, data):
        if full.is_set():
            if len(data) > 20:
                return real(handle, data[:20])  # some of it fits
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(handle, data)

    monkeypatch.setattr("hts_go1_runtime.events.os.write", write)
    events = Events(tmp_path / "events.jsonl")
    for number in range(3):
        events.say("row", number=number)
    said, refused, end = "", "cannot be written yet (No space left on device)", time.monotonic() + 60
    while (said.count("row number=") < 3 or refused not in said) and time.monotonic() < end:
        time.sleep(0.01)
        said += capsys.readouterr().out
    assert said.count("row number=") == 3  # aloud, whatever the disk does
    assert said.count(refused) == 1
    while (tmp_path / "events.jsonl").read_text():  # no half of a line stays, though it tries again and again
        assert time.monotonic() < end
    full.clear()
    events.close()
    kept = [json.loads(line)["number"] for line in (tmp_path / "events.jsonl").read_text().splitlines()]
    assert kept == [0, 1, 2]


CLOSED = """
import sys, time
from pathlib import Path
from hts_go1_runtime.events import Events
from hts_go1_runtime.terminal import StreamThatMayGo
from hts_go1_runtime.terminal import that_may_go
input()  # until nobody reads what is said any more
with that_may_go():
    print("refused: nobody reads this", file=sys.stderr, flush=True)
    events = Events(Path(sys.argv[1]) / "events.jsonl")
    events.say("one")
    time.sleep(0.5)
    events.keep(Path(sys.argv[1]) / "held.json", "{}")
    events.say("two")
    events.close()
"""


def test_a_stdout_that_is_closed_costs_no_event_and_no_exit_code(tmp_path):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
    pipe = subprocess.PIPE
    talker = subprocess.Popen(
        [sys.executable, "-c", CLOSED, str(tmp_path)],
        env=environment,
        stdin=pipe,
        stdout=pipe,
        stderr=subprocess.STDOUT,
    )
    talker.stdout.close()
    talker.stdin.write(b"\n")
    talker.stdin.close()
    assert talker.wait(100) == 0
    assert [json.loads(line)["what"] for line in (tmp_path / "events.jsonl").read_text().splitlines()] == ["one", "two"]
    assert (tmp_path / "held.json").read_text() == "{}"


def test_a_terminal_that_stands_still_keeps_nothing_from_the_disk(tmp_path, monkeypatch):
    goes_on = threading.Event()
    monkeypatch.setattr("builtins.print", lambda *text, **how: goes_on.wait(100))
    events = Events(tmp_path / "events.jsonl")
    for what in ("one", "two"):
        events.say(what)
    path, end = tmp_path / "events.jsonl", time.monotonic() + 60
    while not (path.exists() and path.read_text().count("\n") == 2):
        assert time.monotonic() < end, "the disk waits for the terminal"
        time.sleep(0.01)
    goes_on.set()
    events.close()


def test_a_sign_that_the_terminal_does_not_know_silences_nothing():
    shown = io.TextIOWrapper(io.BytesIO(), encoding="ascii", write_through=True)
    stream = StreamThatMayGo(shown)
    print("35.55 N·m", "and on", sep="\n", file=stream)
    assert shown.buffer.getvalue() == b"35.55 N\\xb7m\nand on\n"
