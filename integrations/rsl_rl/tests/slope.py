"""A task whose best policy under the bound is known on paper, as an env of rsl_rl.

States are drawn anew at every step, so an action changes nothing but its own reward r = w(s) · a. With the anchor
N(m(s), σ² I), a shift δ(s) of its mean costs |δ|² / 2σ² nats and pays w·δ; widening σ costs and pays nothing. So

    max E[w·δ]  subject to  E[|δ|²] / 2σ² ≤ c     has     δ(s) = w(s) σ sqrt(2c / E|w|²),  E[w·δ] = σ sqrt(2c E|w|²).
"""

from __future__ import annotations

from typing import Any

import torch
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

SIGMA, INSTANCES, HORIZON = 0.5, 64, 24


def slope(state: torch.Tensor) -> torch.Tensor:
    """w(s) of two actions, for states in [-1, 1]^3."""
    return torch.stack((1.0 + state[..., 0], state[..., 1] - 0.5 * state[..., 2]), -1)


class Slope(VecEnv):
    """r = w(s) · a in states that nobody can influence; one step in ten ends an episode."""

    num_actions, max_episode_length, device, cfg = 2, 1000, "cpu", {}

    def __init__(self, instances: int = INSTANCES, seed: int = 0, level: float = 0.0) -> None:
        self.num_envs, self.level = instances, level
        self.episode_length_buf = torch.zeros(instances, dtype=torch.long)
        self.random = torch.Generator().manual_seed(seed)
        self.state = self.draw(3)

    def draw(self, size: int) -> torch.Tensor:
        return 2.0 * torch.rand(self.num_envs, size, generator=self.random) - 1.0

    def get_observations(self) -> TensorDict:
        return TensorDict({"policy": self.state.clone()}, batch_size=[self.num_envs])

    def step(self, actions):
        reward = self.level + (slope(self.state) * actions).sum(-1)
        self.state = self.draw(3)
        return self.get_observations(), reward, self.draw(1).squeeze(-1) > 0.8, {}


def config(**algorithm: Any) -> dict[str, Any]:
    """Settings of a runner; algorithm: added to or instead of those of PPO here."""
    network = {"class_name": "MLPModel", "hidden_dims": [32], "activation": "elu"}
    gaussian = {"class_name": "GaussianDistribution", "init_std": SIGMA, "std_type": "log"}
    return {
        "num_steps_per_env": HORIZON,
        "save_interval": 1000,
        "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
        "actor": {**network, "distribution_cfg": gaussian},
        "critic": dict(network),
        "algorithm": {
            "class_name": "PPO",
            "num_learning_epochs": 4,
            "num_mini_batches": 4,
            "gamma": 0.9,
            "lam": 0.9,
            "entropy_coef": 0.0,
            "learning_rate": 1e-3,
            "schedule": "fixed",
            "rnd_cfg": None,
            **algorithm,
        },
    }


def anchor_file(folder) -> str:
    """A checkpoint of PPO that has learned nothing yet."""
    torch.manual_seed(0)
    path = str(folder / "model_0.pt")
    OnPolicyRunner(Slope(), config(), device="cpu").save(path)
    return path


def anchored(path: str, bound: float, *, level: float = 0.0, **algorithm: Any) -> OnPolicyRunner:
    """A runner of AnchoredPPO on the task, through rsl_rl's own way of finding the class."""
    torch.manual_seed(1)
    settings = config(class_name="hts_rsl_rl:AnchoredPPO", anchor_checkpoint=path, kl_bound=bound, **algorithm)
    return OnPolicyRunner(Slope(level=level), settings, device="cpu")


@torch.no_grad()
def measured(runner: OnPolicyRunner, bound: float) -> tuple[float, float]:
    """KL / c and return / optimum, over states and not over samples of actions."""
    states = 2.0 * torch.rand(20_000, 3, generator=torch.Generator().manual_seed(9)) - 1.0
    seen, worth = TensorDict({"policy": states}, batch_size=[len(states)]), slope(states)
    kl, _ = runner.alg.kl_to_anchor(seen)
    shift = runner.alg.actor(seen) - runner.alg.anchor(seen)
    optimum = SIGMA * float((2.0 * bound * worth.square().sum(-1).mean()).sqrt())
    return kl / bound, float((worth * shift).sum(-1).mean()) / optimum
