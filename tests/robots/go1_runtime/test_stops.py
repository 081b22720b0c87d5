"""Each reason to stop: the damping command at once, nothing else after it, and a word that says why."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from hts_go1_runtime.errors import Stopped
from hts_go1_runtime.fake import FAULTS, failing, standing
from hts_go1_runtime.link import DAMPING, Command
from hts_go1_runtime.loop import Loop
from hts_go1_runtime.machine import STAND, Limits
from hts_go1_runtime.operator_key import StopFile
from hts_go1_runtime.safety import REASONS, Guard

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)
ScriptedLink = scripted.ScriptedLink

WALK = Command(STAND, np.full(12, 30.0), np.full(12, 0.6))
FAILS_AT = 0.301  # s


def is_damping(command: Command) -> bool:
    return not command.kp.any() and (command.kd == DAMPING.kd).all()


def run(link, steps=100, pressed=lambda: None, make=lambda state: WALK) -> Stopped:
    loop = Loop(link, 0.02, Limits(), pressed)
    loop.start()

    def walk() -> None:
        for _ in range(steps):
            loop.tick(make)

    with pytest.raises(Stopped) as stopped:
        walk()
    with pytest.raises(Stopped):  # for good
        loop.tick(make)
    return stopped.value


IN_A_STATE = (
    "tilt",
    "joint limit",
    "joint speed",
    "over-current",
    "low voltage",
    "temperature",
    "not finite",
    "orientation",
)


def test_every_reason_of_a_state_can_be_played():
    assert set(IN_A_STATE) <= set(FAULTS) & set(REASONS)


@pytest.mark.parametrize("fault", IN_A_STATE)
def test_a_bad_state_damps_the_robot_within_40_ms(fault):
    def spoil(state):
        return failing(state, fault) if state.stamp >= FAILS_AT else state

    link = ScriptedLink(spoil)
    stopped = run(link)
    assert stopped.reason == fault
    assert stopped.reason in REASONS
    first = next(number for number, (_, command) in enumerate(link.sent) if is_damping(command))
    assert all(is_damping(command) for _, command in link.sent[first:])
    assert 0 <= link.sent[first][0] - FAILS_AT <= 0.04


@pytest.mark.parametrize("stamp", [math.nan, math.inf])
def test_a_time_stamp_that_is_no_number_is_a_fault(stamp):
    """No state could be told to be late by it."""
    link = ScriptedLink(lambda state: dataclasses.replace(state, stamp=stamp) if state.stamp >= FAILS_AT else state)
    assert run(link).reason == "not finite"


def test_silence_damps_the_robot_within_40_ms():
    link = ScriptedLink(lambda state: None if state.stamp >= FAILS_AT else state)
    stopped = run(link)
    assert stopped.reason == "lost link"
    assert is_damping(link.sent[-1][1])
    assert link.sent[-1][0] - FAILS_AT <= 0.04


def test_a_few_lost_states_stop_nobody():
    link = ScriptedLink(lambda state: state if state.sequence % 5 == 0 else None)  # four of five are lost
    loop = Loop(link, 0.02, Limits())
    loop.start()
    for _ in range(100):
        loop.tick(lambda state: WALK)
    assert len(link.sent) == 100


def test_states_that_come_ever_later_are_a_lost_link():
    guard = Guard(Limits())
    for number in range(100):
        now = 0.004 * number
        state = dataclasses.replace(standing(number, 7.0 + now), received=now)
        assert guard.silence(state, now) is None
    state = dataclasses.replace(standing(100, 7.0 + 0.4 - 0.03), received=0.4)
    assert guard.silence(state, 0.4) == ("lost link", "states arrive 30 ms late, at most 24")


def test_clocks_that_drift_apart_are_no_lost_link():
    guard = Guard(Limits())
    for number in range(15_000):  # ten minutes
        now = 0.04 * number
        state = dataclasses.replace(standing(0, 0.0), sequence=number, stamp=now * (1 - 5e-5), received=now)
        assert guard._stale(state) is None


def test_the_silence_while_a_person_thought_is_no_lost_link():
    class Slow(ScriptedLink):
        silent = False

        def wait(self, until):
            found, self.silent = [] if self.silent else super().wait(until), False
            return found

    link = Slow()
    loop = Loop(link, 0.02, Limits())
    loop.start()
    link._clock += 5.0
    link.silent = True
    loop.resume()
    for _ in range(10):
        loop.tick(lambda state: WALK)
    assert len(link.sent) == 10


def test_the_operators_file_damps_the_robot(tmp_path):
    link, steps = ScriptedLink(), []

    def make(state):
        steps.append(state)
        if len(steps) == 10:
            (tmp_path / "STOP").touch()
        return WALK

    stopped = run(link, pressed=StopFile(tmp_path / "STOP"), make=make)
    assert (stopped.reason, stopped.detail) == ("operator", "the file STOP is there")
    assert len(steps) == 10


def test_a_target_that_is_no_number_is_never_sent():
    link = ScriptedLink()
    stopped = run(link, make=lambda state: Command(np.full(12, math.nan), WALK.kp, WALK.kd))
    assert stopped.reason == "not finite"
    assert all(np.isfinite(command.q).all() for _, command in link.sent)


def test_a_stop_from_another_thread_cannot_be_undone_by_a_step_that_is_under_way():
    link = ScriptedLink()
    loop = Loop(link, 0.02, Limits())
    loop.start()

    def make(state):
        other = threading.Thread(target=loop.brake, args=("operator", "a key"))
        other.start()
        other.join()
        return WALK

    with pytest.raises(Stopped, match="operator"):
        loop.tick(make)
    assert [is_damping(command) for _, command in link.sent] == [True]


class Clocked(ScriptedLink):
    """Watched as in real time, by a clock of its own: however busy a computer is, only a step that hangs is late."""

    simulated = False

    def hang(self, seconds: float) -> None:
        self._clock += seconds


def test_a_step_that_hangs_is_answered_while_it_hangs():
    link, hung = Clocked(), []
    loop = Loop(link, 0.02, Limits(late=0.1))
    loop.start()

    def make(state):
        hung.append(loop.due)
        while not link.sent and link.now() < loop.due + 30:
            link.hang(0.01)
            time.sleep(0.01)
        hung.append(link.now())
        return WALK

    loop.resume()
    with pytest.raises(Stopped, match="late loop"):
        loop.tick(make)
    loop.close()
    assert is_damping(link.sent[0][1])
    assert hung[0] + 0.09 < link.sent[0][0] <= hung[1] < hung[0] + 30
    assert len(link.sent) == 1


def test_a_step_that_is_done_while_the_watching_thread_reads_the_clock_is_not_late():
    looked = threading.Event()

    class Goes(Clocked):
        def now(self):
            if threading.current_thread() is not threading.main_thread():
                loop._alarm += 5.0  # the next step's, meanwhile
                self._clock += 5.0
                looked.set()
            return super().now()

    link = Goes()
    loop = Loop(link, 0.02, Limits(late=0.1))
    loop._alarm = 1.0
    loop.start()
    assert looked.wait(60)
    loop.close()
    assert link.sent == []


def test_a_process_that_was_kept_from_looking_while_a_person_thought_looks_again():
    class Kept(Clocked):
        kept = 0

        def wait(self, until):
            if self.kept:
                self.kept -= 1
                self.hang(5.0)
                return []
            return super().wait(until)

    link = Kept()
    loop = Loop(link, 0.02, Limits())
    loop.start()
    loop.pause()
    link.kept = 4
    seen = loop.resume()
    loop.close()
    assert seen and seen[0].stamp > 20.0


def test_a_line_that_refuses_to_send_undoes_no_stop_and_is_a_lost_link():
    class Gone(ScriptedLink):
        gone = False

        def send(self, command):
            if self.gone:
                raise OSError(101, "Network is unreachable")
            super().send(command)

    link = Gone()
    loop = Loop(link, 0.02, Limits())
    loop.start()
    loop.tick(lambda state: WALK)
    link.gone = True
    with pytest.raises(Stopped, match=r"lost link: a command could not be sent \(Network is unreachable\)"):
        loop.tick(lambda state: WALK)
    loop.damp(0.1)  # goes on trying, and raises nothing
    link.gone = False
    loop.damp(0.1)
    assert is_damping(link.sent[-1][1])
    with pytest.raises(Stopped, match="lost link"):
        loop.tick(lambda state: WALK)
    other = Gone()
    braked = Loop(other, 0.02, Limits())
    braked.start()
    other.gone = True
    braked.brake("operator", "a key")  # raises nothing
    with pytest.raises(Stopped, match="operator"):
        braked.tick(lambda state: WALK)


def test_an_address_without_a_way_to_it_is_silence(monkeypatch):
    import socket

    from hts_go1_runtime.udp import UdpLink

    far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    far.bind(("127.0.0.1", 0))
    link = UdpLink(f"udp://127.0.0.1:{far.getsockname()[1]}")

    class Unreachable:
        def send(self, data):
            raise OSError(101, "Network is unreachable")

        def recv(self, size):
            raise OSError(101, "Network is unreachable")

    real, link._socket = link._socket, Unreachable()
    link.send(WALK)
    assert link.counts.extra["unsent"] == 1 and link._drain() == []
    link._socket = real
    link.close()
    far.close()


def test_steps_that_are_always_late_still_look_at_every_state():
    class RealTime(ScriptedLink):
        """In real time; each step takes a little longer than it may."""

        simulated, tips = False, float("inf")

        def now(self):
            return self._clock

        def wait(self, until):
            if until <= self._clock:  # no time is left: what is there already
                self._clock -= scripted.STATE_SECONDS
            (state,) = super().wait(until)
            return [failing(state, "tilt") if state.stamp >= self.tips else state]

    link, steps = RealTime(), []
    loop = Loop(link, 0.02, Limits())
    loop.start()
    loop._alarm = float("inf")

    def make(state):
        steps.append(link._clock)
        if len(steps) == 3:
            link.tips = link._clock
        link._clock += 0.0205
        return WALK

    def walk() -> None:
        for _ in range(40):
            loop.tick(make)

    with pytest.raises(Stopped, match="tilt"):
        walk()
    loop.close()
    assert len(steps) == 3  # nothing was sent on a state that nobody had looked at


@pytest.mark.parametrize("length", [0.0, 0.5, 0.94, 1.06])
def test_a_quaternion_that_is_no_rotation_is_no_upright_robot(length):
    turned = length * np.array([math.cos(0.1), 0.0, math.sin(0.1), 0.0])
    reason, detail = Guard(Limits()).state(dataclasses.replace(standing(0, 0.0), quaternion=turned))
    assert reason == "orientation"
    assert f"length {length:.2f}, a rotation's is 1 within 0.05" in detail and "estart the robot" in detail
    nearly = 1.04 * np.array([math.cos(0.1), 0.0, math.sin(0.1), 0.0])
    assert Guard(Limits()).state(dataclasses.replace(standing(0, 0.0), quaternion=nearly)) is None


def test_a_state_is_judged_by_the_robots_own_numbers():
    guard = Guard(Limits())
    assert guard.state(standing(0, 0.0)) is None
    hot = dataclasses.replace(standing(0, 0.0), temperature=np.where(np.arange(12) == 7, 81.0, 40.0))
    assert guard.state(hot) == ("temperature", "RR_thigh_joint at 81 degC, at most 80")
    unknown = dataclasses.replace(standing(0, 0.0), temperature=np.full(12, math.nan), current=math.nan)
    assert guard.state(unknown) is None
