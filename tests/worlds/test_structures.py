"""Structures of a reality, each by what physics says that it changes."""

from __future__ import annotations

import numpy as np
import pytest

from hts.contracts import Instrument, PhysicsSample
from hts.worlds.base import Operator, request_id, seed_sequence, walking
from hts.worlds.twin.dynamics import Dynamics
from hts.worlds.twin.ground import CELL, MARGIN, PERIOD, Conditions, Wind, heights
from hts.worlds.twin.link import Link
from hts.worlds.twin.model import build
from hts.worlds.twin.parameters import DynamicsParameters, TwinSettings
from hts.worlds.twin.programme import Block, Session
from hts.worlds.twin.session import Batch, Standing
from hts.worlds.twin.structure import BodyStructure, SessionParameters

PLAIN = {
    "encoder_offset": 0.0,
    "friction_spread": 0.0,
    "torque_constant_error": 0.0,
    "gear_loss": 0.0,
    "gear_loss_extra_stage": 0.0,
    "full_torque_speed": 0.5,
    "actuation_delay": 0.0,
}


class Witness(Instrument):
    """Keeps the torques of every step; shows a supply that it is told."""

    channels = ()

    def __init__(self, supply: float | None = None):
        self._supply = supply

    def reset(self, num_worlds, rng):
        self.num = num_worlds
        self.motor, self.current = [], []

    def step(self, sample: PhysicsSample):
        self.motor.append(sample.motor_torque.copy())
        self.current.append(None if sample.current_torque is None else sample.current_torque.copy())

    def read(self):
        return {}

    def idle(self):
        return {}

    def supply(self):
        return None if self._supply is None else np.full(self.num, self._supply)


def body(robot, num_worlds=1, conditions=None, seed=0, **structure) -> Dynamics:
    parameters = DynamicsParameters(**PLAIN, structure=structure)
    machine = build(robot, parameters)
    return Dynamics(machine, parameters, num_worlds, conditions, np.random.default_rng(seed))


def first_step(made: Dynamics, target, speed=0.0) -> Witness:
    """Torques of the first step from the default pose, with targets so far away and joints so fast."""
    witness = Witness()
    witness.reset(made.num_worlds, np.random.default_rng(0))
    made.qvel[:, made.machine.joint_dof] = speed
    made.advance(np.tile(np.array(made.machine.spec.default_pose) + target, (made.num_worlds, 1)), 1, (witness,))
    return witness


def stood(made: Dynamics, seconds=1.0) -> Dynamics:
    stand = Standing(made.machine)
    stand.start(made.num_worlds)
    for _ in range(round(seconds * 50)):
        made.advance(stand.targets({}), 20, ())
    return made


# ----------------------------------------------------------------------------------------------- drives


def test_motors_that_differ_make_other_torques_of_one_current(robot):
    alike, spread = first_step(body(robot), 0.1), first_step(body(robot, torque_constant_spread=0.1), 0.1)
    assert alike.current[0] is None
    assert spread.current[0] == pytest.approx(alike.motor[0])
    factor = spread.motor[0] / spread.current[0]
    assert np.abs(factor - 1).max() < 0.1 and np.ptp(factor) > 0.05


def test_a_saturated_motor_loses_its_share_of_torque_at_the_limit_and_a_quarter_of_that_at_half(robot):
    limit = np.array(robot.spec.torque_limit)
    made = body(robot, torque_saturation=0.2)
    full = first_step(made, 50.0)
    assert full.current[0][0] == pytest.approx(limit)
    assert full.motor[0][0] == pytest.approx(0.8 * limit)
    half = first_step(body(robot, torque_saturation=0.2), 0.5 * limit / np.array(robot.spec.kp))
    assert half.motor[0][0] == pytest.approx(0.95 * 0.5 * limit)


def test_what_the_firmware_believes_is_the_current_and_not_the_torque(robot):
    made = body(robot, torque_saturation=0.2)
    first_step(made, 50.0)
    assert made.commanded_torque[0] == pytest.approx(np.array(robot.spec.torque_limit))


def test_stiction_adds_dry_friction_at_low_speed_and_nothing_at_high_speed(robot):
    def lost(speed, **structure):
        made = body(robot, **structure)
        witness = first_step(made, 0.0, speed)
        return (witness.motor[0] - made._control[0, 0])[0], made.machine.friction

    extra, dry = lost(0.1, stribeck_ratio=0.5, stribeck_speed=0.4)
    assert (extra > 0.05).all()
    assert (extra <= 0.5 * dry * np.exp(-((0.1 / 0.4) ** 2)) + 1e-12).all()
    assert lost(4.0, stribeck_ratio=0.5, stribeck_speed=0.4)[0] == pytest.approx(0.0, abs=1e-9)
    assert lost(0.1)[0] == pytest.approx(0.0)


def test_play_shifts_the_encoder_to_the_side_that_the_motor_pushes_to(robot):
    loose, tight = stood(body(robot, backlash=0.02)), stood(body(robot))
    shift = loose.joint_position() - loose.qpos[:, loose.machine.joint_qpos]
    pushing = np.abs(loose._motor) > 1.0
    assert pushing.sum() >= 4
    assert shift[pushing] == pytest.approx(0.01 * np.sign(loose._motor[pushing]), rel=0.02)
    assert (tight.joint_position() == tight.qpos[:, tight.machine.joint_qpos]).all()


def test_a_sagging_supply_lowers_torque_above_the_knee_and_leaves_standstill_alone(robot):
    limit, no_load = np.array(robot.spec.torque_limit), np.array(robot.spec.velocity_limit)

    def motor(ratio, speed):
        made = body(robot, torque_follows_supply=True)
        made.set_supply(np.array([ratio]))
        return first_step(made, 50.0, speed).motor[0][0]

    # limit / (1 - 0.5) * (1 - speed / (ratio * no_load)), at most the limit
    assert motor(1.0, 0.75 * no_load) == pytest.approx(0.5 * limit)
    assert motor(0.9, 0.75 * no_load) == pytest.approx(2 * (1 - 0.75 / 0.9) * limit)
    assert motor(0.9, 0.0) == pytest.approx(limit)


@pytest.mark.parametrize("sags", [True, False])
def test_a_twin_asks_its_instruments_for_the_supply_only_if_torque_follows_it(robot, sags):
    settings = TwinSettings(dynamics={"structure": {"torque_follows_supply": sags}})
    made = Batch(robot, settings, {"x": Witness(0.8)}, 1, seed_sequence(0, request_id("x")))
    made.run([Session(id="s", blocks=(Block(policy=None, schedule=walking(0.0, 0.1)),))], "twin")
    rated = made.body._rated_slope
    assert (
        (made.body._limit_slope == pytest.approx(rated / 0.8))
        if sags
        else np.array_equal(made.body._limit_slope, rated)
    )
    made.close()


# ------------------------------------------------------------------------------------------------- link


def received(structure: BodyStructure, packets: int, num_worlds: int = 1, delay: int = 3) -> np.ndarray:
    """Which packet each robot follows, in each of 20 steps a packet, (steps, W)."""
    link, target = Link(delay, structure, 0.001, num_worlds, np.random.default_rng(1)), np.full((num_worlds, 1), -1.0)
    rows = []
    for packet in range(packets):
        link.send(np.full((num_worlds, 1), float(packet)))
        for _ in range(20):
            link.receive(target)
            rows.append(target[:, 0].copy())
    return np.array(rows)


def test_without_jitter_and_loss_each_target_acts_after_the_delay():
    assert received(BodyStructure(), 2)[:, 0].tolist() == [-1.0] * 3 + [0.0] * 20 + [1.0] * 17


def test_a_lost_packet_keeps_the_old_target():
    rows = received(BodyStructure(lost_packets=0.1), 1000)[19::20, 0]
    late = np.arange(1000) - rows
    assert set(late[rows >= 0]) >= {0.0, 1.0}
    assert (late > 0).mean() == pytest.approx(0.1, abs=0.03)


def test_jitter_is_uniform_up_to_its_length_and_each_robots_own():
    rows = received(BodyStructure(command_jitter=0.01), 500, num_worlds=2)
    arrival = np.array([[np.flatnonzero(rows[:, w] == k)[0] - 20 * k for k in range(500)] for w in (0, 1)])
    assert arrival.min() == 3 and arrival.max() == 13
    assert arrival.mean() == pytest.approx(8, abs=0.5)
    assert (arrival[0] != arrival[1]).any()


# ------------------------------------------------------------------------------------------------ ground


def test_bumps_reach_their_height_and_repeat(robot):
    surface = heights(BodyStructure(floor_roughness=0.01, bump_length=0.4), 3)
    assert surface.min() >= 0 and surface.max() <= 1 and max(surface.max(), 1 - surface.min()) == pytest.approx(1)
    period = round(PERIOD / CELL)
    assert surface[:, period:] == pytest.approx(surface[:, :-period], abs=1e-9)
    assert surface.shape[0] == round(2 * (PERIOD / 2 + MARGIN) / CELL) + 1


def test_a_robot_stands_on_bumps_and_is_set_back_by_a_period(robot):
    made = body(robot, floor_roughness=0.01, bump_length=0.4)
    made.qpos[:, 0] = 1.9
    stood(made)
    assert made.foot_force.sum() == pytest.approx(9.81 * made.machine.total_mass, rel=0.03)
    made.qpos[:, 0] += 0.5
    before = made.qpos[0, 0]
    stood(made, 0.02)
    assert made.qpos[0, 0] == pytest.approx(before - PERIOD, abs=0.01)


def test_on_a_slope_the_floor_carries_less_than_the_weight_and_gravity_is_seen_tilted(robot):
    conditions = Conditions.drawn(SessionParameters(), 2, np.random.default_rng(0))
    made = stood(body(robot, 2, conditions, floor_slope=2.0))
    assert np.linalg.norm(made.down, axis=1) == pytest.approx([1, 1])
    assert np.degrees(np.arccos(-made.down[:, 2])) == pytest.approx([2, 2])
    across = np.arctan2(made.down[:, 1], made.down[:, 0])
    assert across == pytest.approx(conditions.slope_direction)
    assert made.foot_force.sum(axis=1) == pytest.approx(
        9.81 * made.machine.total_mass * np.cos(np.radians(2)), rel=0.02
    )


def test_floor_friction_differs_between_sessions_within_its_spread():
    drawn = Conditions.drawn(SessionParameters(floor_friction_spread=0.2), 400, np.random.default_rng(0))
    assert np.abs(drawn.friction - 1).max() <= 0.2 and drawn.friction.std() == pytest.approx(0.2 / 3**0.5, rel=0.1)


def test_a_payload_adds_its_mass_where_it_sits(robot):
    plain, loaded = (
        build(robot, DynamicsParameters()),
        build(
            robot,
            DynamicsParameters(structure={"payload_mass": 1.0, "payload_x": 0.1, "payload_z": 0.1}),
        ),
    )
    assert loaded.total_mass - plain.total_mass == pytest.approx(1.0)
    trunk = [machine.model.body(robot.spec.trunk_body) for machine in (plain, loaded)]
    mass, centre = trunk[0].mass[0], trunk[0].ipos
    assert trunk[1].ipos == pytest.approx((mass * centre + np.array([0.1, 0.0, 0.1])) / (mass + 1.0))
    # a point at distance d from the axis through both: reduced mass times d^2 more, about every axis across the arm
    arm = np.array([0.1, 0.0, 0.1]) - centre
    grown = trunk[1].inertia.sum() - trunk[0].inertia.sum()
    assert grown == pytest.approx(2 * mass / (mass + 1.0) * (arm @ arm))


def test_wind_pushes_with_its_mean_force_and_gusts(robot):
    structure = BodyStructure(wind_force=4.0, wind_gust=0.3)
    wind = Wind(structure, np.full(200, np.pi / 2), np.random.default_rng(0))
    force = np.array([wind.blow(0.02) for _ in range(1000)])
    assert force[..., 0] == pytest.approx(np.zeros((1000, 200)), abs=1e-9)
    assert force[..., 1].mean() == pytest.approx(4.0, rel=0.02)
    assert force[..., 1].std() == pytest.approx(1.2, rel=0.05)


def test_a_robot_leans_against_the_wind(robot):
    conditions = Conditions.drawn(SessionParameters(), 1, np.random.default_rng(0))
    calm, windy = stood(body(robot, 1)), stood(body(robot, 1, conditions, wind_force=6.0))
    sideways = np.sign(np.sin(conditions.wind_direction[0]))
    assert sideways * (windy.qpos[0, 1] - calm.qpos[0, 1]) > 1e-4


# ---------------------------------------------------------------------------------------------- sessions


def test_an_operator_with_an_offset_keeps_another_heading():
    operator = Operator(2, gain=np.array([1.0, 2.0]), offset=np.array([0.1, 0.1]))
    commanded = np.array([[0.5, 0.0, 0.0]] * 2)
    operator.command(commanded, np.zeros(2))
    assert operator.command(commanded, np.zeros(2))[:, 2] == pytest.approx([0.05, 0.1])


def test_sessions_of_one_request_differ_and_are_the_same_when_asked_again(robot):
    def drawn(request):
        settings = TwinSettings(sessions={"heading_offset": 0.1, "floor_friction_spread": 0.1})
        return Batch(robot, settings, {}, 3, seed_sequence(0, request_id(request))).conditions

    first, again, other = drawn("a"), drawn("a"), drawn("b")
    assert len(set(first.heading_offset)) == 3
    assert (first.heading_offset == again.heading_offset).all() and (first.friction == again.friction).all()
    assert (first.heading_offset != other.heading_offset).all()
