"""mjlab's cartpole as a small task for the CPU: control steps of 50 ms, short episodes, few solver steps."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.managers.reward_manager import RewardTermCfg
from mjlab.rl import MjlabOnPolicyRunner, RslRlVecEnvWrapper
from mjlab.tasks.cartpole.cartpole_env_cfg import cartpole_balance_env_cfg, cartpole_ppo_runner_cfg

RATE = 20.0  # Hz, of control steps


def env(instances: int, seed: int = 0, **terms: RewardTermCfg) -> ManagerBasedRlEnv:
    """The task; terms: further reward terms by name."""
    cfg = cartpole_balance_env_cfg()
    cfg.scene.num_envs, cfg.seed, cfg.episode_length_s = instances, seed, 5.0
    cfg.sim.mujoco.iterations = cfg.sim.mujoco.ls_iterations = 5
    cfg.events["reset_hinge"].params["position_range"] = (-0.6, 0.6)  # so that there is something to learn
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
