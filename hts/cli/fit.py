"""`hts fit`: one measurement model from a recording store."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hts.cli import options


def command(
    objective: Annotated[str, typer.Option(help="Whose measurement model. `hts plugins` lists them.")],
    data: Annotated[Path, typer.Option(help="Recording store.")],
    out: Annotated[Path, typer.Option(help="Folder for the model and fit.json.")],
    set_: options.Overrides = None,
) -> None:
    """Fit one measurement model, with its checks: OUT/fit.json says how well it predicts.

    No robot is named: joints, channels, units and rate are those of the recordings in the store.
    """
    import json

    from hts.measurement.fit_command import doubts, fit_store, summary_line

    written = fit_store(objective, data, out, overrides=set_ or ())
    report = json.loads(written.read_text(encoding="utf-8"))
    for line in (summary_line(report), *doubts(report)):
        typer.echo(line)
    typer.echo(str(written))
