"""`hts run`: Algorithm 1."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hts.cli import options

if TYPE_CHECKING:
    from hts.config import RunConfig
    from hts.plugins import Registry


def command(
    objective: options.Objectives = None,
    robot: options.RobotName = None,
    preset: options.Preset = None,
    world: options.WorldName = None,
    config: options.ConfigFile = None,
    set_: options.Overrides = None,
    engine: options.Engine = None,
    executor: options.Executor = None,
    seed: options.Seed = None,
    out: options.Out = None,
    dry_run: options.DryRun = False,
    reward: options.Reward = None,
) -> None:
    """Improve a robot's policy on an objective: measure, model, fine-tune, test, repeat."""
    given = {"engine": engine, "executor": executor, "seed": seed, "reward_source": reward}
    registry, resolved = options.configured(objective, robot, preset, world, config, set_, **given)
    start(resolved, registry, out, dry_run)


def start(config: RunConfig, registry: Registry, out: Path | None, dry_run: bool) -> None:
    """Run into a folder of its own."""
    from hts.cli.one_line import resumable
    from hts.run import start_run

    folder = out or default_folder(config)
    with resumable(None if dry_run else folder):
        start_run(config, folder, dry_run=dry_run, registry=registry)


def default_folder(config: RunConfig) -> Path:
    """runs/OBJECTIVE-ROBOT-PRESET-SEED, with `proxy` for a baseline, `proxy-reward` for the method without a model,
    `oracle` and `oracle-reward` for the two oracles: one folder for one command line."""
    parts = ["+".join(config.objectives), config.robot.name, config.preset, str(config.seed)]
    if config.reward_source != "model":
        parts.insert(2, f"{config.reward_source}-reward" if config.records_first else config.reward_source)
    return Path("runs") / "-".join(parts)
