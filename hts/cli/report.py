"""`hts report`: the page and the figures of a run."""

from __future__ import annotations

import typer

from hts.cli import options


def command(folder: options.RunFolder) -> None:
    """Write report.html and figures/ from what the run folder holds."""
    from hts.cli.run_folder import existing_run

    existing_run(folder)
    from hts.report import write_report
    from hts.report.data import read_run, without_segments

    lacking = without_segments(read_run(folder))
    if lacking is not None:
        typer.echo(lacking, err=True)
    typer.echo(str(write_report(folder)))
