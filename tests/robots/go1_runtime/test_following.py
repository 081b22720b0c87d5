"""Whether the joints do what they are told: seen by the torque, and by a robot that damps itself for good."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hts_go1_runtime.errors import Stopped
from hts_go1_runtime.fake import standing
from hts_go1_runtime.following import ASKED, WINDOW, Following
from hts_go1_runtime.link import DAMPING, NOTHING, Command, Counts, Link
from hts_go1_runtime.loop import Loop
from hts_go1_runtime.machine import STAND, TORQUE_LIMIT, Limits
from hts_go1_stand_in.body import PATIENCE, STATE_SECONDS, Body

HOLD = Command(STAND, np.full(12, 40.0), np.full(12, 1.0))
KP, KD = np.full(12, 30.0), np.full(12, 0.6)


class Direct(Link):
    """To a stand-in's body in this process. deaf: no command arrives."""

    simulated, deaf = True, False

    def __init__(self, body: Body) -> None:
        self.counts, self._body, self.sent = Counts(), body, []

    def now(self) -> float:
        return self._body.clock

    def wait(self, until):
        self._body.advance()
        return [dataclasses.replace(self._body.state(round(self.now() / STATE_SECONDS)), received=self.now())]

    def send(self, command):
        self.sent.append((self.now(), command))
        if not self.deaf:
            self._body.command(command)

    def close(self) -> None:
        pass


@pytest.fixture
def body():
    made = Body("dev-03", ["power"], 0)
    made.greet()
    yield made
    made.close()


def steps(loop: Loop, seconds: float, command: Command) -> None:
    for _ in range(round(seconds / loop.period)):
        loop.tick(lambda state: command)


def test_commands_that_no_longer_arrive_stop_the_robot_while_its_states_still_do(body):
    link = Direct(body)
    loop = Loop(link, 0.02, Limits())
    loop.start()
    steps(loop, 0.5, NOTHING)
    steps(loop, 1.0, HOLD)
    link.deaf, since = True, link.now()
    with pytest.raises(Stopped, match=r"not following: the joints give \d+ % .* at least 35 %: commands do not reach"):
        steps(loop, 2.0, HOLD)
    assert PATIENCE < link.now() - since < 0.5
    assert link.sent[-1][1] is DAMPING


def test_a_robot_that_damped_itself_does_not_spring_up_until_it_is_greeted(body):
    loop = Loop(Direct(body), 0.02, Limits(least_torque_share=0.0))
    loop.start()
    steps(loop, 0.5, HOLD)
    loop.watch(PATIENCE + 1.0)
    low = body.state(0)
    assert np.abs(low.q - STAND).max() > 0.3  # it has sunk down
    for _ in range(100):
        body.command(HOLD)
        body.advance()
    assert np.abs(body.state(0).tau).max() < 5.0
    assert body.state(0).q[2::3].max() < low.q[2::3].max() + 0.1  # calves are bent no less
    body.greet()
    for _ in range(round(5 * PATIENCE / STATE_SECONDS)):  # a person thinks: no command yet
        body.advance()
    for _ in range(250):
        body.command(HOLD)
        body.advance()
    assert np.abs(body.state(0).q - STAND).max() < 0.4


def followed(gain: float, delay: int, seconds: float = 2.0, least: float = 0.35) -> str:
    """A walk at 2 Hz whose motors give `gain` times what a command `delay` states ago asks for, within their limits."""
    following, noise, commands = Following(least), np.random.default_rng(0), []
    for number in range(round(seconds / STATE_SECONDS)):
        now = number * STATE_SECONDS
        q = STAND + 0.1 * np.sin(2 * np.pi * 2 * now + np.arange(12))
        dq = 0.1 * 2 * np.pi * 2 * np.cos(2 * np.pi * 2 * now + np.arange(12)) + 0.3 * noise.standard_normal(12)
        if number % 5 == 0:
            command = Command(STAND + 0.3 * np.sin(2 * np.pi * 2 * now + np.arange(12)), KP, KD)
            following.sent(command, now)
        commands.append(command)
        obeyed = commands[max(number - delay, 0)]
        tau = gain * np.clip(obeyed.kp * (obeyed.q - q) - obeyed.kd * dq, -TORQUE_LIMIT, TORQUE_LIMIT)
        state = dataclasses.replace(standing(number, now), received=now, q=q, dq=dq, tau=tau + 0.3 * noise.normal())
        if found := following.state(state):
            return found
    return ""


@pytest.mark.parametrize("delay", [0, 3, 10])
@pytest.mark.parametrize("gain", [0.6, 1.0, 1.4])
def test_worn_gains_and_a_late_line_are_followed(gain, delay):
    assert followed(gain, delay) == ""


@pytest.mark.parametrize("gain", [0.0, 0.2, -1.0])
def test_joints_that_give_little_or_the_opposite_are_not(gain):
    assert "of the torque that their targets ask for" in followed(gain, 2)


def test_a_share_of_nothing_stops_nobody():
    assert followed(-1.0, 2, least=0.0) == ""


def test_the_share_is_what_is_given_of_what_is_asked():
    following = Following(0.5)
    following.sent(Command(STAND + 0.2, KP, KD), 0.0)  # 6 N*m a joint
    said = []
    for number in range(1, 60):
        now = number * STATE_SECONDS
        said.append(following.state(dataclasses.replace(standing(number, now), received=now, tau=np.full(12, 1.5))))
    assert said[round(WINDOW / STATE_SECONDS) - 1] == ""
    assert said[-1].startswith("the joints give 25 % of the torque that their targets ask for, at least 50 %")


def test_a_robot_of_which_little_is_asked_tells_nothing():
    following = Following(0.35)
    following.sent(Command(STAND + 0.9 * ASKED / KP, KP, KD), 0.0)
    for number in range(1, 100):
        now = number * STATE_SECONDS
        assert following.state(dataclasses.replace(standing(number, now), received=now)) == ""
