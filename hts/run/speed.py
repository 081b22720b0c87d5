"""How fast this machine trains: a few batches of the run's own fine-tuning, for the estimate of a dry run."""

from __future__ import annotations

import time
from itertools import islice

from hts.config import RunConfig
from hts.guarded import guarded
from hts.parts import objectives_of, robot_of
from hts.plugins import Registry
from hts.policy_ids import PRETRAINED
from hts.run.ready import pretrained_policy, unfitted_rewards
from hts.training.sweep import Candidate, weights_of

BATCHES = 4  # the first one is not timed: it takes memory and fills caches
SAMPLES = 9_000  # of a batch at most, control steps: a second on two cores


def control_steps_per_second(config: RunConfig, registry: Registry) -> float | None:
    """Control steps per second from collection to update, measured on as much of the run as fits into seconds.

    None on a GPU: kernels would be compiled for minutes first. Raises whatever the run's fine-tuning would raise.
    """
    if config.engine != "mujoco":
        return None
    from hts.measurement.transform import channels_read
    from hts.training.finetune import finetune

    robot = robot_of(config, registry)
    policy = pretrained_policy(robot)
    tune, horizon = config.finetune, config.finetune.ppo.horizon
    envs = max(1, min(tune.num_envs, SAMPLES // horizon))
    weights = weights_of(objectives_of(config, registry), config)
    most = max(1, min(tune.max_candidates, SAMPLES // (horizon * envs)))
    pairs = islice(((one, bound) for one in weights for bound in config.sweep.kl_bounds), most)
    group = [Candidate(f"dry-{i}", PRETRAINED, one, bound) for i, (one, bound) in enumerate(pairs)]
    short = tune.model_copy(update={"num_envs": envs, "steps": BATCHES * horizon * envs})
    ends: list[float] = []
    guarded(
        "Fine-tuning",
        lambda: finetune(
            robot,
            config.engine,
            short,
            group,
            {PRETRAINED: policy},
            lambda: unfitted_rewards(config, registry),
            channels_read(unfitted_rewards(config, registry)),
            seed=config.seed,
            progress=lambda share: ends.append(time.perf_counter()),
        ),
    )
    return len(group) * envs * horizon * (len(ends) - 1) / (ends[-1] - ends[0]) if len(ends) > 1 else None
