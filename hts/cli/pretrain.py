"""`hts pretrain`: the policy to start from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from hts.cli import options


def command(
    robot: Annotated[str, typer.Option(metavar="NAME", help="The machine. `hts plugins` lists them.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the policy, its card and its learning curve.")],
    config: options.ConfigFile = None,
    set_: options.Overrides = None,
    engine: options.Engine = None,
    seed: options.Seed = None,
) -> None:
    """Train the policy to start from on the task's own reward: minutes on a GPU, hours without. Stopped, it goes on
    with `hts resume`."""
    from hts.cli.one_line import resumable
    from hts.config import PretrainConfig
    from hts.config_loading import load_section
    from hts.engines import check_engine
    from hts.places import PRETRAINING, check_new_folder, check_place
    from hts.plugins import load

    given = {key: value for key, value in (("engine", engine), ("seed", seed)) if value is not None}
    settings = load_section(PretrainConfig, config, given, set_ or (), options.NAMES)
    check_engine(settings.engine)
    machine = load().make_robot(robot)
    check_new_folder(out)
    check_place(out, "--out DIR")  # before the hours that its policy takes
    from hts.sim.selection import select_engine
    from hts.training.pretrain import pretrain_policy

    engine = select_engine(settings.engine, settings.env.device, tell=lambda line: typer.echo(line, err=True))
    settings = settings.model_copy(update={"engine": engine})

    with resumable(out, PRETRAINING):
        typer.echo(str(pretrain_policy(machine, settings, out, progress=tell)))


def tell(row: dict[str, Any]) -> None:
    """One row of the learning curve, on one line."""
    typer.echo("  ".join(f"{name} {value:,.4g}" for name, value in row.items()))
