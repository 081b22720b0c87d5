"""What differs between the env instances of the velocity task and stays as it is: delays, zeros of the encoders."""

from __future__ import annotations

import numpy as np

from hts.config import EnvConfig
from hts.contracts import RobotSpec
from hts.errors import ConfigError


def delays_and_offsets(config: EnvConfig, spec: RobotSpec, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Action delay in physics steps, int (count,), and zero error of each encoder, rad (count, J).

    Zeros without randomisation. The same numbers for the same `config.seed`. Raises ConfigError for a delay
    longer than a control step.
    """
    r = config.randomisation
    least, most = r.delays(spec.substeps)
    if r.enabled and most > spec.substeps:
        raise ConfigError(
            f"randomisation.delay_steps (below finetune.env of a run, env of a pretraining): {most} physics steps are "
            f"longer than a control step ({spec.substeps} of them), the longest delay the env simulates. Lower the "
            "upper end."
        )
    rng = np.random.default_rng([config.seed, 5417])
    delay = rng.integers(least, most, size=count, endpoint=True)
    offset = rng.uniform(*r.joint_offset, size=(count, spec.num_joints))
    if not r.enabled:
        delay, offset = np.zeros_like(delay), np.zeros_like(offset)
    return delay, offset


def delay_seconds(config: EnvConfig, spec: RobotSpec) -> tuple[float, float]:
    """The least and the longest action delay of the env instances, s."""
    least, most = config.randomisation.delays(spec.substeps) if config.randomisation.enabled else (0, 0)
    return least * spec.physics_dt, most * spec.physics_dt
