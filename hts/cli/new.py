"""`hts new`: a package to start from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND", help="objective, measurement-model, robot, world, instrument, selector or reader."
        ),
    ],
    name: Annotated[str, typer.Argument(metavar="NAME", help="What it is called on the command line.")],
    log_only: Annotated[
        bool, typer.Option("--log-only", help="A robot known by its logs: for import and fit, without a simulation.")
    ] = False,
    to: Annotated[Path, typer.Option(metavar="DIR", help="Where the package's folder goes.")] = Path("."),
) -> None:
    """Write a package that installs, passes `hts check`, runs as it is, and says what to change."""
    from hts.testing.starters import first_run, write_starter

    folder = write_starter(kind, name, to, log_only)
    typer.echo(f"{folder}")
    typer.echo(f"next: pip install -e {folder} && hts check {folder.name} && python -m pytest {folder}")
    typer.echo(f"then: {first_run(kind, name, folder, log_only)}")
