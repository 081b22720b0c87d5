"""The page of a small run, as tests read it."""

from __future__ import annotations

import json
import re
from pathlib import Path

from example_run import write_example_run

from hts.report import write_report

SMALL = {"iterations": 1, "bounds": (0.5, float("inf")), "weights": (1.0,), "elites": 2, "block_seconds": 20}


def page(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


def text(folder: Path) -> str:
    """The page without tags and styles, white space as single spaces."""
    body = re.sub(r"<style>.*?</style>", "", page(folder), flags=re.DOTALL)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", body))


def changed(folder: Path, change) -> Path:
    """A small run whose summary was changed, reported."""
    summary = write_example_run(folder, **SMALL)
    change(summary)
    (folder / "summary.json").write_text(json.dumps(summary))
    write_report(folder)
    return folder
