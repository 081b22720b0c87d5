"""`hts check PACKAGE`: the conformance kit."""

from __future__ import annotations

from typing import Annotated

import typer


def command(
    package: Annotated[
        str, typer.Argument(metavar="PACKAGE", help="An installed distribution. `hts plugins` lists them.")
    ],
) -> None:
    """Test everything that a plugin package offers against the contracts. Exit status 1 if something is not kept."""
    from hts.plugins import load
    from hts.testing.conformance import check_package

    findings = check_package(load(), package)
    for finding in findings:
        typer.echo(f"{'ok  ' if finding.fault is None else 'FAIL'}  {finding.subject}: {finding.demand}")
        if finding.fault is not None:
            typer.echo(f"      {finding.fault}")
    failed = sum(finding.fault is not None for finding in findings)
    typer.echo(f"{package}: {len(findings)} checks, {failed} failed")
    if failed:
        raise typer.Exit(1)
