"""The Go1's model against its sources: masses, inertias, joints, limits, stance, torque."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from pydantic import ValidationError

from hts.sim.models import compile_model

pytest.importorskip("hts_go1", reason="the robot of these tests is not installed")
from hts_go1 import constants as c
from hts_go1.inertia import Rigid, joined
from hts_go1.model import links, trunk
from hts_go1.robot import SPEC, Go1, Go1Settings


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return compile_model(Go1(Go1Settings()))


@pytest.fixture
def data(model) -> mujoco.MjData:
    """Standing in the default pose, feet just on the floor."""
    data = mujoco.MjData(model)
    data.qpos[2] = 2 * 0.213 * math.cos(0.9) + 0.023
    data.qpos[7:] = SPEC.default_pose
    data.ctrl[:] = SPEC.default_pose
    mujoco.mj_forward(model, data)
    return data


# ------------------------------------------------------------------------------------------- rigid bodies


def test_two_points_joined_have_the_inertia_of_a_dumbbell():
    zero = np.zeros((3, 3))
    bell = joined([Rigid(1.0, np.array([x, 0.0, 0.0]), zero) for x in (-1.0, 1.0)])
    assert bell.mass == 2.0
    np.testing.assert_allclose(bell.com, 0.0)
    np.testing.assert_allclose(bell.inertia, np.diag([0.0, 2.0, 2.0]))  # 2 x 1 kg x (1 m)^2


def test_joining_does_not_depend_on_the_origin():
    bodies = [Rigid.from_values(*c.THIGH), Rigid.from_values(*c.FOOT).shifted((0, 0.1, -0.2))]
    moved = joined([body.shifted((1.0, -2.0, 3.0)) for body in bodies])
    np.testing.assert_allclose(moved.inertia, joined(bodies).inertia, atol=1e-12)


def test_the_robot_weighs_13_1_kg(model):
    # 5.204 + 4 x (0.591 + 0.92 + 0.135862 + 0.06) + 12 x 0.089; the URDF's sum of 13.10 also counts 1 g of IMU.
    assert model.body_mass.sum() == pytest.approx(13.099448, abs=1e-6)


@pytest.mark.parametrize(
    ("body", "mass"),
    [("trunk", 5.204 + 4 * 0.089), ("FL_hip", 0.591 + 0.089), ("FL_thigh", 0.92 + 0.089), ("FL_calf", 0.135862 + 0.06)],
)
def test_each_link_carries_the_rotors_fixed_to_it(model, body, mass):
    assert model.body(body).mass[0] == pytest.approx(mass, abs=1e-9)


def test_the_trunk_and_its_hip_rotors_balance_where_the_lever_rule_says():
    # The rotors lie symmetrically, so only the trunk's own offset counts: 5.204 x 0.0223 / 5.56.
    np.testing.assert_allclose(trunk().com, np.array([0.0223, 0.002, -0.0005]) * 5.204 / 5.56, atol=1e-12)


@pytest.mark.parametrize(
    ("part", "com", "principal"),
    [
        # mujoco_menagerie, unitree_go1/go1.xml, commit 28ffb48b: front right leg with rotors and foot merged in.
        ("hip", (-0.0049166, 0.00762615, -8.865e-5), (0.000734064, 0.000468438, 0.000398719)),
        ("thigh", (-0.00304722, 0.019315, -0.0305004), (0.00478717, 0.00460903, 0.000709268)),
        ("calf", (0.00429862, 0.000976676, -0.146197), (0.00149767, 0.00148468, 3.58427e-5)),
    ],
)
def test_merged_links_agree_with_another_derivation(part, com, principal):
    leg = links("FR")[part]
    ours = np.sort(np.linalg.eigvalsh(leg.inertia))[::-1]
    np.testing.assert_allclose(ours, principal, rtol=2e-3, atol=1e-7)
    # That source mirrors no calf: its thin links lie 1 mm to one side on both sides of the robot.
    expected = np.array(com) * ((1, -1, 1) if part == "calf" else (1, 1, 1))
    np.testing.assert_allclose(leg.com, expected, atol=1e-6)


def test_left_and_right_legs_are_mirror_images():
    for part in ("hip", "thigh", "calf"):
        left, right = links("RL")[part], links("RR")[part]
        flip = np.diag([1.0, -1.0, 1.0])
        np.testing.assert_allclose(right.com, flip @ left.com, atol=1e-15)
        np.testing.assert_allclose(right.inertia, flip @ left.inertia @ flip, atol=1e-15)


def test_every_inertia_is_that_of_a_possible_body(model):
    for row in model.body_inertia[1:]:
        largest, rest = row.max(), row.sum() - row.max()
        assert row.min() > 0 and largest <= rest  # the triangle inequality of principal moments


# ------------------------------------------------------------------------------------------------- joints


def test_joints_come_leg_by_leg_in_the_order_of_the_sdk(model):
    legs = ["FR", "FL", "RR", "RL"]
    expected = [f"{leg}_{part}_joint" for leg in legs for part in ("hip", "thigh", "calf")]
    assert list(SPEC.joint_names) == expected
    assert [model.joint(index + 1).name for index in range(12)] == expected  # joint 0 is the free joint
    assert [model.actuator(index).name for index in range(12)] == expected


def test_limits_are_those_of_the_urdf(model):
    ranges = {"hip": (-0.863, 0.863), "thigh": (-0.686, 4.501), "calf": (-2.818, -0.888)}
    torques = {"hip": 23.7, "thigh": 23.7, "calf": 35.55}
    speeds = {"hip": 30.1, "thigh": 30.1, "calf": 20.06}
    for index, name in enumerate(SPEC.joint_names):
        part = name.split("_")[1]
        assert tuple(model.joint(name).range) == ranges[part] == SPEC.position_limit[index]
        assert tuple(model.actuator(name).forcerange) == (-torques[part], torques[part])
        assert SPEC.torque_limit[index] == torques[part] and SPEC.velocity_limit[index] == speeds[part]


def test_armature_is_rotor_inertia_times_ratio_squared(model):
    # 0.000111842 kg m^2 x 6.33^2, and the knee x 1.5^2 more.
    assert model.joint("FL_hip_joint").armature[0] == pytest.approx(0.0044814, abs=1e-7)
    assert model.joint("FL_calf_joint").armature[0] == pytest.approx(0.0044814 * 2.25, abs=1e-6)


def test_motor_constants_explain_the_speed_limits():
    # No load: 22.2 V / sqrt(3) of phase voltage over the flux of 2/3 of the rotor's torque constant, through the gear.
    motors = SPEC.motors
    assert motors is not None
    for index in (0, 2):
        flux = motors.torque_constant[index] / motors.gear_ratio[index] / 1.5
        no_load = 22.2 / math.sqrt(3) / flux / motors.gear_ratio[index]
        assert no_load == pytest.approx(SPEC.velocity_limit[index], rel=2e-3)


# ------------------------------------------------------------------------------------------------- stance


def test_in_the_default_pose_the_feet_are_under_the_hips(model, data):
    for leg, (end, side) in {"FR": (1, -1), "FL": (1, 1), "RR": (-1, -1), "RL": (-1, 1)}.items():
        x, y, z = data.site(f"{leg}_foot").xpos
        # Thigh back by 0.9 and calf forward by 0.9 cancel; the foot hangs hip offset and thigh offset to the side.
        assert (x, y) == (pytest.approx(end * 0.1881, abs=1e-6), pytest.approx(side * (0.04675 + 0.08), abs=1e-6))
        assert z == pytest.approx(0.023, abs=1e-6)
    assert pytest.approx(2 * 0.213 * math.cos(0.9) + 0.023, abs=0.003) == SPEC.base_height


def test_standing_still_the_feet_carry_the_weight(model, data):
    for _ in range(400):
        mujoco.mj_step(model, data)
    forces = [data.sensor(f"touch_{leg}").data[0] for leg in c.LEGS]
    assert sum(forces) == pytest.approx(13.0994 * 9.81, rel=0.01)
    assert min(forces) > 20.0
    assert data.sensor("trunk_touch").data[0] == 0.0
    # The gains are soft: the weight pushes the trunk down, by some centimetres.
    assert SPEC.base_height - 0.06 < data.qpos[2] < SPEC.base_height


def test_the_torque_channel_is_the_controllers_torque(model, data):
    # kp (target - q) - kd q', by hand: 30 x 0.2 - 0.6 x 2 = 4.8 N m.
    data.ctrl[0] = data.qpos[7] + 0.2
    data.qvel[6] = 2.0
    mujoco.mj_forward(model, data)
    assert data.sensor("torque_FR_hip_joint").data[0] == pytest.approx(4.8, abs=1e-9)
    assert data.sensor("torque_FL_hip_joint").data[0] == pytest.approx(0.0, abs=1e-9)


def test_torque_stops_at_the_motors_limit(model, data):
    data.ctrl[0] += 2.0  # would be 60 N m
    data.ctrl[2] -= 2.0
    mujoco.mj_forward(model, data)
    assert data.sensor("torque_FR_hip_joint").data[0] == 23.7
    assert data.sensor("torque_FR_calf_joint").data[0] == -35.55


def test_joint_friction_is_no_part_of_the_torque_channel(model, data):
    torque = data.sensor("torque_FR_thigh_joint").data[0]
    assert torque == pytest.approx(0.0, abs=1e-9) and model.joint("FR_thigh_joint").frictionloss[0] == 0.2


def test_nothing_of_the_robot_touches_itself(model):
    robot = [index for index in range(model.ngeom) if model.geom(index).name != "floor"]
    assert all(model.geom(index).contype[0] == 0 for index in robot)


def test_a_misspelt_setting_of_the_robot_is_refused():
    with pytest.raises(ValidationError, match="polcy"):
        Go1Settings(polcy="x")
