"""To and fro on a straight: where a robot walks, which steps count, and what ends a visit sitting."""

from __future__ import annotations

import math
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.heading import Heading
from hts_go1_runtime.lane import NUDGE, SETTLING, TURNING, Lane, keys_of, turn_of
from hts_go1_runtime.room import END, SIDE

PERIOD, SETTLE, STRAIGHT = 0.02, 2.0, 4.0
ON_THE_SPOT = (0.0, 0.8)


def policy(vx=(-1.5, 1.5), yaw=(-1.0, 1.0)) -> SimpleNamespace:
    commands = {key: list(one) for key, one in (("vx", vx), ("yaw_rate", yaw)) if one is not None}
    return SimpleNamespace(entry={"trained": {"commands": commands}}, where="p.onnx")


class Robot:
    """A point that follows its command. speed: share of the forward command that it walks; turns: of the yaw rate;
    drift: m/s along and across the room; sensor(vx, vy): what is measured of it; yaw: sign of its IMU's."""

    def __init__(self, speed=1.0, turns=0.8, drift=(0.0, 0.0), sensor=lambda vx, vy: (vx, vy), yaw=1.0) -> None:
        self.speed, self.turns, self.drift, self.sensor, self.yaw = speed, turns, drift, sensor, yaw
        self.place, self.heading, self.forward = np.zeros(2), 0.3, 0.0
        self.random = np.random.default_rng(0)

    def state(self):
        along = np.array([math.cos(self.heading), math.sin(self.heading)])
        moves = self.forward * along + np.array(self.drift)
        vx, vy = self.sensor(float(moves @ along), float(moves @ np.array([-along[1], along[0]])))
        noise = 1e-3 * self.random.standard_normal(2)
        return SimpleNamespace(velocity=(vx + noise[0], vy + noise[1], 0.0), heading=self.yaw * self.heading)

    def told(self, command) -> None:
        along = np.array([math.cos(self.heading), math.sin(self.heading)])
        self.forward += PERIOD / 0.2 * (self.speed * command[0] - self.forward)
        self.place = self.place + PERIOD * (self.forward * along + np.array(self.drift))
        self.heading += PERIOD * self.turns * command[2]


def walk(robot: Robot, seconds: float, speed: float = 1.0, lane: Lane | None = None, turn=ON_THE_SPOT, measured=True):
    """Steps that count for so many seconds: the lane, phase of each step (T,), places along and across the lane (T, 2),
    commands (T, 3)."""
    lane = lane or Lane(STRAIGHT, PERIOD, SETTLE, turn, measured)
    asked, walked = np.array([speed, 0.0, 0.0]), policy()
    phases, places, sent = [], [], []
    left = round(seconds / PERIOD)
    while left:
        left -= lane.counts(asked)
        state = robot.state()
        command = lane.steered(walked, asked, state)
        lane.see(state, command)
        robot.told(command)
        phases.append(lane.phase)
        places.append(robot.place)
        sent.append(command)
    c, s = math.cos(0.3), math.sin(0.3)
    return lane, np.array(phases), np.array(places) @ np.array([[c, -s], [s, c]]), np.array(sent)


@pytest.mark.parametrize("share", [0.7, 1.0, 1.4])
@pytest.mark.parametrize("drift", [(0.0, 0.0), (-0.03, 0.04)])
def test_it_stays_on_its_straight_however_fast_it_walks_and_whatever_pulls(share, drift):
    _, phases, places, sent = walk(Robot(share, drift=drift), 25.0)
    assert (phases == 0).sum() == 25 / PERIOD  # as many seconds of straight walking as were asked for
    assert np.count_nonzero((phases[:-1] == TURNING) & (phases[1:] == SETTLING)) >= 5  # turns
    assert places[:, 0].min() > -END and places[:, 0].max() < STRAIGHT + END
    assert np.abs(places[:, 1]).max() < SIDE
    assert (sent[phases == 0, 0] == 1.0).all()
    assert (sent[phases == TURNING, 0] == 0.0).all() and sent[phases == TURNING, 2].max() == 0.8
    edges = np.flatnonzero(np.diff(phases))
    settled = [end - begin for begin, end in pairwise(edges) if phases[end] == SETTLING]
    assert settled and set(settled) == {round(SETTLE / PERIOD)}


def test_who_does_not_turn_on_the_spot_comes_back_beside_its_way_out():
    _, _, places, _ = walk(Robot(turns=1.0), 15.0, turn=(0.4, 0.8))
    assert places[:, 0].min() > -END - 0.5 and places[:, 0].max() < STRAIGHT + END + 0.5
    assert places[:, 1].min() > -SIDE and places[:, 1].max() < 1.0 + SIDE
    assert places[:, 1].max() > 0.8


def test_without_a_speed_sensor_it_counts_what_it_was_told():
    nothing = Robot(sensor=lambda vx, vy: (math.nan, math.nan))
    _, _, places, _ = walk(nothing, 10.0, measured=False)
    assert places[:, 0].min() > -END and places[:, 0].max() < STRAIGHT + END


@pytest.mark.parametrize(
    ("robot", "said"),
    [
        (Robot(turns=0.0), "Told to turn round at 0.8 rad/s, its heading changed by 0 of 180 degrees in 3.0 s"),
        (Robot(turns=0.3), "its heading changed by .* of 180 degrees in 11.8 s: this policy does not turn"),
        (Robot(turns=-0.8), "degrees off the straight|to the right: the IMU's yaw counts the other way"),
        (Robot(yaw=-1.0), "degrees off the straight|to the right: the IMU's yaw counts the other way"),
        (Robot(sensor=lambda vx, vy: (-vx, vy)), "has shown -1.00 m/s, backwards, for 1 s"),
        (Robot(sensor=lambda vx, vy: (math.nan, vy)), "has given nothing new for 0.5 s"),
        (Robot(sensor=lambda vx, vy: (0.3 * vx, vy)), "Told to walk 9.0 m since it turned, .* less than half"),
    ],
)
def test_what_does_not_turn_or_measures_wrongly_ends_the_visit(robot, said):
    with pytest.raises(RuntimeFault, match=said) as found:
        walk(robot, 60.0)
    assert "\n" not in str(found.value)


def test_a_straight_that_is_walked_while_it_settles_ends_the_visit():
    with pytest.raises(
        RuntimeFault, match=r"The straight of 4 m is walked while the robot settles \(2 s after each turn\)"
    ):
        walk(Robot(speed=2.5), 10.0)


def test_a_sensor_that_stands_still_ends_the_visit():
    robot = Robot(sensor=lambda vx, vy: (0.9, 0.0))
    robot.random = SimpleNamespace(standard_normal=lambda count: np.zeros(count))
    with pytest.raises(RuntimeFault, match="has given nothing new"):
        walk(robot, 30.0)


def test_the_operators_keys_turn_it_round_and_move_its_heading():
    lane = Lane(STRAIGHT, PERIOD, SETTLE, ON_THE_SPOT, True)
    robot = Robot()
    walk(robot, 1.0, lane=lane)
    keys_of(lane)["t"]()
    _, phases, places, _ = walk(robot, 1.0, lane=lane)
    assert (phases == TURNING).any() and places[:, 0].min() > -END and places[:, 0].max() < 3.5
    assert sorted(keys_of(Heading())) == ["l", "r"]  # nowhere to turn round
    heading, state = Heading(), robot.state()
    asked = np.array([1.0, 0.0, 0.0])
    assert heading.steered(policy(), asked, state)[2] == 0.0
    for key in ("l", "l", "r"):
        keys_of(heading)[key]()
    assert heading.steered(policy(), asked, state)[2] == pytest.approx(0.5 * NUDGE)


def test_one_turn_is_for_all_policies_of_a_bundle_and_within_what_they_were_trained_with():
    assert turn_of([policy(), policy()]) == (0.0, 0.8)
    assert turn_of([policy(), policy(vx=(0.4, 1.2), yaw=(-1.0, 0.5))]) == (0.4, 0.5)
    assert turn_of([policy(vx=None, yaw=None)]) == (0.0, 0.8)
    assert turn_of([policy()], 0.5) == (0.0, 0.4)
    with pytest.raises(RuntimeFault, match=r"p.onnx: was trained with yaw rates from 0 to 0 rad/s, and to turn round"):
        turn_of([policy(), policy(yaw=(0.0, 0.0))])


def test_one_that_is_told_to_stand_neither_turns_nor_moves_along():
    lane = Lane(STRAIGHT, PERIOD, SETTLE, ON_THE_SPOT, True)
    lane.turn_now()
    still = np.zeros(3)
    assert lane.counts(still) and lane.phase == 0
    assert (lane.steered(policy(), still, Robot().state()) == 0).all()
