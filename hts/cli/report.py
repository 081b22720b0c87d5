"""`hts report`: the page and the figures of a run."""

from __future__ import annotations

import typer

from hts.cli import options


def command(folder: options.RunFolder) -> None:
    """Write report.html and figures/ from what the run folder holds."""
    from hts.cli.run_folder import existing_run

    existing_run(folder)
    from hts.report import write_report

    typer.echo(str(write_report(folder)))
