"""Algorithm 1's sweep, tests and final with a reality as training env and the truth as reward.

It is a run like any other but for three things: candidates are trained and judged on the reality itself, which may be
looked into; nothing is measured before, so nothing is fitted; and what it finds is a lower estimate of what is possible
there, and no method. The tests of the elites and the final are those of `hts run`, in the world `twin`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hts.config import RunConfig
from hts.errors import PolicyError
from hts.measurement.transform import Measured
from hts.parts import objectives_of, robot_of
from hts.plugins import Registry
from hts.policy_ids import PRETRAINED
from hts.run.job import Job
from hts.run.ready import check_world, pretrained_policy
from hts.training.sweep import own_weights
from hts.worlds.oracle import NOTE
from hts.worlds.oracle.reward import Level, TrueReward
from hts.worlds.oracle.robot import OracleRobot, levels

if TYPE_CHECKING:
    from hts.policies.files import Policy

START = "00-start"
"""Id of the policy that candidates start from, which is a candidate too: the oracle is never worse than it."""
FACTORS = (0.1, 0.3, 1.0)
"""λ where none is given: these shares of the objective's own largest. The truth is a sharper signal than a gauge's."""
MOST_ENVS = 32  # that say what the truth is like


def prepared(config: RunConfig, registry: Registry) -> RunConfig:
    """The configuration as it is written: with the λ that it will take, the start's whole path and the real engine."""
    objectives = objectives_of(config, registry)
    own = own_weights(objectives, config)
    weights = {name: tuple(round(share * max(own[name]), 6) for share in FACTORS) for name in objectives if own[name]}
    sweep = config.sweep.model_copy(update={"weights": {**weights, **config.sweep.weights}})
    start = str(Path(config.start).resolve()) if config.start else None
    return config.model_copy(update={"sweep": sweep, "start": start, "engine": "mujoco"})


def check(config: RunConfig, registry: Registry) -> None:
    """What can be checked before anything is spent, beside names: each mistake is one line."""
    oracle = _oracle(config, registry)
    pretrained_policy(oracle)
    start_policy(config, oracle)
    check_world(config, registry)


def _oracle(config: RunConfig, registry: Registry) -> OracleRobot:
    return OracleRobot(robot_of(config, registry), config.world.settings, config.objectives, registry)


def start_policy(config: RunConfig, robot: OracleRobot) -> Policy | None:
    """What candidates start from, where it is not the pretrained policy. Raises PolicyError for another robot's."""
    from hts.policies.files import load_policy

    if config.start is None:
        return None
    path = Path(config.start)
    if path.suffix != ".safetensors" or not path.is_file():
        raise PolicyError(
            f"{path}: expected a policy file that exists, ending in .safetensors, such as "
            "runs/MINE/policies/best.safetensors."
        )
    policy, pretrained = load_policy(path, robot.spec), pretrained_policy(robot)
    if policy.card.sizes() != pretrained.card.sizes():
        raise PolicyError(
            f"{path}: has networks of {policy.card.sizes()}, the pretrained policy of {pretrained.card.sizes()}; both "
            "are judged side by side and must be alike. Start from a policy that was fine-tuned from it."
        )
    return policy


def control_steps_per_second(config: RunConfig, registry: Registry) -> float:
    """Of walking on the reality, measured here; learning takes little beside it."""
    oracle, objectives = _oracle(config, registry), objectives_of(config, registry)
    begun = time.perf_counter()
    _, steps = levels(
        oracle,
        pretrained_policy(oracle),
        objectives,
        config.finetune.env,
        num_envs=config.finetune.num_envs,
        seconds=2.5,
        seed=config.seed,
    )
    return steps / (time.perf_counter() - begun)


class OracleJob(Job):
    """A job whose robot trains on the reality, paid by the truth."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.note = NOTE
        self.stages.progress.total += 1  # `truth`
        config = self.config
        self.oracle = OracleRobot(self.robot, config.world.settings, config.objectives, self.registry)
        self.robot = self.oracle
        self.first = START if config.start else PRETRAINED

    def prepare(self) -> None:
        """Besides: the policy to start from, and what the truth is like around it."""
        super().prepare()
        start = start_policy(self.config, self.oracle)
        if start is not None and not self.policy_path(START).exists():
            self.save(START, start)
        _ = self.levels  # a stage, if it is not done yet

    @cached_property
    def levels(self) -> dict[str, Level]:
        """Mean and spread of the true quantities while the policy to start from walks and explores."""

        def walk(report: Callable[[float], None]) -> dict[str, Any]:
            found, steps = levels(
                self.oracle,
                self.policy(self.first),
                self.objectives,
                self.config.finetune.env,
                num_envs=min(self.config.finetune.num_envs, MOST_ENVS),
                seconds=self.config.simulation_test.seconds,
                seed=self.seed("levels"),
            )
            return {"levels": {name: asdict(level) for name, level in found.items()}, "steps": steps, "note": NOTE}

        result = self.do("truth", "walk on the reality, looking inside", walk)
        return {name: Level(**level) for name, level in result["levels"].items()}

    def rewards(self, iteration: int) -> list[Measured]:
        """The truth of each objective."""
        return [TrueReward(objective, self.levels[name]) for name, objective in self.objectives.items()]

    def untrained(self, iteration: int) -> list[dict[str, Any]]:
        """The policy that candidates start from, in the first iteration, as a candidate that changed nothing."""
        if iteration > 0 or self.first != START:
            return []
        policy = self.policy(START)
        std = float(policy.tensors["log_std"].exp().mean())
        return [
            {
                "id": START,
                "anchor": "best",
                "weights": dict.fromkeys(self.objectives, 0.0),
                "kl_bound": 0.0,
                "kl": 0.0,
                "std": std,
                "anchor_std": std,
                "stopped": None,
                "policy_hash": policy.card.policy_hash,
                "curve": [],
            }
        ]
