"""How well a policy walks, in training simulation and on the twin: the robot's shipped one, or one of your own.

    python benchmarks/check_policy.py --robot go1 --worlds 64 --seconds 20
    python benchmarks/check_policy.py --robot go1 --policy DIR/pretrained.safetensors

Prints JSON: for each place and speed falls, mean speed (m/s) and the share of 1 s segments within 10 % of the command
after the first 2 s. Training simulation: its randomised models and sensor noise, mean action, no pushes.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
import torch

from hts.config import Command, EnvConfig, ScheduleConfig
from hts.contracts import WorldContext
from hts.evaluation.segments import cut
from hts.evaluation.simulation import simulate, test_config
from hts.plugins import load
from hts.policies.export import to_onnx
from hts.policies.files import load_policy
from hts.rl.population import Population

SPEEDS = (0.5, 0.8, 1.1)


def in_simulation(robot, policy, worlds: int, seconds: float) -> dict:
    """Each speed in `worlds` worlds of the training simulation."""
    config = test_config(EnvConfig(), SPEEDS, seconds, seed=123)
    env = robot.make_env("mujoco", 1, worlds * len(SPEEDS), config, channels=("base_velocity",), seeds=[5])
    population = Population.from_candidates(policy.card.sizes(), [policy.tensors])
    (trials,) = simulate(env, population, SPEEDS, seconds, 0.1)
    env.close()
    return {
        t.speed: {"falls": t.falls, "mean_speed": round(t.mean_speed, 4), "valid": round(t.valid, 4)} for t in trials
    }


def on_twin(registry, robot, policy, worlds: int, seconds: float) -> dict:
    """Each speed on `worlds` twins."""
    result = {}
    with tempfile.TemporaryDirectory() as folder:
        path = to_onnx(policy, Path(folder) / "policy.onnx")
        world = registry.make_world("twin", {}, WorldContext(robot.spec.name, {}, {"power": {}}, 0, Path(folder)))
        for speed in SPEEDS:
            schedule = ScheduleConfig(commands=(Command(seconds=seconds, vx=speed),))
            recordings = world.collect([path] * worlds, schedule)
            segments = cut(recordings)
            result[speed] = {
                "falls": sum(recording.fell for recording in recordings),
                "mean_speed": round(float(np.mean(segments.speed)), 4),
                "valid": round(segments.valid, 4),
            }
        world.close()
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="go1")
    parser.add_argument("--policy", type=Path, help="a policy file; default: the one that the robot's package ships")
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--seconds", type=float, default=20.0)
    given = parser.parse_args()
    torch.set_num_threads(1)
    registry = load()
    robot = registry.make_robot(given.robot, {})
    path = given.policy or robot.pretrained_policy()
    if path is None:
        parser.error(f"robot '{given.robot}' comes without a policy; name one: --policy FILE")
    policy = load_policy(path, robot.spec)
    result = {
        "policy": policy.card.policy_hash,
        "training simulation": in_simulation(robot, policy, given.worlds, given.seconds),
        "twin": on_twin(registry, robot, policy, given.worlds, given.seconds),
    }
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
