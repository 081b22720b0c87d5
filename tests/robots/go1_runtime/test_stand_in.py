"""The process that plays a robot, alone and with the runtime in another process."""

from __future__ import annotations

import csv
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import hts_go1_stand_in.line
from hts import plugins
from hts.recordings.mapping import load_mapping
from hts.recordings.reading import read_log
from hts_go1_runtime.fake import standing
from hts_go1_runtime.link import NOTHING, Command
from hts_go1_runtime.machine import STAND
from hts_go1_runtime.packet import COMMAND, DONE, LARGEST, numbers_of_command, numbers_of_state, pack, unpack
from hts_go1_runtime.room import END, SIDE
from hts_go1_runtime.udp import UdpLink
from hts_go1_stand_in.body import PATIENCE, STATE_SECONDS, Body
from hts_go1_stand_in.cli import main
from hts_go1_stand_in.line import TAKEN, Line
from hts_go1_stand_in.serve import _obey

HOLD = Command(STAND, np.full(12, 40.0), np.full(12, 1.0))


@pytest.fixture
def body():
    made = Body("dev-03", ["power"], 0)
    yield made
    made.close()


def states(body: Body, count: int, command: Command | None) -> list:
    seen = []
    for number in range(count):
        seen.append(body.state(number))
        if command is not None:
            body.command(command)
        body.advance()
    return seen


def test_it_hangs_on_a_stool_until_it_is_told_to_stand_and_damps_itself_in_silence(body):
    from hts.testing.twin import TwinSettings, instruments_of_reality, resolved_settings

    registry = plugins.load()
    settings = resolved_settings(TwinSettings(reality="dev-03"), "go1")
    robot = registry.make_robot("go1")
    (gauge,) = instruments_of_reality(registry, robot, {"power": {}}, settings.instruments, False).values()
    idle = states(body, 250, NOTHING)
    level = np.mean([state.current for state in idle[50:]])
    assert level == pytest.approx(gauge.idle()["battery_current"], rel=0.1)
    assert np.abs(idle[-1].q - idle[0].q).max() < 0.15  # noise of the encoders
    stood = states(body, 250, HOLD)
    assert stood[-1].gravity[2] < -0.97
    assert stood[-1].current > 1.3 * level  # standing is not idle
    states(body, round(PATIENCE / STATE_SECONDS) + 200, None)
    assert np.abs(body.state(0).q - STAND).max() > 0.3  # it has sunk down
    assert np.abs(body.state(0).dq).max() < 3.0  # braked


def test_a_line_loses_and_delays_the_shares_it_is_told_to():
    line = Line(0, 0.1, 0.2, 0.01, 0)
    fates = [line._fate(1.0) for _ in range(5000)]
    assert np.mean([fate is None for fate in fates]) == pytest.approx(0.1, abs=0.02)
    late = [fate - 1.0 for fate in fates if fate is not None and fate > 1.0]
    assert len(late) / 5000 == pytest.approx(0.18, abs=0.02)  # of those that are not lost
    assert 0 < min(late) < max(late) <= 0.01
    line._socket.close()


def test_a_second_runtime_is_heard_from_its_first_command_on():
    line, numbers = Line(0, 0.0, 0.0, 0.0, 0), []
    for stated in (30.0, 40.0):  # each a process of its own, which counts from 1
        link = UdpLink(f"udp://127.0.0.1:{line.port}")
        for _ in range(5):
            link.send(Command(STAND, np.full(12, stated), np.ones(12)))
        end = time.monotonic() + 5.0
        heard = []
        while len(heard) < 5 and time.monotonic() < end:
            heard += line.commands(0.0, 0.1)
        numbers.append([one[12] for one in heard])
        assert line.greeting
        line.greeting = False  # greeted
        link.hello()  # the same runtime again: what it sent before stays sent
        link._sequence = 0
        link.send(Command(STAND, np.full(12, 99.0), np.ones(12)))
        assert line.commands(0.0, 0.2) == []
        assert not line.greeting
        link.close()
        time.sleep(2 * TAKEN)  # nobody commands the robot any more
    line._socket.close()
    assert numbers == [[30.0] * 5, [40.0] * 5]


def test_each_runtime_greets_the_robot_before_its_commands_count():
    said: list[str] = []

    class Ear:
        clock = 0.0

        def greet(self) -> None:
            said.append("greeted")

        def command(self, command: Command) -> None:
            said.append("told")

    line = Line(0, 0.0, 0.0, 0.0, 0)
    for _ in range(2):
        link = UdpLink(f"udp://127.0.0.1:{line.port}")
        link.send(HOLD)
        end = time.monotonic() + 5.0
        while said.count("told") < 1 and time.monotonic() < end:
            _obey(Ear(), line, 0.1)
        assert said == ["greeted", "told"]
        link.hello()  # the same runtime again
        _obey(Ear(), line, 0.1)
        assert said == ["greeted", "told"]
        said.clear()
        link.close()
        time.sleep(2 * TAKEN)
    line._socket.close()


def test_while_one_runtime_commands_the_robot_another_is_not_heard(monkeypatch):
    monkeypatch.setattr(hts_go1_stand_in.line, "TAKEN", 60.0)
    line = Line(0, 0.0, 0.0, 0.0, 0)
    first, second = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    for one in (first, second):  # of two computers: on one, the second is refused by itself
        one.connect(("127.0.0.1", line.port))
        one.settimeout(5.0)

    def told(runtime, number: int, kp: float) -> None:
        command = Command(STAND, np.full(12, kp), np.ones(12))
        runtime.send(pack(COMMAND, number, 0.0, numbers_of_command(command)))

    hello = pack(DONE, 0xFFFFFFFF, 0.0)
    second.send(pack(COMMAND, 1, 0.0, numbers_of_command(HOLD)))  # nobody has greeted: a stranger
    assert line.commands(0.0, 1.0) == [] and not line.greeted
    first.send(hello)
    told(first, 1, 30.0)
    assert [one[12] for one in line.commands(0.0, 1.0)] == [30.0] and line.greeting
    line.greeting = False
    second.send(hello)
    told(second, 900, 80.0)
    told(first, 2, 31.0)
    assert [one[12] for one in line.commands(0.0, 1.0)] == [31.0] and not line.greeting
    line.state(0, 0.0, numbers_of_state(standing(0, 0.0)))
    assert unpack(first.recv(LARGEST)) is not None  # and the states still go to the first
    monkeypatch.setattr(hts_go1_stand_in.line, "TAKEN", 0.0)  # it has been silent for long
    second.send(hello)
    told(second, 1, 40.0)
    assert [one[12] for one in line.commands(0.0, 1.0)] == [40.0] and line.greeting
    for one in (first, second, line._socket):
        one.close()


def test_a_runtime_that_comes_after_another_is_not_kept_waiting_for_its_answer():
    line, done = Line(0, 0.0, 0.0, 0.0, 0), []
    first = UdpLink(f"udp://127.0.0.1:{line.port}", lockstep=True)
    line.commands(0.0, 1.0)
    line.greeting = False
    first.close()  # and never answers the tick
    waiting = threading.Thread(target=lambda: done.append(line.done(0, 0.0, 60.0)))
    waiting.start()
    second = UdpLink(f"udp://127.0.0.1:{line.port}", lockstep=True)
    waiting.join(10.0)
    line._socket.close()
    second.close()
    assert done == [True]


LOADED = """
import sys
from hts_go1_stand_in.cli import ready
body = ready("dev-03", ["power"], 0)
before = set(sys.modules)
for number in range(20):
    body.state(number)
    body.advance()
body.close()
print(sorted(set(sys.modules) - before))
"""


def test_a_robot_that_is_ready_loads_nothing_more_for_its_states():
    """In a process of its own, where nobody has loaded anything before."""
    command = [sys.executable, "-W", "ignore", "-c", LOADED]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
    said = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    assert said == "[]\n"


def visit(bundle: Path, *options: str, robot_options: tuple[str, ...] = ()) -> None:
    """The runtime in one process, the stand-in with a bad line in another, in lockstep."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
    # The pack of `dev-03` is small: with one seed in eight it dips below the limit for a moment as the robot sets off.
    line = ["--reality", "dev-03", "--lockstep", "--loss", "0.02", "--late", "0.02", "--seed", "1"]
    line += ["--quiet-seconds", "300"]
    robot = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-m", "hts_go1_stand_in", "--port", "0", *line, *robot_options],
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    )
    keys, typing = os.pipe()  # an input that does not end
    try:
        port = robot.stdout.readline().split(":")[1].split(",")[0]
        command = ["run", str(bundle), "--link", f"udp://127.0.0.1:{port}", "--lockstep", "--yes", "--mass", "12.2"]
        done = subprocess.run(
            [sys.executable, "-m", "hts_go1_runtime", *command, *options],
            env=environment,
            stdin=keys,
            capture_output=True,
            text=True,
            timeout=1000,
            check=False,
        )
    finally:
        robot.kill()
        robot.wait()
        robot.stdout.close()
        os.close(keys)
        os.close(typing)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_a_visit_over_a_bad_line_ends_with_logs_that_hts_reads(bundle):
    visit(bundle, "--idle-seconds", "1", "--warmup", "2")
    registry = plugins.load()
    for name in ("00", "01"):
        mapping = load_mapping(bundle / "logs" / "mappings" / f"{name}.yaml")
        recording = read_log(registry, [bundle / "logs" / f"{name}.csv"], mapping, registry.make_robot("go1"))
        assert recording.values("base_velocity")[:, 0].mean() == pytest.approx(0.6, abs=0.15)
        assert recording.values("projected_gravity")[:, 2].max() < -0.8
        assert 0.5 < recording.idle["battery_current"] < 3.0
    said = [json.loads(line) for line in (bundle / "logs" / "events.jsonl").read_text().splitlines()]
    packets = next(one for one in said if one["what"] == "figures")["packets"]
    assert packets["lost"] > 0
    assert packets["late"] > 0


@pytest.mark.slow
def test_in_lockstep_two_visits_with_one_seed_give_one_log(bundle):
    tables = []
    for _ in range(2):
        visit(bundle, "--idle-seconds", "0", "--warmup", "0", "--rows", "00")
        with (bundle / "logs" / "00.csv").open() as file:
            rows = list(csv.DictReader(file))
        tables.append([{name: value for name, value in row.items() if name != "step_ms"} for row in rows])
        for path in (bundle / "logs" / "00.csv", bundle / "logs" / "held.json"):
            path.unlink()
    assert len(tables[0]) == 50
    assert tables[0] == tables[1]


@pytest.mark.slow
def test_a_visit_in_a_room_stays_in_it_and_its_rows_have_their_seconds(bundle, tmp_path):
    trace = tmp_path / "trace.csv"
    options = ["--idle-seconds", "0", "--warmup", "0", "--straight", "1.8"]
    visit(bundle, *options, robot_options=("--trace", str(trace)))
    x, y = np.loadtxt(trace, delimiter=",", skiprows=1)[:, 1:3].T  # it begins at 0, facing along x
    assert x.min() > -END and 1.4 < x.max() < 1.8 + END
    assert np.abs(y).max() < SIDE
    said = [json.loads(line)["what"] for line in (bundle / "logs" / "events.jsonl").read_text().splitlines()]
    assert said.count("turned round") >= 1
    registry = plugins.load()
    for name in ("00", "01"):
        mapping = load_mapping(bundle / "logs" / "mappings" / f"{name}.yaml")
        recording = read_log(registry, [bundle / "logs" / f"{name}.csv"], mapping, registry.make_robot("go1"))
        assert recording.seconds == pytest.approx(1.0, abs=0.05)


INTERRUPTED = """
import os, runpy, signal, sys
class Stop:
    def find_spec(self, name, path=None, target=None):
        if name == "hts_go1_stand_in.body" and "while it loads" in sys.argv: os.kill(os.getpid(), signal.SIGINT)
signal.signal(signal.SIGINT, signal.default_int_handler)  # the suite may ignore it
sys.meta_path.insert(0, Stop())
runpy.run_module("hts_go1_stand_in", run_name="__main__", alter_sys=True)
"""


def test_ctrl_c_ends_it_without_a_traceback():
    """Nor a warning that there is no display."""
    without = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "MUJOCO_GL")}
    environment = {**without, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
    command = [sys.executable, "-c", INTERRUPTED, "--port", "0", "--reality", "dev-03"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "env": environment}
    with subprocess.Popen(command, **pipes) as robot:
        assert robot.stdout.readline().startswith("ready on ")
        robot.send_signal(signal.SIGINT)
        assert robot.communicate(timeout=300) == ("0 falls, 0.0 s, 0 packets lost, 0 late\n", "")
        assert robot.returncode == 0
    with subprocess.Popen([*command, "while it loads"], **pipes) as robot:
        assert robot.communicate(timeout=300) == ("", "")
        assert robot.returncode == 130


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--port", "99999"], "argument --port: '99999', expected a whole number from 0 to 65535"),
        (["--port", "0", "--reality", "nosuch"], "nosuch"),
        (["--port", "0", "--objective", "nosuch"], "No objective named 'nosuch'"),
    ],
)
def test_a_mistake_in_what_is_asked_for_is_one_line(words, said, capsys):
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("refused: ") and said in line


def test_a_port_that_is_in_use_is_one_line(capsys):
    first = Line(0, 0.0, 0.0, 0.0, 0)
    with pytest.raises(SystemExit) as ended:
        main(["--port", str(first.port)])
    assert ended.value.code == 2
    assert capsys.readouterr().err == (
        f"refused: --port {first.port}: Address already in use. Choose another; 0 takes a free one.\n"
    )
    first._socket.close()
