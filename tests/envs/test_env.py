"""The velocity task as a TorchRL env: specs, frames, episodes, delay, what it refuses."""

from __future__ import annotations

import copy
import math
import subprocess
import sys
from dataclasses import replace

import pytest
import torch
from pydantic import ValidationError
from stepping import CALM, MIXED, put, roll, step, still
from torchrl.envs.utils import check_env_specs

from hts.config import CommandConfig, EnvConfig, RandomisationConfig
from hts.contracts import Robot
from hts.envs.constants import delay_seconds
from hts.envs.observation import NOISE, observation_layout
from hts.envs.rewards import DEFAULT_WEIGHTS
from hts.errors import ConfigError

pytest.importorskip("hts_go1", reason="the robot of these tests is not installed")
from hts_go1.robot import Go1Settings

STRAIGHT = CommandConfig(fixed=(0.5, 0.8))


def test_a_rollout_with_gradients_on_works_and_physics_gives_none(make, robot):
    """As a stock script does it: `env.rollout(n, actor)` with an actor whose parameters are trained."""
    from hts.policies.files import load_policy
    from hts.policies.modules import actor_of

    data = make().rollout(3, actor_of(load_policy(robot.pretrained_policy())))
    assert data.batch_size == (1, 2, 3) and data["loc"].requires_grad
    assert not data["next", "observation"].requires_grad and not data["next", "reward"].requires_grad


# -------------------------------------------------------------------------------------- specs and channels


@pytest.mark.parametrize("randomisation", [CALM, MIXED], ids=["nominal", "randomised"])
def test_the_env_keeps_its_specs(make, randomisation):
    env = make(2, 3, randomisation=randomisation, observation_noise=1.0)
    check_env_specs(env)
    assert env.batch_size == (2, 3)


def test_channels_have_the_shapes_the_robot_promises(make, robot):
    env = make(2, 3)
    written = step(env, env.reset()["observation"].new_zeros(2, 3, 12))["channels"]
    assert set(written.keys()) == set(robot.channels())
    for name, channel in robot.channels().items():
        assert written[name].shape == (2, 3, *channel.shape), name


def test_only_the_channels_asked_for_are_written(make):
    env = make(channels=("joint_torque", "base_velocity"))
    assert set(env.reset()["channels"].keys()) == {"joint_torque", "base_velocity"}


def test_the_observation_is_made_of_what_its_layout_says(make):
    env = make(1, 2, commands=STRAIGHT)
    env.reset()
    action = 0.2 * torch.ones(1, 2, 12)
    after = step(env, action)
    parts = [part["size"] for part in observation_layout(12)]
    rate, gravity, command, offset, speed, last = after["observation"].split(parts, -1)
    channels = after["channels"]
    torch.testing.assert_close(rate, channels["angular_velocity"])
    torch.testing.assert_close(gravity, channels["projected_gravity"])
    torch.testing.assert_close(command, channels["command"])
    torch.testing.assert_close(offset, channels["joint_position"] - env.default_pose)
    torch.testing.assert_close(speed, channels["joint_velocity"])
    assert torch.equal(last, action)
    torch.testing.assert_close(channels["joint_target"], env.default_pose + 0.35 * action)


def test_the_critic_sees_the_observation_without_noise_then_velocity_height_and_contacts(make):
    env = make(1, 4, observation_noise=1.0)
    env.reset()
    after = step(env)
    clean, noisy = after["critic_observation"][..., :45], after["observation"]
    allowed = torch.cat([torch.full((part["size"],), NOISE.get(part["name"], 0.0)) for part in observation_layout(12)])
    difference = (noisy - clean).abs()
    assert (difference <= allowed + 1e-6).all() and (difference.amax((0, 1))[allowed > 0] > 0).all()
    # Rudin et al. 2022: 0.2 rad/s, 0.05, none of the command, 0.01 rad, 1.5 rad/s, none of the last action.
    assert allowed.tolist() == pytest.approx([0.2] * 3 + [0.05] * 3 + [0.0] * 3 + [0.01] * 12 + [1.5] * 12 + [0.0] * 12)
    rest = after["critic_observation"][..., 45:]
    torch.testing.assert_close(rest[..., :3], after["channels", "base_velocity"])
    assert torch.equal(rest[..., 4:], (after["channels", "foot_force"] > 1.0).float())


def test_the_torque_channel_is_the_controllers_at_the_last_physics_step(make):
    env = make(1, 1)
    env.reset()
    put(env, 0)
    action = torch.full((1, 1, 12), 0.5)
    after = step(env, action)
    # The engine keeps the state after each physics step (time, qpos, qvel); sensors belong to the start of the last.
    before_last = env.engine._states[0, -2]
    q, qd = before_last[1 + 7 : 1 + 19], before_last[1 + 19 + 6 :]
    target = env.default_pose.double().numpy() + 0.35 * 0.5
    expected = torch.from_numpy(30.0 * (target - q) - 0.6 * qd)
    limit = torch.tensor([23.7, 23.7, 35.55] * 4, dtype=torch.float64)
    torch.testing.assert_close(
        after["channels", "joint_torque"][0, 0].double(), expected.clamp(-limit, limit), atol=1e-4, rtol=1e-5
    )


# ------------------------------------------------------------------------------------------------- frames


@pytest.mark.parametrize(
    ("quaternion", "gravity"),
    [
        ((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
        ((math.cos(0.15), math.sin(0.15), 0.0, 0.0), (0.0, -math.sin(0.3), -math.cos(0.3))),  # rolled by 0.3 rad
        ((math.cos(0.15), 0.0, math.sin(0.15), 0.0), (math.sin(0.3), 0.0, -math.cos(0.3))),  # nose down by 0.3 rad
        ((math.cos(0.5), 0.0, 0.0, math.sin(0.5)), (0.0, 0.0, -1.0)),  # turned: gravity does not see it
    ],
)
def test_gravity_is_seen_from_the_trunk(make, quaternion, gravity):
    env = make(1, 1)
    env.reset()
    put(env, 0, quaternion)
    env._read_engine()
    torch.testing.assert_close(env._gravity[0, 0], torch.tensor(gravity), atol=1e-6, rtol=0)


def test_velocity_is_seen_from_the_trunk(make):
    env = make(1, 1)
    env.reset()
    put(env, 0, (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)), velocity=(0.0, 1.0, 0.0))  # facing left, moving left
    env._read_engine()
    torch.testing.assert_close(env._velocity[0, 0], torch.tensor([1.0, 0.0, 0.0]), atol=1e-6, rtol=0)
    assert float(env._yaw) == pytest.approx(math.pi / 2)


def test_a_flight_begins_with_the_second_sample_off_the_floor_and_is_told_when_it_ends(make):
    env = make(1, 1)
    env.reset()
    told = []
    for force in (5.0, 0.0, 0.0, 0.0, 5.0, 5.0):  # N, of each foot; steps of 20 ms
        env.engine.sensordata.view(1, 1, -1)[..., env._touch] = force
        seen = env._read(still(env))
        told.append((bool(seen.landed.all()), bool(seen.landed.any()), round(float(seen.air_time[0, 0, 0]), 3)))
    # The first sample without the floor may be a lost one; 20, 40 ms in the air, then it lands after 60.
    assert [one for one in told if one[1]] == [(True, True, 0.06)] and told.index((True, True, 0.06)) == 4
    assert [air for _, _, air in told] == [0.02, 0.02, 0.02, 0.04, 0.06, 0.02]


def test_a_robot_is_stood_up_towards_any_side(make):
    env = make(1, 4)
    env.reset()
    env._draws = torch.full_like(env._draws, 0.5)
    env._draws[..., env._start_draws][..., -1] = torch.tensor([0.25, 0.5, 0.75, 0.875])
    env.start_episodes(torch.ones(1, 4, dtype=torch.bool))
    quarter = math.pi / 2
    assert env._yaw[0].tolist() == pytest.approx([-quarter, 0.0, quarter, 1.5 * quarter], abs=1e-5)


# ----------------------------------------------------------------------------------------------- episodes


def test_joints_near_their_end_stops_are_charged_by_the_robots_own_limits(make, robot):
    weights = {**dict.fromkeys(DEFAULT_WEIGHTS, 0.0), "joint_range": -10.0}
    env = make(reward_weights=weights, channels=("joint_position",))
    folded = env.reset()["observation"].new_zeros(1, 2, 12)
    folded[..., 2::3] = -10.0  # calves, the last joint of each leg
    charged = 0
    for _ in range(10):
        data = step(env, folded)
        low, high = torch.tensor(robot.spec.position_limit).unbind(-1)
        middle, half = (low + high) / 2, 0.9 * (high - low) / 2
        beyond = ((data["channels", "joint_position"] - middle).abs() - half).clamp(min=0).sum(-1)
        torch.testing.assert_close(data["reward"].squeeze(-1), -10.0 * env.dt * beyond, atol=1e-5, rtol=1e-4)
        charged += int((beyond > 0.01).sum())
    assert charged > 0


def test_a_time_out_is_no_fall(make):
    env = make(1, 2, episode_seconds=0.2)
    seen, _ = roll(env, [still(env)] * 12)
    for index, after in enumerate(seen):
        assert not after["terminated"].any()
        assert after["truncated"].all() == (index == 9)  # 0.2 s at 50 Hz
        assert torch.equal(after["done"], after["truncated"])
    assert not env.falls.any()


def test_lying_on_its_back_is_a_fall_and_no_time_out(make):
    env = make(1, 2, episode_seconds=0.02)  # it times out in the same step
    env.reset()
    put(env, 1, (0.0, 1.0, 0.0, 0.0))
    after = step(env)
    assert after["terminated"].flatten().tolist() == [False, True]
    assert after["truncated"].flatten().tolist() == [True, False]
    assert env.falls.flatten().tolist() == [0.0, 1.0]


def test_a_trunk_near_the_floor_has_fallen(make):
    env = make(1, 2)
    env.reset()
    put(env, 0, height=0.15)  # below 0.55 x 0.29 m
    assert step(env)["terminated"].flatten().tolist() == [True, False]


def test_resetting_one_world_leaves_the_others_alone(make):
    env = make(2, 2)
    _, state = roll(env, torch.rand(5, 2, 2, 12) - 0.5)
    before, engine = env.full_state(), env.engine.state_dict()["state"].clone()
    mask = torch.tensor([[False, True], [False, False]])
    reset = env.reset(state.clone().set("_reset", mask.unsqueeze(-1)))
    for name in ("observation", "critic_observation"):
        assert torch.equal(reset[name][~mask], state[name][~mask]), name
        assert not torch.equal(reset[name][mask], state[name][mask]), name
    after = env.full_state()
    for name in ("action", "last_joint_velocity", "target", "air_time", "was_contact", "steps"):
        assert torch.equal(after["buffers", name][~mask], before["buffers", name][~mask]), name
    for name in ("value", "heading", "keeps_heading", "steps_left"):
        assert torch.equal(after["commands", name][~mask], before["commands", name][~mask]), name
    assert torch.equal(env.engine.state_dict()["state"][[0, 2, 3]], engine[[0, 2, 3]])
    assert after["buffers", "steps"][mask] == 0 and not after["buffers", "action"][mask].any()


def test_episodes_begin_near_the_default_pose(make):
    env = make(1, 64)
    env.reset()
    ratio = env.engine.qpos[:, 7:].view(64, 4, 3)[..., 1:] / torch.tensor([0.9, -1.8])
    assert ratio.min() >= 0.9 - 1e-5 and ratio.max() <= 1.1 + 1e-5 and ratio.std() > 0.03
    assert (env.engine.qvel[:, :6].abs() <= 0.5).all() and not env.engine.qvel[:, 6:].any()
    torch.testing.assert_close(env._gravity, torch.tensor([0.0, 0.0, -1.0]).expand(1, 64, 3), atol=1e-6, rtol=0)


# ---------------------------------------------------------------------------------------- delay and offsets


def test_a_delay_of_d_physics_steps_applies_the_old_target_for_d_of_them(make, monkeypatch):
    env = make(1, 4)
    env.reset()
    env.delay = torch.tensor([0, 1, 2, 3]).view(1, 1, 4, 1)
    step(env, torch.full((1, 4, 12), 1.0))
    sent = []
    monkeypatch.setattr(env.engine, "step", lambda ctrl: sent.append(ctrl.clone()))
    step(env, torch.full((1, 4, 12), -1.0))
    old, new = env.default_pose + 0.35, env.default_pose - 0.35
    for world, delay in enumerate((0, 1, 2, 3)):
        for substep in range(4):
            torch.testing.assert_close(sent[0][substep, world], old if substep < delay else new)


def test_a_delay_longer_than_a_control_step_is_refused(make):
    with pytest.raises(ConfigError, match="delay_steps .*: 5 physics steps"):
        make(randomisation=RandomisationConfig(models=1, delay_steps=(0, 5)))


def test_the_default_delay_ends_with_a_control_step_of_fewer_physics_steps(robot):
    quick = copy.copy(robot)
    quick.spec = replace(robot.spec, control_rate_hz=100.0, substeps=2)  # two steps of 5 ms
    env = quick.make_env("mujoco", 1, 64, EnvConfig(threads=1))
    assert sorted(set(env.delay.flatten().tolist())) == [0, 1, 2]
    env.close()
    assert delay_seconds(EnvConfig(), quick.spec) == (0.0, 0.01)
    assert delay_seconds(EnvConfig(), robot.spec) == (0.0, 0.015)
    chosen = EnvConfig(threads=1, randomisation=RandomisationConfig(delay_steps=(1, 3)))
    with pytest.raises(ConfigError, match=r"below finetune.env of a run.*: 3 physics steps .* \(2 of them\)"):
        quick.make_env("mujoco", 1, 4, chosen)


def test_delays_may_be_said_in_shares_of_a_control_step():
    assert RandomisationConfig(delay_share=(0.0, 1.0)).delays(4) == (0, 4)
    assert RandomisationConfig(delay_share=(0.25, 0.5), delay_steps=(0, 9)).delays(10) == (2, 5)
    assert RandomisationConfig(delay_steps=(1, 2)).delays(10) == (1, 2)
    for name, ends in (("delay_share", (0.5, 0.2)), ("delay_steps", (3, 1)), ("delay_share", (0.0, 1.5))):
        with pytest.raises(ValidationError, match=name):
            RandomisationConfig(**{name: ends})


def test_an_encoder_offset_shifts_what_is_read_and_what_is_held(make, monkeypatch):
    env = make(1, 1)
    env.reset()
    env.joint_offset = torch.full((1, 12), 0.01)
    sent = []
    monkeypatch.setattr(env.engine, "step", lambda ctrl: sent.append(ctrl.clone()))
    after = step(env)
    torch.testing.assert_close(after["channels", "joint_position"][0, 0], env.engine.qpos[0, 7:] + 0.01)
    torch.testing.assert_close(sent[0][0, 0], env.default_pose - 0.01)
    torch.testing.assert_close(after["channels", "joint_target"][0, 0], env.default_pose)


# ----------------------------------------------------------------------------------------------- mistakes


def test_an_unknown_engine_is_named_with_the_known_ones(robot):
    with pytest.raises(ConfigError, match="No engine named 'mujuco'. Did you mean 'mujoco'"):
        robot.make_env("mujuco", 1, 1, EnvConfig(randomisation=CALM))


def test_a_robot_without_a_model_cannot_be_simulated(robot):
    class LogOnly(type(robot)):
        def mjcf(self):
            return None

    with pytest.raises(ConfigError, match="log-only"):
        LogOnly(Go1Settings()).make_env("mujoco", 1, 1, EnvConfig(randomisation=CALM))


def test_a_robot_that_says_nothing_of_its_env_is_told_what_to_derive_from(robot):
    class Plain(Robot):
        spec = robot.spec
        mjcf, channels, pretrained_policy = robot.mjcf, robot.channels, robot.pretrained_policy

    with pytest.raises(ConfigError, match=r"'go1' has no env to train in.*hts\.envs\.velocity_robot\.VelocityRobot"):
        Plain().make_env("mujoco", 1, 1, EnvConfig())


def test_a_velocity_robot_is_imported_without_torch_and_mujoco():
    code = "import sys, hts.envs.velocity_robot; sys.exit(bool({'torch', 'mujoco'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
