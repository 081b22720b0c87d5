"""What a log tells of the time between its samples, against a walk whose physics steps are known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from hts import plugins
from hts.channels import SUBSTEP_TORQUE, SUBSTEP_VELOCITY, Channel
from hts.config import EnvConfig, RandomisationConfig, ScheduleConfig
from hts.measurement.physics_steps import between_samples, torque_scale
from hts.policies.files import load_policy
from hts.recordings.recording import Recording, Series

pytest.importorskip("hts_go1", reason="a robot with legs")
STEPS = 150


@pytest.fixture(scope="module")
def walk():
    """A Go1 of one's own simulation, walking: its log, and torque and speed in each physics step (T, K, J)."""
    robot = plugins.load().make_robot("go1")
    names = (SUBSTEP_TORQUE, SUBSTEP_VELOCITY, "joint_torque", "joint_velocity", "joint_position")
    config = EnvConfig(randomisation=RandomisationConfig(enabled=False), threads=1)
    env = robot.make_env("mujoco", 1, 1, config, channels=names, seeds=[3])
    policy = load_policy(robot.pretrained_policy(), robot.spec)
    from hts.rl.population import Population

    population = Population.from_candidates(policy.card.sizes(), [policy.tensors], env.device)
    population.refresh()
    state, seen, targets = env.reset(), {name: [] for name in names}, []
    with torch.no_grad():
        for _ in range(STEPS):
            state["action"] = population.mean(state["observation"])
            state = env.step(state)["next"]
            for name in names:
                seen[name].append(state["channels", name][0, 0].numpy().copy())
            targets.append(env.target[0, 0].numpy().copy())
    env.close()
    found = {name: np.stack(rows) for name, rows in seen.items()}
    # A log has with each sample the target that is sent then, so the one that the next step was taken with.
    sent = np.stack(targets)[1:]
    channels = {
        name: Series(Channel(name, unit, (12,)), values[:-1])
        for name, unit, values in (
            ("joint_torque", "N*m", found["joint_torque"]),
            ("joint_velocity", "rad/s", found["joint_velocity"]),
            ("joint_position", "rad", found["joint_position"]),
        )
    }
    channels["joint_target"] = Series(Channel("joint_target", "rad", (12,)), sent)
    log = Recording(
        robot="go1",
        world="made up",
        policy_hash="",
        iteration=0,
        joint_names=robot.spec.joint_names,
        kp=robot.spec.kp,
        kd=robot.spec.kd,
        rate_hz=robot.spec.control_rate_hz,
        schedule=ScheduleConfig(commands=[{"seconds": 3.0, "vx": 0.8}]),
        idle={},
        clock="simulated",
        time=np.arange(STEPS - 1) / robot.spec.control_rate_hz,
        channels=channels,
    )
    return log, found[SUBSTEP_TORQUE][:-1], found[SUBSTEP_VELOCITY][:-1]


def squares(torque: np.ndarray) -> np.ndarray:
    """Mean over a second of the squared torque of all joints, from (T, K, J)."""
    each = np.square(torque).sum(2).mean(1)[: STEPS - 50]
    return each.reshape(-1, 50).mean(1)


def test_torque_between_samples_is_that_of_the_physics_steps(walk):
    log, torque, speed = walk
    found = between_samples(log, torque.shape[1], late=0)
    assert found is not None and torque_scale(log) == pytest.approx(1.0, abs=0.05)
    made, fast = found
    assert made.shape == torque.shape and fast.shape == speed.shape
    standing = 25  # control steps until it walks
    agreement = np.corrcoef(made[standing:].ravel(), torque[standing:].ravel())[0, 1]
    assert agreement > 0.95
    assert np.corrcoef(fast[standing:].ravel(), speed[standing:].ravel())[0, 1] > 0.95
    at_ends = np.repeat(log.values("joint_torque")[:, None], torque.shape[1], 1)
    assert agreement > np.corrcoef(at_ends[standing:].ravel(), torque[standing:].ravel())[0, 1] + 0.02
    error, before = (np.abs(squares(one) / squares(torque) - 1)[1:].max() for one in (made, at_ends))
    assert error < 0.5 * before


def test_a_target_that_comes_late_leaves_the_one_before_in_force(walk):
    log, torque, _ = walk
    parts = torque.shape[1]
    on_time, late = (between_samples(log, parts, late)[0] for late in (0, 2))
    np.testing.assert_array_equal(on_time[1:, 2:], late[1:, 2:])
    assert np.abs(on_time[1:, :2] - late[1:, :2]).max() > 0.5


@pytest.mark.parametrize("missing", ["joint_target", "joint_position"])
def test_a_log_without_what_it_takes_tells_nothing(walk, missing):
    log, _, _ = walk
    without = log.replace(channels={name: one for name, one in log.channels.items() if name != missing})
    assert torque_scale(without) is None and between_samples(without, 4, 0) is None


def test_gains_that_do_not_explain_the_torque_tell_nothing(walk):
    log, _, _ = walk
    assert between_samples(dataclasses.replace(log, kp=tuple(4 * kp for kp in log.kp)), 4, 0) is None
    assert between_samples(dataclasses.replace(log, kp=log.kp[:3], kd=log.kd[:3]), 4, 0) is None


def cubed() -> Recording:
    """A joint at t^3 rad, sampled twice a second, whose torque reads 0.8 of 2 (q* - q) - 0.1 q'."""
    channels = {
        "joint_position": ("rad", [0.0, 0.125, 1.0, 3.375]),
        "joint_velocity": ("rad/s", [0.0, 0.75, 3.0, 6.75]),
        "joint_target": ("rad", [4.0, 4.0, 6.0, 6.0]),
        # q* before: 4, 4, 4, 6. 8, 7.75 - 0.075, 6 - 0.3, 5.25 - 0.675; 0.8 of each.
        "joint_torque": ("N*m", [6.4, 6.14, 4.56, 3.66]),
    }
    return Recording(
        robot="one",
        world="made up",
        policy_hash="",
        iteration=0,
        joint_names=("a",),
        kp=(2.0,),
        kd=(0.1,),
        rate_hz=2.0,
        schedule=ScheduleConfig(commands=[{"seconds": 2.0, "vx": 0.0}]),
        idle={},
        clock="simulated",
        time=np.arange(4) / 2,
        channels={
            name: Series(Channel(name, unit, (1,)), np.array(values)[:, None])
            for name, (unit, values) in channels.items()
        },
    )


def test_a_joint_that_moves_as_a_cubic_is_where_the_cubic_is_between_samples():
    assert torque_scale(cubed()) == pytest.approx(0.8)
    torque, speed = (found[..., 0] for found in between_samples(cubed(), 2, late=0))
    # From 0.5 to 1 s: at 0.125 rad with 0.75 rad/s, and at 0.75^3 = 0.421875 rad with the line's 1.875 rad/s.
    assert torque[2] == pytest.approx([0.8 * (2 * 3.875 - 0.075), 0.8 * (2 * 3.578125 - 0.1875)])
    assert speed[2] == pytest.approx([1.3125, 2.4375])  # a quarter and three quarters of the way from 0.75 to 3
    # From 1 to 1.5 s the target is 6 from the beginning on; half a step late the one before, 4, holds first.
    assert torque[3] == pytest.approx([0.8 * (2 * 5 - 0.3), 0.8 * (2 * (6 - 1.25**3) - 0.4875)])
    late = between_samples(cubed(), 2, late=1)[0][..., 0]
    assert late[3] == pytest.approx([0.8 * (2 * 3 - 0.3), torque[3, 1]])
    np.testing.assert_array_equal(torque[0], torque[1])
