"""Signals, and a terminal that ends: the robot is damped, and the damping command is the last."""

from __future__ import annotations

import importlib.util
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from hts_go1_runtime import cli, operator_key
from hts_go1_runtime.errors import Stopped
from hts_go1_runtime.link import DAMPING, Command
from hts_go1_runtime.loop import Loop
from hts_go1_runtime.machine import STAND, Limits
from hts_go1_runtime.operator_key import SIGNALS, listen, signals

SCRIPTED = Path(__file__).with_name("scripted.py")
SPEC = importlib.util.spec_from_file_location("scripted", SCRIPTED)
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)
STEADY = Command(STAND, np.full(12, 30.0), np.full(12, 0.6))


class Interrupted(scripted.ScriptedLink):
    """A signal comes while the tenth command is being sent."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self._number, self._count = number, 0

    def send(self, command):
        self._count += 1
        if self._count == 10:
            os.kill(os.getpid(), self._number)
        super().send(command)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_while_a_command_is_being_sent_leaves_the_damping_command_as_the_last(number):
    link, before = Interrupted(number), signal.getsignal(number)
    loop = Loop(link, 0.02, Limits())

    def walk() -> None:
        loop.start()
        for _ in range(20):
            loop.tick(lambda state: STEADY)

    with signals(loop.brake), pytest.raises(Stopped, match=f"operator: signal {signal.Signals(number).name}"):
        walk()
    assert signal.getsignal(number) is before
    assert link.sent[-1][1] is DAMPING
    assert len(link.sent) == 12  # nine steps, one damping command, the step in the midst of which it came, another


INTERRUPTED = """
import os, runpy, signal, sys
moment = sys.argv.pop(1)
class Stop:
    def find_spec(self, name, path=None, target=None):
        if name == moment:
            try: os.kill(os.getpid(), signal.SIGINT)
            except KeyboardInterrupt as error: raise ImportError("initialization failed") from error
signal.signal(signal.SIGINT, signal.default_int_handler)  # the suite may ignore it
sys.meta_path.insert(0, Stop())
if moment == "the bundle":
    from hts_go1_runtime import cli
    def stopped(folder): os.kill(os.getpid(), signal.SIGINT)
    cli.load_bundle = stopped
runpy.run_module("hts_go1_runtime", run_name="__main__", alter_sys=True)
"""


@pytest.mark.parametrize(
    ("moment", "said"),
    [
        ("numpy", "interrupted: the runtime had not begun, nothing has moved\n"),
        ("hts_go1_runtime.cli", "interrupted: the runtime had not begun, nothing has moved\n"),
        ("the bundle", "interrupted: the robot is not being moved\n"),
    ],
)
def test_ctrl_c_before_a_robot_is_met_is_one_line(tmp_path, moment, said):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
    command = [sys.executable, "-c", INTERRUPTED, moment, "check", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert (done.returncode, done.stderr, done.stdout) == (130, said, "")


def test_ctrl_c_while_the_session_is_made_is_the_operators_key(visit, bundle, monkeypatch, capsys):
    """And while it is wound up it does no harm."""
    session, figures = cli.Session, cli.figures

    def made(*arguments):
        os.kill(os.getpid(), signal.SIGINT)
        return session(*arguments)

    def wound_up(*arguments):
        os.kill(os.getpid(), signal.SIGINT)
        return figures(*arguments)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # the suite may ignore it
    try:
        with monkeypatch.context() as late:
            late.setattr(cli, "figures", wound_up)
            assert visit("--yes") == 0
        for log in (bundle / "logs").glob("*.csv"):
            log.unlink()
        monkeypatch.setattr(cli, "Session", made)
        assert visit("--yes") == 3
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err.startswith("stopped: operator: signal SIGINT. The robot is damped")


VISIT = """
import fcntl, importlib.util, json, sys, termios, time
fcntl.ioctl(0, termios.TIOCSCTTY, 0)  # the terminal is this session's
from hts_go1_runtime import cli
from hts_go1_runtime.link import DAMPING
spec = importlib.util.spec_from_file_location("scripted", sys.argv[1])
scripted = importlib.util.module_from_spec(spec)
spec.loader.exec_module(scripted)
class Paced(scripted.ScriptedLink):
    stands = False
    def wait(self, until):
        walks = self.stands and self.sent[-1][1] is not DAMPING
        time.sleep(0.05 if walks else 0.001)  # minutes, in which a terminal can be closed however busy a computer is
        return super().wait(until)
link, say = Paced(), cli.Events.say
def said(events, what, **numbers):
    link.stands = link.stands or what == "standing"
    say(events, what, **numbers)
cli.Events.say = said
cli.UdpLink = lambda url, lockstep: link
code = cli.main(["run", sys.argv[2], "--link", "udp://127.0.0.1:9870", "--lockstep", "--idle-seconds", "0", "--yes"])
open(sys.argv[3], "w").write(json.dumps([code, link.sent[-1][1] is DAMPING]))
sys.exit(code)
"""


def test_a_terminal_that_is_gone_damps_the_robot_and_the_visit_ends_in_order(bundle, tmp_path):
    typing, reading = os.openpty()

    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
    command = [sys.executable, "-W", "ignore", "-c", VISIT, str(SCRIPTED), str(bundle), str(tmp_path / "end")]
    process = subprocess.Popen(
        command, stdin=reading, stdout=reading, stderr=reading, env=environment, start_new_session=True
    )
    os.close(reading)
    said = b""
    while b"standing" not in said:
        said += os.read(typing, 1000)
    os.close(typing)
    assert process.wait(100) == 3
    assert json.loads((tmp_path / "end").read_text()) == [3, True]
    events = [json.loads(line) for line in (bundle / "logs" / "events.jsonl").read_text().splitlines()]
    (stopped,) = [one for one in events if one["what"] == "stopped"]
    assert stopped["detail"] in ("signal SIGHUP", "the end of the input on the terminal")
    assert events[-1]["what"] == "ended"


def test_nobody_who_reads_what_is_said_ends_no_visit(visit, monkeypatch, bundle):
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as gone:
        monkeypatch.setattr(sys, "stdout", gone)
        monkeypatch.setattr(sys, "stderr", gone)
        assert visit("--yes") == 0
    assert '"what": "ended", "rows": ["00", "01"]' in (bundle / "logs" / "events.jsonl").read_text()


def test_ctrl_d_on_the_terminal_is_the_key(monkeypatch, visit, capsys):
    typing, reading = os.openpty()
    before = set(threading.enumerate())
    with os.fdopen(reading) as keys:
        monkeypatch.setattr(sys, "stdin", keys)
        os.write(typing, b"\x04")
        link = scripted.ScriptedLink()
        assert visit("--yes", link=link) == 3
        for thread in set(threading.enumerate()) - before:
            thread.join(10)
    os.close(typing)
    assert "operator: the end of the input on the terminal" in capsys.readouterr().err
    assert link.sent[-1][1] is DAMPING


@pytest.mark.parametrize("nothing", [True, False])
def test_a_key_that_nobody_can_press_is_said(monkeypatch, visit, capsys, nothing):
    with Path(os.devnull).open() as ended:
        monkeypatch.setattr(sys, "stdin", None if nothing else ended)
        assert visit("--yes") == 0
    assert "the key Enter is gone, the input has ended: a file STOP in the bundle, Ctrl-C" in capsys.readouterr().out


@pytest.mark.parametrize(("ended", "expected"), [(60.0, "gone"), (0.1, "operator: the end of the input")])
def test_an_input_that_ends_while_the_robot_walks_stops_it(monkeypatch, ended, expected):
    """As of `ssh HOST COMMAND` without a terminal: the key that was promised is gone, and who promised to watch too."""
    monkeypatch.setattr(operator_key, "ENDED", ended)
    said: queue.SimpleQueue[str] = queue.SimpleQueue()
    reading, writing = os.pipe()
    with os.fdopen(reading) as keys:
        listen(lambda reason, detail: said.put(f"{reason}: {detail}"), keys, lambda line: said.put("gone"))
        time.sleep(0.2)
        os.close(writing)
        assert said.get(timeout=60) == expected
