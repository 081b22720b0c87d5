"""A short rsl_rl training of a made-up task, in an environment that has rsl_rl: `python made_by_rsl_rl.py FOLDER`.

Writes model_N.pt as rsl_rl saves it, and pairs.npz: observations, and what rsl_rl's own policy does with them. Two
normalised entries hardly vary, as a command does that is always the same.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

WORLDS, OBSERVATIONS, ACTIONS = 16, 21, 4
MODEL = {"class_name": "MLPModel", "hidden_dims": [16, 8], "activation": "elu", "obs_normalization": True}
SIGMA = {"class_name": "GaussianDistribution", "init_std": 0.7, "std_type": "scalar"}
PPO = {
    "class_name": "PPO", "num_learning_epochs": 1, "num_mini_batches": 1, "clip_param": 0.2, "gamma": 0.99, "lam": 0.95,
    "value_loss_coef": 1.0, "entropy_coef": 0.0, "learning_rate": 1e-2, "max_grad_norm": 1.0, "schedule": "fixed",
    "use_clipped_value_loss": True, "desired_kl": 0.01, "rnd_cfg": None, "symmetry_cfg": None,
}  # fmt: skip


class Task(VecEnv):
    """Follow the first entries."""

    num_envs, num_actions, max_episode_length, device = WORLDS, ACTIONS, 100, "cpu"

    def __init__(self):
        self.cfg, self.episode_length_buf = {}, torch.zeros(WORLDS, dtype=torch.long)
        self.seen = self._next()

    def _next(self):
        seen = 2 * torch.randn(WORLDS, OBSERVATIONS) + torch.arange(OBSERVATIONS) / 5
        seen[:, 3:5] = 0.5 + 1e-3 * torch.randn(WORLDS, 2)
        return seen

    def get_observations(self):
        return TensorDict({"policy": self.seen}, [WORLDS])

    def step(self, actions):
        reward = -(actions - self.seen[:, :ACTIONS]).square().sum(-1)
        self.seen = self._next()
        return self.get_observations(), reward, torch.rand(WORLDS) < 0.02, {}


def main(folder: Path) -> None:
    torch.manual_seed(0)
    config = {
        "num_steps_per_env": 8, "save_interval": 100, "logger": "tensorboard", "algorithm": PPO, "critic": {**MODEL},
        "actor": {**MODEL, "distribution_cfg": SIGMA}, "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
    }  # fmt: skip
    runner = OnPolicyRunner(Task(), config, None, "cpu")
    runner.learn(2)
    folder.mkdir(parents=True, exist_ok=True)
    runner.save(str(folder / "model_2.pt"))
    policy = runner.get_inference_policy("cpu")
    seen = 3 * torch.randn(300, OBSERVATIONS)
    seen[:, 3:6] = seen[:, 3:6].clamp(-1.0, 1.0)  # a direction, in the layout of the test
    with torch.no_grad():
        actions = policy(TensorDict({"policy": seen}, [300]))
    np.savez(folder / "pairs.npz", observation=seen.numpy(), action=actions.numpy())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
