"""`hts check PACKAGE`: the conformance kit."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from hts.cli import options

FAILED = 1


def command(
    package: Annotated[
        str,
        typer.Argument(metavar="PACKAGE", help="An installed distribution (`hts plugins` lists them), or its folder."),
    ],
    json_: options.AsJson = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Only what is not kept, and the count.")] = False,
) -> None:
    """Test everything that a plugin package offers against the contracts. Exit status 1 if something is not kept.

    HTS_DEBUG=1 shows the traceback of each fault."""
    from hts.cli.commands import COMMANDS
    from hts.plugins import load
    from hts.testing.conformance import check_package, package_of

    name = package_of(package)
    folder = package if Path(package).is_dir() else None
    findings = check_package(load(), name, reserved=COMMANDS, folder=folder)
    failed = sum(finding.fault is not None for finding in findings)
    untried = sum(not finding.tried for finding in findings)
    if json_:
        typer.echo(
            json.dumps({"package": name, "failed": failed, "findings": [asdict(one) for one in findings]}, indent=2)
        )
    else:
        for finding in findings:
            if finding.fault is not None or not quiet:
                word = "FAIL" if finding.fault is not None else "ok  " if finding.tried else "wait"
                typer.echo(f"{word}  {finding.line()}")
        waiting = f", {untried} wait until these are kept" if untried else ""
        typer.echo(f"{name}: {len(findings)} checks, {failed} failed{waiting}")
    if failed:
        raise typer.Exit(FAILED)
