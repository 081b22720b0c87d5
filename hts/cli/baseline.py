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
    from hts.config_loading import load_config
    from hts.plugins import load

    registry = load()
    resolved = load_config(
        preset=preset,
        file=config,
        objectives=objective or (),
        robot=robot,
        world=world,
        engine=engine,
        executor=executor,
        seed=seed,
        baseline=True,
        overrides=set_ or (),
        registry=registry,
        option_names=options.NAMES,
    )
    start(resolved, registry, out, dry_run)
