"""The oracle: an env that is the reality, paid by what its instruments hide, and that learning cannot reach."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import torch

from hts.config import CommandConfig, EnvConfig
from hts.contracts import Objective
from hts.errors import ConfigError, UnfitWorldError
from hts.policies.files import load_policy
from hts.worlds.oracle import sessions
from hts.worlds.oracle.env import TRUE
from hts.worlds.oracle.reward import Level, TrueReward
from hts.worlds.oracle.robot import OracleRobot, levels
from hts.worlds.twin.instruments import maker
from hts.worlds.twin.parameters import TwinSettings, resolved_settings
from hts.worlds.twin.session import Batch

pytest.importorskip("hts_power", reason="its gauge knows the truth")
POWER = TRUE + "battery_current"
CONFIG = EnvConfig(commands=CommandConfig(vx=(0.6, 0.8), straight=1.0), threads=1)


def oracle(registry, **world) -> OracleRobot:
    return OracleRobot(registry.make_robot("go1"), world, {"power": {}}, registry)


def batch_of(registry, count, key, **world) -> Batch:
    """The twin itself, as its own process makes it."""
    robot = registry.make_robot("go1")
    settings = resolved_settings(TwinSettings.model_validate(world), robot.spec.name)
    made = maker(registry, robot, {"power": {}}, settings)()
    return Batch(robot, settings, made, count, np.random.SeedSequence(key))


def walked(env, steps, seed=0):
    """Steps with made-up actions; yields what each returned."""
    random = torch.Generator().manual_seed(seed)
    state = env.reset()
    action = 0.3 * torch.randn(env.batch_size[1], env.action_spec.shape[-1], generator=random)
    for _ in range(steps):
        state["action"] = action.expand(*env.batch_size, -1)
        data, state = env.step_and_maybe_reset(state)
        yield data["next"]
        action = 0.9 * action + 0.1 * torch.randn(action.shape, generator=random)


@pytest.mark.parametrize("world", [{}, {"reality": "dev-03"}], ids=["default twin", "dev-03"])
def test_the_truth_is_the_realitys_own_power_without_noise_at_the_same_state(registry, world):
    env, twin = (
        oracle(registry, **world).make_env("", 1, 2, CONFIG, seeds=[7]),
        batch_of(registry, 2, [7, 0, 0], **world),
    )
    gauge = twin.instruments["battery_gauge"]
    before = np.zeros(2)
    for _, after in zip(range(12), walked(env, 12), strict=True):
        targets = env.target[0].double().numpy()
        twin.supply()
        twin.body.advance(targets, twin.steps, tuple(twin.instruments.values()))
        gauge.read()
        spent = gauge.energy["bus"] - gauge.energy["idle"]
        np.testing.assert_allclose(after["channels", POWER][0], (spent - before) / twin.period, rtol=1e-5)
        np.testing.assert_allclose(after["channels", "joint_position"][0], twin.body.qpos[:, 7:], atol=1e-6)
        before = spent
    assert env.reward_spec.shape == (1, 2, 1) and np.ptp(spent) > 0  # two robots, two walks
    env.close()
    twin.close()


def test_the_reward_is_the_objectives_own_of_the_truth_in_standard_deviations(registry):
    objective = registry.make_objective("power")
    made = TrueReward(objective, Level(100.0, 50.0))
    recorded = made.record({POWER: torch.tensor([[100.0, 150.0, 50.0]])})
    entries = made.evaluate(recorded)
    assert entries["real_reward", "power"].flatten().tolist() == [0.0, -1.0, 1.0]
    assert entries["measured", "battery_current"].flatten().tolist() == [0.0, 1.0, -1.0]


def test_two_gauges_that_read_otherwise_tell_one_truth(registry):
    robot = registry.make_robot("go1")
    shown, told = [], []
    for seed, offset in ((0, 0.0), (1, 0.02)):
        twin = batch_of(registry, 1, [3], instruments={"battery_gauge": {"offset": offset, "noise": 0.05}})
        gauge = twin.instruments["battery_gauge"]
        gauge.reset(1, np.random.default_rng(seed))
        for _ in range(20):
            twin.body.advance(np.array([robot.spec.default_pose]), twin.steps, (gauge,))
        shown.append(gauge.read()["battery_current"])
        told.append(gauge.truth()["battery_current"])
        assert gauge.truth()["battery_current"] == told[-1]  # no step passed
        twin.close()
    assert shown[0] != shown[1] and told[0] == told[1] > 0


def test_the_microphone_tells_the_level_without_its_own_error(registry):
    pytest.importorskip("hts_noise")
    loud = registry.make_instrument("microphone", {"calibration_error": 1.0}, registry.make_robot("go1"))
    assert loud.truth()["sound_level"] == pytest.approx(loud.p.room_level)
    assert loud.idle()["sound_level"] == pytest.approx(loud.p.room_level + 1.0)


def test_a_candidate_does_not_depend_on_who_trains_beside_it(registry):
    robot, rows = oracle(registry, reality="dev-03"), []
    for seeds in ([7], [7, 8]):
        env = robot.make_env("", len(seeds), 3, CONFIG, seeds=seeds)
        rows.append(
            torch.stack([torch.cat((after["observation"][0], after["reward"][0]), -1) for after in walked(env, 6)])
        )
        env.close()
    assert torch.equal(*rows)


def test_the_policy_sees_what_sensors_show_and_the_critic_the_state(registry):
    noisy = {"velocity_noise": 0.5, "velocity_word": 0.0, "position_noise": 0.0, "gyro_noise": 0.0}
    env = oracle(registry, sensors=noisy).make_env("", 1, 8, CONFIG, seeds=[1])
    after = list(walked(env, 4))[-1]
    seen, true = after["observation"], after["critic_observation"][..., : after["observation"].shape[-1]]
    joints = slice(9 + 12, 9 + 24)
    apart = (seen - true)[..., joints].std()
    assert 0.4 < apart < 0.6  # the sensor's sigma
    assert torch.equal(true[..., joints], after["channels", "joint_velocity"])
    env.close()


def test_a_floor_slopes_for_the_critic_too_another_way_in_each_session(registry):
    env = oracle(registry, dynamics={"structure": {"floor_slope": 2.0}}).make_env("", 1, 3, CONFIG, seeds=[1])
    down = env.reset()["critic_observation"][0, :, 3:6]
    assert down[:, :2].norm(dim=-1).tolist() == pytest.approx([np.sin(np.radians(2.0))] * 3, rel=1e-4)
    assert len({round(one, 4) for one in down[:, 0].tolist()}) == 3
    env.close()


def test_sessions_end_together_and_other_ones_begin(registry, monkeypatch):
    monkeypatch.setattr(sessions, "SESSION_SECONDS", 0.07)
    env = oracle(registry, reality="dev-03").make_env("", 1, 3, CONFIG, seeds=[7])
    (first,) = env.engine._sessions
    before = first.batch.instruments["battery_gauge"].conditions()
    flags = [(after["truncated"].all().item(), after["done"].any().item()) for after in walked(env, 5)]
    assert flags == [(False, False)] * 3 + [(True, True), (False, False)]
    now = first.batch.instruments["battery_gauge"].conditions()
    assert before and any((before[name] != now[name]).any() for name in before)
    env.close()


def test_levels_are_those_of_a_walk(registry):
    robot = oracle(registry)
    policy = load_policy(robot.pretrained_policy(), robot.spec)
    objectives: dict[str, Objective] = {"power": registry.make_objective("power")}
    found, steps = levels(robot, policy, objectives, CONFIG, num_envs=4, seconds=3.0, seed=0)
    assert steps == 4 * 150
    assert 50 < found["power"].mean < 200 and 10 < found["power"].std < 150  # W, at about 0.7 m/s
    with pytest.raises(ConfigError, match="says nothing of the truth"):
        levels(robot, policy, objectives, CONFIG, num_envs=1, seconds=1.0, seed=0)


def test_an_instrument_that_tells_no_truth_is_refused(registry, monkeypatch):
    from hts_power.gauge import BatteryGauge

    monkeypatch.setattr(BatteryGauge, "truth", lambda self: {})
    with pytest.raises(UnfitWorldError, match="tells the truth about 'battery_current' .it tells of nothing"):
        oracle(registry)


def test_a_robot_with_an_env_of_its_own_is_refused(registry):
    from hts.testing.examples.robot.robot import Tiny

    with pytest.raises(UnfitWorldError, match="brings an env or a task of its own"):
        OracleRobot(Tiny.__new__(Tiny), {}, {}, registry)


def test_learning_code_brings_in_neither_the_oracle_nor_any_world():
    learning = "hts.run.algorithm, hts.run.ready, hts.run.cost, hts.training.finetune, hts.measurement.fit_command"
    seen = "[name for name in sys.modules if name.startswith(('hts.worlds', 'hts.oracle'))]"
    code = f"import sys, {learning}; print({seen})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
