"""mjlab's cartpole as a small task for the CPU: 50 Hz, few solver steps, and an episode is over when the pole falls."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.reward_manager import RewardTermCfg
from mjlab.managers.termination_manager import TerminationTermCfg
from mjlab.rl import MjlabOnPolicyRunner, RslRlVecEnvWrapper
from mjlab.tasks.cartpole.cartpole_env_cfg import cartpole_balance_env_cfg, cartpole_ppo_runner_cfg

RATE = 50.0  # Hz, of control steps


def fallen(env: ManagerBasedRlEnv) -> torch.Tensor:
    """Where the pole leans by more than 0.3 rad, (W,)."""
    data = env.scene["cartpole"].data
    return data.joint_pos[:, list(env.scene["cartpole"].joint_names).index("hinge_1")].abs() > 0.3


def env(instances: int, seed: int = 0, **terms: RewardTermCfg) -> ManagerBasedRlEnv:
    """The task; terms: further reward terms by name."""
    cfg = cartpole_balance_env_cfg()
    cfg.scene.num_envs, cfg.seed, cfg.episode_length_s = instances, seed, 4.0
    cfg.decimation, cfg.sim.mujoco.timestep = 1, 1.0 / RATE
    cfg.sim.mujoco.iterations = cfg.sim.mujoco.ls_iterations = 3
    cfg.terminations["fallen"] = TerminationTermCfg(func=fallen)
    cfg.rewards |= terms
    return ManagerBasedRlEnv(cfg=cfg, device="cpu")


def runner(task: ManagerBasedRlEnv, algorithm: Any = None, **changes: Any) -> MjlabOnPolicyRunner:
    """mjlab's own runner on the task; algorithm: its settings, None for those of the task; changes: of these."""
    torch.manual_seed(0)
    cfg = cartpole_ppo_runner_cfg()
    cfg.logger, cfg.upload_model, cfg.num_steps_per_env = "tensorboard", False, 24
    if algorithm is not None:
        cfg.algorithm = algorithm
    for name, value in {"entropy_coef": 0.0, **changes}.items():
        setattr(cfg.algorithm, name, value)
    return MjlabOnPolicyRunner(RslRlVecEnvWrapper(task), asdict(cfg), device="cpu")
