"""Do the engines `mujoco` and `warp` simulate the same robot? State by state, and for a policy that walks.

    python benchmarks/parity.py --device cuda --worlds 64 --seconds 20
    python benchmarks/parity.py --device cpu --worlds 16 --seconds 10      the GPU engine on Warp's CPU device, slow

Prints JSON. `physics`: both engines start from the same states of a walk and get the same actuator inputs for 50
control steps, without a policy to pull them together again; differences of joint angles (rad) and trunk position (m)
over time. Contact turns rounding into another walk in some worlds before others, hence quantiles over worlds. `policy`:
the same policy in both engines, the same models, commands and noise: mean reward, speed and mechanical power, share of
worlds that fell. `passed` compares them with `tolerances`. Status 1 if it did not pass.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import torch
from output import give

from hts.config import EnvConfig
from hts.contracts import Robot
from hts.evaluation.simulation import test_config as calm
from hts.plugins import load
from hts.policies.files import Policy, load_policy
from hts.rl.actor import PopulationActor
from hts.rl.population import Population

SPEEDS = (0.5, 0.8, 1.1)  # m/s
CHANNELS = ("base_velocity", "joint_torque", "joint_velocity")
SETTLE_SECONDS = 2.0
HORIZON = 50  # control steps
WATCHED = (1, 5, 10, 25, 50)
# Of the policy: relative, and percentage points of falls. Of the physics: the median world's error after 50 control
# steps; a hundred times what single precision makes of it where no contact goes another way.
TOLERANCES = {"relative": 0.03, "falls_points": 1.0, "joint_rad": 1e-4, "position_m": 1e-4}


def make_env(robot: Robot, engine: str, device: str, worlds: int, seconds: float, training: bool, seed: int = 7):
    """The velocity task; training: its commands and pushes, otherwise straight walks at SPEEDS."""
    base = EnvConfig(seed=seed, episode_seconds=seconds + 1.0)
    config = base if training else calm(base, SPEEDS, seconds, seed)
    if engine == "warp":
        config = config.model_copy(update={"device": device})
    return robot.make_env(engine, 1, worlds, config, channels=CHANNELS, seeds=[seed])


@torch.no_grad()
def walk(
    robot: Robot,
    policy: Policy,
    engine: str,
    device: str,
    worlds: int,
    seconds: float,
    training: bool = False,
    seed: int = 7,
) -> dict[str, float]:
    """The policy's mean action for so long in each world; means over worlds that did not fall, after the first 2 s.

    reward per second; speed forward, m/s; power: mechanical, sum over joints of max(0, torque x velocity), W.
    """
    env = make_env(robot, engine, device, worlds, seconds, training, seed)
    act = PopulationActor(Population.from_candidates(policy.card.sizes(), [policy.tensors], env.device), None)
    state, steps, counted = env.reset(), round(seconds / env.dt), 0
    fallen = torch.zeros(worlds, dtype=torch.bool, device=env.device)
    sums = torch.zeros(3, worlds, dtype=torch.float64, device=env.device)
    for step in range(steps):
        data, state = env.step_and_maybe_reset(act(state))
        after = data["next"]
        fallen |= after["terminated"].flatten()
        if step * env.dt < SETTLE_SECONDS - 1e-6:
            continue
        counted += 1
        channels = after["channels"]
        power = (channels["joint_torque"] * channels["joint_velocity"]).clamp(min=0.0).sum(-1)
        sums += torch.stack((after["reward"].flatten(), channels["base_velocity"][0, :, 0], power[0]))
    env.engine.check()
    reward, speed, power = (sums[:, ~fallen].mean(1) / counted).tolist()
    env.close()
    return {"reward": reward / env.dt, "speed": speed, "power": power, "falls": float(fallen.double().mean())}


@torch.no_grad()
def same_inputs(
    robot: Robot, policy: Policy, device: str, worlds: int, settle: int = 100, seed: int = 7
) -> dict[str, dict[str, list[float]]]:
    """Errors of `warp` against `mujoco` from the same walking states under the same actuator inputs.

    Median, 0.9 quantile and largest over worlds of the largest joint error (rad) and trunk error (m) after WATCHED
    steps.
    """
    env = make_env(robot, "mujoco", "cpu", worlds, (settle + HORIZON + 1) / robot.spec.control_rate_hz, False, seed)
    act = PopulationActor(Population.from_candidates(policy.card.sizes(), [policy.tensors], env.device), None)
    double, sent = env.engine, []
    step = double.step

    def noted(ctrl: torch.Tensor) -> None:
        sent.append(ctrl.clone())
        step(ctrl)

    double.step = noted
    state = env.reset()
    for _ in range(settle):
        _, state = env.step_and_maybe_reset(act(state))
    start = double.qpos.clone(), double.qvel.clone()
    sent.clear()
    for _ in range(HORIZON):
        _, state = env.step_and_maybe_reset(act(state))
    double.step = step
    other = make_env(robot, "warp", device, worlds, 1.0, False, seed)
    single, everywhere = other.engine, torch.ones(worlds, dtype=torch.bool)
    double.reset(everywhere, *start)
    single.reset(everywhere.to(single.device), *(part.to(single.device) for part in start))
    joints, trunk = [], []
    for number, ctrl in enumerate(sent, 1):
        double.step(ctrl)
        single.step(ctrl.to(single.device))
        if number in WATCHED:
            error = (single.qpos.cpu() - double.qpos).abs()
            joints.append(error[:, 7:].amax(1))
            trunk.append(error[:, :3].amax(1))
    single.check()
    env.close()
    other.close()

    def quantiles(errors: list[torch.Tensor]) -> dict[str, list[float]]:
        found = torch.stack(errors).quantile(torch.tensor([0.5, 0.9, 1.0]), dim=1).tolist()
        return {
            name: [round(one, 8) for one in row] for name, row in zip(("median", "q90", "largest"), found, strict=True)
        }

    return {"joint_rad": quantiles(joints), "position_m": quantiles(trunk)}


def differences(mujoco: dict[str, float], warp: dict[str, float]) -> dict[str, float]:
    """Relative differences of the means, and percentage points of the fall rate."""
    found = {name: warp[name] / mujoco[name] - 1.0 for name in ("reward", "speed", "power")}
    return found | {"falls_points": 100.0 * (warp["falls"] - mujoco["falls"])}


def verdict(policy: dict[str, float], physics: dict[str, dict[str, list[float]]]) -> bool:
    """Whether all differences are within TOLERANCES."""
    return (
        all(abs(policy[name]) <= TOLERANCES["relative"] for name in ("reward", "speed", "power"))
        and abs(policy["falls_points"]) <= TOLERANCES["falls_points"]
        and all(physics[name]["median"][-1] <= TOLERANCES[name] for name in ("joint_rad", "position_m"))
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="go1")
    parser.add_argument("--policy", type=Path, help="default: the robot's shipped one")
    parser.add_argument("--device", default="auto", help="of the warp engine: cuda, cpu or auto")
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--training", action="store_true", help="with the commands and pushes of training")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    robot = load().make_robot(given.robot)
    path = given.policy or robot.pretrained_policy()
    if path is None:
        parser.error(f"robot '{given.robot}' comes without a policy; name one: --policy FILE")
    policy = load_policy(path, robot.spec)
    result: dict[str, Any] = {"benchmark": "parity", "worlds": given.worlds, "seconds": given.seconds}
    result |= {"training": given.training, "device": given.device, "policy_hash": policy.card.policy_hash}
    found = {}
    for engine in ("mujoco", "warp"):
        start = time.perf_counter()
        found[engine] = walk(
            robot, policy, engine, given.device, given.worlds, given.seconds, given.training, given.seed
        )
        print(f"{engine}: {found[engine]} ({time.perf_counter() - start:.0f} s)", file=sys.stderr)
    result["policy"] = found | {"difference": differences(found["mujoco"], found["warp"])}
    physics = same_inputs(robot, policy, given.device, given.worlds, seed=given.seed)
    result["physics"] = {"control_steps": WATCHED, **physics}
    result |= {"tolerances": TOLERANCES, "passed": verdict(result["policy"]["difference"], physics)}
    give(result, given.out)
    sys.exit(0 if result["passed"] else 1)


if __name__ == "__main__":
    main()
