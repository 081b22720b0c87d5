"""The report of a run: figures, one page, and the table at the end of `hts run`."""

from __future__ import annotations

from pathlib import Path


def write_report(folder: Path) -> Path:
    """Write `folder`/report.html and `folder`/figures; returns the page's path. Raises RunError."""
    from hts.report.page import write_report as write

    return write(folder)
