"""`hts baseline`: the run without measurements."""

from __future__ import annotations

from hts.cli import options


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
) -> None:
    """The same as `hts run`, with the objective's analytic proxy as reward and a sweep and budget of its own."""
    from hts.cli.run import start

    registry, resolved = options.configured(
        objective, robot, preset, world, config, set_, engine=engine, executor=executor, seed=seed, baseline=True
    )
    start(resolved, registry, out, dry_run)
