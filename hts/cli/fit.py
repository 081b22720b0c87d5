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
    """Fit one measurement model, with its checks: OUT/fit.json says how well it predicts."""
    import json

    from hts.measurement.fit_command import fit_store, summary_line

    report = fit_store(objective, data, out, overrides=set_ or ())
    typer.echo(summary_line(json.loads(report.read_text(encoding="utf-8"))))
    typer.echo(str(report))
