"""Trials in the training simulation: how they judge, and that the shipped policy walks."""

from __future__ import annotations

import json
import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase

from hts.config import EnvConfig, RandomisationConfig
from hts.contracts import HoldSpeed
from hts.envs.commands import WalksAsTold
from hts.errors import ConfigError
from hts.evaluation.simulation import simulate, test_config
from hts.policies.importing import import_policy
from hts.rl.population import Population, Sizes


class Treadmill(EnvBase):
    """Every world moves at its own constant speed; some fall once, at a given step. r_real is 10 x the speed,
    and the task's own reward 3 x the speed, both per second."""

    def __init__(self, speeds: list[list[float]], falls: dict[tuple[int, int], int] | None = None):
        self.speeds = torch.tensor(speeds)
        super().__init__(batch_size=self.speeds.shape)
        self.dt, self.falls, self.clock = 0.02, falls or {}, 0
        shape = self.batch_size
        self.observation_spec = Composite(
            observation=Unbounded((*shape, 3)),
            channels=Composite(base_velocity=Unbounded((*shape, 3)), shape=shape),
            real_reward=Composite(fast=Unbounded((*shape, 1)), shape=shape),
            shape=shape,
        )
        self.action_spec, self.reward_spec = Unbounded((*shape, 1)), Unbounded((*shape, 1))
        flag = Binary(1, (*shape, 1), dtype=torch.bool)
        self.done_spec = Composite({name: flag.clone() for name in ("done", "terminated", "truncated")}, shape=shape)

    def _set_seed(self, seed):
        pass

    def _write(self, fell, **entries):
        shape = self.batch_size
        velocity = torch.zeros(*shape, 3)
        # The first two seconds are for settling: whatever happens in them is not judged.
        velocity[..., 0] = 99.0 if self.clock <= 100 else self.speeds
        return TensorDict(
            {
                "observation": torch.zeros(*shape, 3),
                "channels": {"base_velocity": velocity},
                "real_reward": {"fast": 10 * velocity[..., :1]},
                "done": fell,
                "terminated": fell.clone(),
                "truncated": torch.zeros_like(fell),
                **entries,
            },
            batch_size=shape,
        )

    def _reset(self, tensordict=None, **kwargs):
        return self._write(torch.zeros(*self.batch_size, 1, dtype=torch.bool))

    def _step(self, tensordict):
        self.clock += 1
        fell = torch.zeros(*self.batch_size, 1, dtype=torch.bool)
        for world, step in self.falls.items():
            fell[world] = self.clock == step
        result = self._write(fell)
        return result.set("reward", 3 * self.dt * result["channels", "base_velocity"][..., :1])


def judge(speeds, falls=None, commanded=(0.5, 1.0), seconds=4.0):
    population = Population(Sizes(3, 3, 1, (4,)), len(speeds))
    return simulate(Treadmill(speeds, falls), population, commanded, seconds, tolerance=0.1)


class Obedient(Treadmill, WalksAsTold):
    """Every world walks 0.9 x its command - 0.02 m/s, and each by as much faster as `speeds` says."""

    def walk_at(self, commands):
        self.commanded = commands

    def _write(self, fell, **entries):
        result = super()._write(fell, **entries)
        result["channels", "base_velocity"][..., 0] = 0.9 * self.commanded - 0.02 + self.speeds
        return result


def held(speeds, falls=None):
    env = Obedient(speeds, falls)
    env.walk_at(torch.zeros(env.batch_size))
    population = Population(Sizes(3, 3, 1, (4,)), len(speeds))
    return simulate(env, population, (0.5, 1.0), 4.0, 0.1, hold=HoldSpeed((0.3, 1.1)))


def test_each_world_is_trimmed_by_its_own_speed():
    row = held([[0.2, 0.0, -0.2, 0.0]])[0][0]  # at one command for both, 0.3 and 0.7 m/s would be no valid second
    assert row.valid == 1.0 and row.mean_speed == pytest.approx(0.5, abs=0.005)
    assert row.commanded == pytest.approx((0.32 + 0.72) / 2 / 0.9, abs=0.01)


def test_in_simulation_too_trimming_forward_ends_at_standing():
    """At command 0 these walk 0.68 m/s, and 0.5 m/s are asked."""
    env = Obedient([[0.7, 0.7]])
    env.walk_at(torch.zeros(env.batch_size))
    row = simulate(env, Population(Sizes(3, 3, 1, (4,)), 1), (0.5,), 4.0, 0.1, hold=HoldSpeed((-1.5, 1.5)))[0][0]
    assert row.commanded == 0.0


def test_a_world_that_stood_up_again_while_trimming_fell():
    assert [trial.falls for trial in held([[0.0, 0.0, 0.0, 0.0]], {(0, 0): 10})[0]] == [1, 0]


def test_held_speed_is_found_for_each_policy_and_speed():
    rows = held([[0.02, 0.02, -0.02, -0.02], [0.1, 0.1, 0.1, 0.1]], {(0, 0): 10})
    # World 0 of the first policy fell while trimming, so that world 2 alone says what was sent: 0.9 u - 0.04 = 0.5.
    assert [trial.commanded for trial in rows[0]] == pytest.approx([0.6, 1.1], abs=0.01)  # 1.133 is out of range
    assert [trial.commanded for trial in rows[1]] == pytest.approx([0.42 / 0.9, 0.92 / 0.9], abs=0.01)
    assert [trial.mean_speed for trial in rows[1]] == pytest.approx([0.5, 1.0], abs=0.005)
    assert rows[0][1].mean_speed == pytest.approx(0.97, abs=0.005)


def test_without_holding_the_asked_speed_is_what_is_sent():
    assert [trial.commanded for trial in judge([[0.5, 1.0]])[0]] == [0.5, 1.0]


def test_an_env_that_takes_no_other_speed_cannot_hold_one():
    population = Population(Sizes(3, 3, 1, (4,)), 1)
    with pytest.raises(ConfigError, match="Treadmill.*simulation_test.hold_speed=false"):
        simulate(Treadmill([[0.5]]), population, (0.5,), 4.0, 0.1, hold=HoldSpeed((0.3, 1.1)))


def test_worlds_are_told_the_speeds_in_turn_and_judged_by_their_own():
    row = judge([[0.5, 1.05, 0.47, 0.8]])[0]
    assert [(trial.speed, trial.worlds) for trial in row] == [(0.5, 2), (1.0, 2)]
    assert row[0].mean_speed == pytest.approx((0.5 + 0.47) / 2)
    assert row[0].valid == 1.0  # both within 10 %
    assert row[1].valid == 0.5  # 1.05 is, 0.8 is not


def test_settling_is_not_judged():
    trial = judge([[0.5, 1.0]])[0][0]  # 99 m/s in the first two seconds
    assert trial.mean_speed == pytest.approx(0.5) and trial.rewards["fast"] == pytest.approx(5.0)


def test_a_world_that_fell_counts_as_a_fall_and_not_in_the_means():
    row = judge([[0.5, 1.0, 5.0, 1.0]], falls={(0, 2): 30})[0]  # a fall while settling counts too
    assert [trial.falls for trial in row] == [1, 0]
    assert row[0].mean_speed == pytest.approx(0.5) and row[0].rewards["fast"] == pytest.approx(5.0)


def test_the_tasks_own_reward_is_per_second_and_the_mean_of_those_that_stood():
    row = judge([[0.5, 1.0, 0.7, 1.0, 5.0, 1.0]], falls={(0, 4): 30})[0]
    assert row[0].task_reward == pytest.approx(3 * (0.5 + 0.7) / 2) and row[1].task_reward == pytest.approx(3.0)


def test_where_all_fell_there_is_no_speed_and_the_worst_reward():
    row = judge([[0.5, 1.0]], falls={(0, 0): 150})[0]
    assert row[0].falls == 1 and math.isnan(row[0].mean_speed) and row[0].rewards["fast"] == -math.inf
    assert math.isnan(row[0].task_reward) and math.isnan(row[0].commanded) and row[0].valid == 1.0


def test_candidates_are_judged_apart():
    first, second = judge([[0.5, 1.0], [0.6, 1.0]])
    assert (first[0].mean_speed, second[0].mean_speed) == (pytest.approx(0.5), pytest.approx(0.6))
    assert (first[0].valid, second[0].valid) == (1.0, 0.0)


def test_a_trial_too_short_to_judge_is_refused():
    with pytest.raises(ConfigError, match=r"2\.5 s has no segment to judge"):
        judge([[0.5, 1.0]], seconds=2.5)


def test_a_trial_keeps_the_training_worlds_but_walks_straight_without_kicks_or_time_outs():
    base = EnvConfig(episode_seconds=3.0, randomisation=RandomisationConfig(pull=0.3))
    config = test_config(base, (0.5, 0.8), 6.0, seed=9)
    assert config.commands.fixed == (0.5, 0.8)
    assert (config.randomisation.push_speed, config.randomisation.pull) == (0.0, (0.0,))
    assert config.episode_seconds > 6.0 and config.seed == 9
    assert config.randomisation.friction == base.randomisation.friction and config.observation_noise == 1.0


# -------------------------------------------------------------------------------------- the shipped policy


@pytest.fixture(scope="module")
def robot():
    pytest.importorskip("hts_go1", reason="the robot of this test is not installed")
    from hts_go1.robot import Go1, Go1Settings

    return Go1(Go1Settings())


def test_the_shipped_policy_walks_at_the_speed_it_is_told(robot):
    shipped = import_policy(robot.pretrained_policy(), robot.spec)
    base = EnvConfig(threads=1, randomisation=RandomisationConfig(models=8))
    env = robot.make_env("mujoco", 1, 8, test_config(base, (0.8,), 6.0, seed=0), channels=("base_velocity",))
    trial = simulate(env, Population.from_candidates(shipped.card.sizes(), [shipped.tensors]), (0.8,), 6.0, 0.1)[0][0]
    env.close()
    assert trial.falls == 0
    assert trial.mean_speed == pytest.approx(0.8, rel=0.1)
    assert trial.valid >= 0.9


def test_the_shipped_policy_says_how_it_was_made(robot):
    path = robot.pretrained_policy()
    made = json.loads(path.with_suffix(".json").read_text())["made"]
    assert made["command"] == "hts pretrain --robot go1" and made["config"]["seed"] == 0
    curve = json.loads((path.parent / "pretraining-curve.json").read_text())
    assert curve[-1]["steps"] == made["steps"] == made["final"]["steps"]
    assert curve[-1]["r_sim"] > curve[0]["r_sim"]
