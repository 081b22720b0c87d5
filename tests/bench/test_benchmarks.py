"""The benchmarks compare like with like: the rivals' world is the same task, step by step."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

pytest.importorskip("hts_go1", reason="the robot of this test is not installed")

from hts.config import EnvConfig, RandomisationConfig
from hts.plugins import load

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def script(name: str):
    """A file of benchmarks/ as a module; its neighbours can be imported as when it is run."""
    spec = importlib.util.spec_from_file_location(name, BENCHMARKS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(BENCHMARKS))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(BENCHMARKS))
    return module


@pytest.fixture(scope="module")
def robot():
    return load().make_robot("go1")


@pytest.mark.parametrize("vx", [0.8, 0.0], ids=["walking", "standing"])
def test_the_rivals_world_gives_the_observation_reward_and_fall_of_the_env(robot, vx):
    """Same state, command and actions: every step's observation and reward are equal until the fall ends both."""
    plain = EnvConfig(observation_noise=0.0, randomisation=RandomisationConfig(enabled=False))
    env = robot.make_env("mujoco", 1, 1, plain, channels=("joint_torque",), seeds=[3])
    world = script("one_world").OneWorld(robot, plain)
    data = env.reset()
    world.reset(seed=3)
    world.data.qpos[:] = env.engine.qpos[0].double().numpy()
    world.data.qvel[:] = env.engine.qvel[0].double().numpy()
    world.begin()
    for owner in (env.commands, world):  # walk straight on
        owner.heading = torch.zeros(1, 1) + 0.3 if owner is env.commands else 0.3
        owner.keeps_heading = torch.ones(1, 1, dtype=torch.bool) if owner is env.commands else True
    env.commands.value[:] = torch.tensor([vx, 0.0, 0.0])
    world.command = np.array([vx, 0.0, 0.0])
    env.commands.steps_left[:], world.steps_left = 1e6, 1e6
    generator = torch.Generator().manual_seed(0)
    for step in range(120):
        # Calm at first, so that it stands and steps; wild later, so that it falls.
        action = (0.3 if step < 60 else 6.0) * torch.randn(1, 1, 12, generator=generator)
        after = env.step(data.set("action", action))["next"]
        observation, reward, fell, late, _ = world.step(action[0, 0].numpy())
        # The CPU engine starts the solver cold, the world warm: they agree to the solver's tolerance.
        np.testing.assert_allclose(observation, after["observation"][0, 0].numpy(), atol=5e-3, err_msg=str(step))
        assert reward == pytest.approx(float(after["reward"]), abs=2e-3), step
        assert fell == bool(after["terminated"]) and not late
        if fell:
            break
        data = after
    assert fell and step > 60  # both parts were seen
    env.close()


def test_the_rivals_walk_too(robot):
    """The shipped policy, its normaliser folded into the first layer, walks in the rivals' world as in the env."""
    layers, _ = script("cpu_rivals").folded_actor(robot)
    world = script("one_world").OneWorld(robot, EnvConfig(randomisation=RandomisationConfig(push_speed=0.0)))
    observation, _ = world.reset(seed=1)
    speeds = []
    for _ in range(150):
        world.command[:2], world.keeps_heading, world.steps_left = (0.8, 0.0), True, 1e6
        observation[6:9] = world.command
        x = torch.from_numpy(observation)
        for weight, bias in layers[:-1]:
            x = torch.nn.functional.elu(torch.nn.functional.linear(x, weight, bias))
        observation, _, fell, _, _ = world.step(torch.nn.functional.linear(x, *layers[-1]).numpy())
        assert not fell
        speeds.append(world.velocity[0])
    assert 0.7 < np.mean(speeds[50:]) < 0.9


def test_worlds_differ_in_their_models(robot):
    one_world = script("one_world")
    first, second = (one_world.OneWorld(robot, index=index).model for index in (0, 1))
    assert isinstance(first, mujoco.MjModel) and first.body_mass.sum() != second.body_mass.sum()


def test_a_loaded_machine_is_seen():
    import threading

    busy_cores = script("compare_cpu").busy_cores
    stop = threading.Event()

    def spin() -> None:
        while not stop.is_set():
            pass

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        assert busy_cores(0.5) > 0.4
    finally:
        stop.set()
        thread.join()


def test_new_over_old_is_a_geometric_mean_with_an_interval():
    mean, low, high = script("compare_trees").new_over_old([(100.0, 110.0), (50.0, 60.5), (10.0, 11.0), (20.0, 24.2)])
    # Ratios 1.1, 1.21, 1.1, 1.21: in logarithms ln 1.1 times 1.5 +- t(3) ln 1.1 sqrt(1/3) / 2, with t(3) = 3.1824.
    step = np.log(1.1)
    reach = 3.1824 * step * np.sqrt(1 / 3) / 2
    assert mean == pytest.approx(1.1**1.5)
    assert (low, high) == pytest.approx((np.exp(1.5 * step - reach), np.exp(1.5 * step + reach)), rel=1e-4)


def test_a_tree_that_is_no_checkout_is_refused(tmp_path):
    with pytest.raises(SystemExit, match="Expected a checkout of the project"):
        script("compare_trees").check(tmp_path)
