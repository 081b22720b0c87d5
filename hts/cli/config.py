"""`hts config show|schema`: the resolved configuration, or its JSON schema for editors."""

from __future__ import annotations

import json

import typer

from hts.cli import options

app = options.group("The resolved configuration, or its JSON schema.")


@app.command()
def show(
    objective: options.Objectives = None,
    robot: options.RobotName = None,
    preset: options.Preset = None,
    world: options.WorldName = None,
    config: options.ConfigFile = None,
    set_: options.Overrides = None,
    engine: options.Engine = None,
    executor: options.Executor = None,
    seed: options.Seed = None,
) -> None:
    """Print the configuration that `hts run` with the same options would use, as YAML, settings of plugins included."""
    from hts.config_loading import check_names, dump_config, with_plugin_defaults

    registry, resolved = options.configured(
        objective, robot, preset, world, config, set_, engine=engine, executor=executor, seed=seed
    )
    check_names(resolved, registry)
    typer.echo(dump_config(with_plugin_defaults(resolved, registry)), nl=False)


@app.command()
def schema() -> None:
    """Print the JSON schema of a config file, with the settings of all plugins that are installed."""
    from hts.config_schema import config_schema
    from hts.plugins import load

    typer.echo(json.dumps(config_schema(load()), indent=2, default=str))
