"""Makes the velocity task for a robot: its variants, an engine that simulates them, and the env around it."""

from __future__ import annotations

from collections.abc import Sequence

from hts.channels import HELD_CHANNELS, substep_channels
from hts.config import EnvConfig
from hts.contracts import Robot
from hts.cores import available
from hts.envs.physics_steps import SUBSTEPS
from hts.envs.velocity import VelocityEnv
from hts.rl.grouped_env import GroupedEnv
from hts.rl.task_env import SplitStepEnv
from hts.sim.models import variants
from hts.sim.selection import make_engine, select_engine

GROUPS = 2  # one in its physics, the other deciding: more would do more operations and be no more often in physics


def make_velocity_env(
    robot: Robot,
    engine: str,
    num_candidates: int,
    num_envs: int,
    config: EnvConfig,
    channels: Sequence[str] = (),
    seeds: Sequence[int] | None = None,
) -> SplitStepEnv:
    """The velocity task for a robot. channels: which of the robot's sim channels to write; seeds: one per candidate.

    On a CPU in two groups of candidates where there are two of both: one decides while the other is in its physics.
    """
    spec = robot.spec
    made_here = {**HELD_CHANNELS, **substep_channels(spec.substeps, spec.num_joints, len(spec.foot_sites))}
    known = robot.channels()
    pool = variants(robot, config.randomisation, config.seed)
    seeds = list(seeds) if seeds is not None else [config.seed + index for index in range(num_candidates)]
    wanted = {name: made_here.get(name) or known[name] for name in (channels or known)}
    if engine == "auto":
        engine = select_engine(engine, config.device)

    def make(own: Sequence[int]) -> VelocityEnv:
        assignment = [world % len(pool) for _ in own for world in range(num_envs)]
        made = make_engine(
            engine,
            pool,
            assignment,
            robot.spec.substeps,
            threads=config.threads,
            device=config.device,
            contacts_per_world=config.contacts_per_world,
            constraints_per_world=config.constraints_per_world,
            keep_physics_steps=any(name in SUBSTEPS for name in wanted),
        )
        return VelocityEnv(made, robot.spec, len(own), num_envs, config, wanted, own)

    threads = config.threads or available()
    if engine == "warp" or min(num_candidates, threads) < GROUPS:
        return make(seeds)
    half = (num_candidates + 1) // 2
    return GroupedEnv([make(seeds[:half]), make(seeds[half:])])
