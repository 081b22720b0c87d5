"""How policies/pretrained.* was made: `python make_policy.py OUT`, with the run's own PPO.

The suite steps one env at a time, some hundred control steps a second through all wrappers; this takes the same model
and the same arithmetic to the engine that hts steps many worlds with. `tests/envs/test_foreign_env.py` compares the
two. Fine-tuning, simulation tests and everything else in `hts run` use the suite's own task.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from math import pi
from pathlib import Path

import mujoco
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Composite, Unbounded

from hts.config import PPOConfig, PretrainConfig
from hts.rl.random import PopulationRandom
from hts.rl.task_env import TaskEnv
from hts.sim.selection import make_engine
from hts.training.pretrain import pretrain_policy
from hts_walker.robot import OBSERVATION, SPEC, Settings, Walker

STAND_HEIGHT, WALK_SPEED = 1.2, 1.0  # m, m/s: dm_control/suite/walker.py


def suite_model() -> mujoco.MjModel:
    """The suite's model, as it is."""
    from dm_control.suite import walker

    xml, assets = walker.get_model_and_assets()
    return mujoco.MjModel.from_xml_string(xml.decode() if isinstance(xml, bytes) else xml, dict(assets))


def observation(qpos: torch.Tensor, qvel: torch.Tensor) -> torch.Tensor:
    """(..., 9) and (..., 9) -> (..., 24): a planar chain, so orientations are sums of joint angles."""
    torso = qpos[..., 2]
    angles = [torso]
    for first in (3, 6):  # joints turn about -y, the torso about y
        angle = torso
        for joint in range(first, first + 3):
            angle = angle - qpos[..., joint]
            angles.append(angle)
    turned = torch.stack([part for angle in angles for part in (angle.cos(), angle.sin())], -1)
    return torch.cat((turned, 1.3 + qpos[..., :1], qvel), -1)


def task_reward(qpos: torch.Tensor, speed: torch.Tensor) -> torch.Tensor:
    """Reward of `walker-walk`, 0 to 1. speed: of the centre of mass, m/s."""
    height = 1.3 + qpos[..., 0]
    short = (STAND_HEIGHT - height).clamp(min=0.0) / (STAND_HEIGHT / 2)
    # dm_control's tolerance: 1 inside the bounds, 0.1 at the margin on a Gaussian, 0.5 there on the linear one.
    standing = torch.exp(-0.5 * (short * 2.145966026289347).square())
    stand = (3 * standing + (1 + qpos[..., 2].cos()) / 2) / 4
    missing = (WALK_SPEED - speed).clamp(min=0.0) / (WALK_SPEED / 2)
    move = (1 - 0.5 * missing).clamp(min=0.0)
    return stand * (5 * move + 1) / 6


class FastWalkerEnv(TaskEnv):
    """The task on the batched engine, [P, N] env instances."""

    batch_locked = True

    def __init__(
        self, model: mujoco.MjModel, shape: tuple[int, int], seconds: float, seeds: Sequence[int], threads: int
    ):
        super().__init__(device="cpu", batch_size=torch.Size(shape))
        self.dt = SPEC.physics_dt * SPEC.substeps
        self.max_steps = round(seconds / self.dt)
        self.engine = make_engine("mujoco", [model], [0] * self.batch_size.numel(), SPEC.substeps, threads=threads)
        self.random = PopulationRandom(seeds, self.device)
        self.limits = torch.tensor(SPEC.position_limit)
        self.speed = self.engine.sensor("torso_subtreelinvel").start
        self.steps = torch.zeros(shape)
        size = sum(size for _, size in OBSERVATION)
        self.observation_spec = Composite(
            observation=Unbounded((*shape, size)),
            critic_observation=Unbounded((*shape, size)),
            channels=Composite({"joint_torque": Unbounded((*shape, 6))}, shape=shape),
            shape=shape,
        )
        self.action_spec = Unbounded((*shape, 6))
        self.reward_spec = Unbounded((*shape, 1))
        flag = Binary(1, (*shape, 1), dtype=torch.bool)
        self.done_spec = Composite({name: flag.clone() for name in ("done", "terminated", "truncated")}, shape=shape)
        self.observation_layout = [{"name": name, "size": size} for name, size in OBSERVATION]

    def _set_seed(self, seed: int | None) -> None:
        pass

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs) -> TensorDictBase:
        mask = torch.ones(self.batch_size, dtype=torch.bool)
        first = tensordict is None or "_reset" not in tensordict.keys()  # noqa: SIM118
        if not first:
            mask = tensordict["_reset"].view(self.batch_size)
        if bool(mask.any()):
            draws = self.random.uniform(self.batch_size[1], 8)
            low, high = self.limits.unbind(-1)
            joints = low + (high - low) * draws[..., :6]
            pitch = pi * (2 * draws[..., 6:7] - 1)
            qpos = torch.cat((torch.zeros(*self.batch_size, 2), pitch, joints), -1).flatten(0, 1)
            self.engine.reset(mask.flatten(), qpos, torch.zeros_like(qpos))
            # Time-outs at different moments, or every instance would begin again in the same batch.
            begun = (draws[..., 7] * self.max_steps).floor() if first else torch.zeros(self.batch_size)
            self.steps = torch.where(mask, begun, self.steps)
        done = torch.zeros(*self.batch_size, 1, dtype=torch.bool)
        return self._result({"done": done, "terminated": done.clone(), "truncated": done.clone()}, None)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict["action"].clamp(-1.0, 1.0)
        self.engine.step(action.flatten(0, 1).expand(SPEC.substeps, -1, -1))
        self.steps = self.steps + 1
        speed = self.engine.sensordata[:, self.speed].view(self.batch_size)
        reward = task_reward(self.engine.qpos.view(*self.batch_size, -1), speed) * self.dt
        late = (self.steps >= self.max_steps).unsqueeze(-1) | self.engine.diverged.view(*self.batch_size, 1)
        entries = {"reward": reward.unsqueeze(-1), "done": late, "truncated": late.clone()}
        return self._result(entries | {"terminated": torch.zeros_like(late)}, action)

    def _result(self, entries: dict, action: torch.Tensor | None) -> TensorDict:
        shape = self.batch_size
        seen = observation(self.engine.qpos.view(*shape, -1), self.engine.qvel.view(*shape, -1))
        torque = torch.zeros(*shape, 6) if action is None else action * torch.tensor(SPEC.torque_limit)
        channels = TensorDict({"joint_torque": torque}, shape)
        return TensorDict(
            {**entries, "observation": seen, "critic_observation": seen.clone(), "channels": channels}, shape
        )


class FastWalker(Walker):
    """The robot with the fast env, for pretraining alone."""

    model: mujoco.MjModel

    def make_env(self, engine, num_candidates, num_envs, config, channels=(), seeds=None):
        shape = (num_candidates, num_envs)
        return FastWalkerEnv(self.model, shape, config.episode_seconds, seeds or [0] * num_candidates, config.threads)


def settings(steps: int, num_envs: int) -> PretrainConfig:
    """Rate 1e-3, adapted to the KL between batches; 64-64 networks, so that the file stays small."""
    ppo = PPOConfig(learning_rate=1e-3, adaptive_rate=True, entropy_coef=0.002, horizon=32, epochs=5, minibatches=4)
    return PretrainConfig(
        engine="mujoco",
        num_envs=num_envs,
        steps=steps,
        hidden=(64, 64),
        init_std=0.6,
        ppo=ppo,
        env={"episode_seconds": 25.0},
    )


def main(out: Path, steps: int = 7_000_000, num_envs: int = 256) -> None:
    robot = FastWalker(Settings())
    robot.model = suite_model()

    def tell(row: dict) -> None:
        # Reward per second of 1.0 is a perfect episode: 1000 of the suite's 1000 points.
        print({name: row[name] for name in ("steps", "seconds", "r_sim", "std") if name in row}, flush=True)

    path = pretrain_policy(robot, settings(steps, num_envs), out, tell)
    card = json.loads(path.with_suffix(".json").read_text())
    card["made"]["command"] = "python make_policy.py OUT"  # not `hts pretrain`, which would take the robot's own env
    path.with_suffix(".json").write_text(json.dumps(card, indent=1) + "\n")
    print(path)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *(int(value) for value in sys.argv[2:]))
