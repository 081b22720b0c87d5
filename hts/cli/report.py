"""`hts report`: the page and the figures of a run."""

from __future__ import annotations

from pathlib import Path

import typer

from hts.cli import options
from hts.errors import ConfigError, PluginError, RunError


def command(folder: options.RunFolder) -> None:
    """Write report.html and figures/ from what the run folder holds."""
    from hts.places import existing_run

    existing_run(folder)
    from hts.report import write_report
    from hts.report.data import read_run, without_segments

    for line in (without_segments(read_run(folder)), _edited(folder)):
        if line is not None:
            typer.echo(line, err=True)
    typer.echo(str(write_report(folder)))


def _edited(folder: Path) -> str | None:
    """What is to be said where config.yaml says other settings than the run was begun with. Nothing where that cannot
    be told: a page needs neither the plugins of a run nor settings that this version knows."""
    from hts.config_loading import read_config
    from hts.plugins import load
    from hts.run.provenance import TO_REPORT, check_config

    try:
        check_config(folder, read_config(folder / "config.yaml"), load(), TO_REPORT)
    except (ConfigError, PluginError):
        return None
    except RunError as error:
        return f"warning: {error}"
    return None
