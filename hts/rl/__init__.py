"""Reinforcement learning for populations of policies under a KL bound, in TorchRL's own terms. It knows no task.

    collector = PopulationCollector(env, PopulationActor(population, noise), frames_per_batch=P * N * T)
    advantage = GAE(gamma=0.99, lmbda=0.95, value_network=critic, vectorized=False)   # TorchRL's own
    loss = KLConstrainedPPOLoss(actor, critic, kl_bound=0.5)                          # a LossModule; c of each, or [P]
    for data in collector:                                                            # [P, N, T]
        advantage(data)
        for batch in minibatches(data): ...                                           # [P, ...]: losses [P], .sum()
        loss.update_multiplier(loss.kl_to_reference(data))                            # once a batch

Every piece works alone, with TorchRL's other pieces and with plain `ProbabilisticActor`s; `examples/torchrl_ppo.py` is
a stock TorchRL script with three of them swapped in. Names are imported when they are first asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hts.rl.actor import PopulationActor, PopulationCritic
    from hts.rl.actor_bound import project_actor_to_kl_bound
    from hts.rl.advantage import advantages
    from hts.rl.backend import Backend, backend_for
    from hts.rl.captured_collector import CapturedCollector
    from hts.rl.centring import RewardCentring
    from hts.rl.deferred import DeferrableTransform
    from hts.rl.grouped_env import GroupedEnv
    from hts.rl.kl import distribution_kl, gaussian_kl
    from hts.rl.kl_bound import project_to_kl_bound
    from hts.rl.loss import KLConstrainedPPOLoss
    from hts.rl.measured_reward import MeasuredReward
    from hts.rl.multiplier import EqualityMultiplier, LagrangeMultiplier, UpperMultiplier
    from hts.rl.population import Population, Sizes
    from hts.rl.population_collector import PopulationCollector
    from hts.rl.random import PopulationRandom
    from hts.rl.task_env import LaunchedSimulator, ReplacedState, SplitStepEnv, TaskEnv

_HOMES = {
    "Backend": "backend",
    "CapturedCollector": "captured_collector",
    "DeferrableTransform": "deferred",
    "EqualityMultiplier": "multiplier",
    "GroupedEnv": "grouped_env",
    "KLConstrainedPPOLoss": "loss",
    "LagrangeMultiplier": "multiplier",
    "LaunchedSimulator": "task_env",
    "MeasuredReward": "measured_reward",
    "Population": "population",
    "PopulationActor": "actor",
    "PopulationCollector": "population_collector",
    "PopulationCritic": "actor",
    "PopulationRandom": "random",
    "ReplacedState": "task_env",
    "RewardCentring": "centring",
    "Sizes": "population",
    "SplitStepEnv": "task_env",
    "TaskEnv": "task_env",
    "UpperMultiplier": "multiplier",
    "advantages": "advantage",
    "backend_for": "backend",
    "distribution_kl": "kl",
    "gaussian_kl": "kl",
    "project_actor_to_kl_bound": "actor_bound",
    "project_to_kl_bound": "kl_bound",
}
"""Public name -> the module it lives in. Torch and TorchRL take seconds to import, and not everybody needs all of
this."""

__all__ = [
    "Backend",
    "CapturedCollector",
    "DeferrableTransform",
    "EqualityMultiplier",
    "GroupedEnv",
    "KLConstrainedPPOLoss",
    "LagrangeMultiplier",
    "LaunchedSimulator",
    "MeasuredReward",
    "Population",
    "PopulationActor",
    "PopulationCollector",
    "PopulationCritic",
    "PopulationRandom",
    "ReplacedState",
    "RewardCentring",
    "Sizes",
    "SplitStepEnv",
    "TaskEnv",
    "UpperMultiplier",
    "advantages",
    "backend_for",
    "distribution_kl",
    "gaussian_kl",
    "project_actor_to_kl_bound",
    "project_to_kl_bound",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'hts.rl' has no attribute '{name}'; it has {', '.join(__all__)}")
    return getattr(importlib.import_module(f"hts.rl.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
