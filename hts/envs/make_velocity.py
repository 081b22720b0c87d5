"""Makes the velocity task for a robot: its variants, an engine that simulates them, and the env around it."""

from __future__ import annotations

from collections.abc import Sequence

from hts.channels import SPEED_ERROR
from hts.config import EnvConfig
from hts.contracts import Robot
from hts.envs.velocity import VelocityEnv
from hts.sim.models import variants
from hts.sim.selection import make_engine


def make_velocity_env(
    robot: Robot,
    engine: str,
    num_candidates: int,
    num_envs: int,
    config: EnvConfig,
    channels: Sequence[str] = (),
    seeds: Sequence[int] | None = None,
) -> VelocityEnv:
    """The velocity task for a robot. channels: which of the robot's sim channels to write; seeds: one per candidate."""
    known = robot.channels()
    pool = variants(robot, config.randomisation, config.seed)
    assignment = [world % len(pool) for _ in range(num_candidates) for world in range(num_envs)]
    made = make_engine(
        engine,
        pool,
        assignment,
        robot.spec.substeps,
        threads=config.threads,
        device=config.device,
        contacts_per_world=config.contacts_per_world,
        constraints_per_world=config.constraints_per_world,
    )
    seeds = list(seeds) if seeds is not None else [config.seed + index for index in range(num_candidates)]
    extra = {SPEED_ERROR.name: SPEED_ERROR}
    wanted = {name: extra.get(name) or known[name] for name in (channels or known)}
    return VelocityEnv(made, robot.spec, num_candidates, num_envs, config, wanted, seeds)
