"""`hts export`: a policy for the robot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hts.cli import options
from hts.errors import ConfigError, unknown_name

FORMATS = ("onnx", "torchscript")


def command(
    folder: options.RunFolder,
    to: Annotated[Path, typer.Option(help="File to write.")],
    policy: Annotated[str, typer.Option(help="best, pretrained, or a candidate's id.")] = "best",
    format_: Annotated[str, typer.Option("--format", help="onnx or torchscript.")] = "onnx",
) -> None:
    """Write a policy as ONNX or TorchScript, with all that the robot's computer must know about it."""
    from hts.cli.run_folder import existing_run

    if format_ not in FORMATS:
        raise ConfigError("--format: " + unknown_name("format", format_, FORMATS))
    existing_run(folder)
    from hts.policies.export_command import export_policy

    typer.echo(str(export_policy(folder, policy=policy, format=format_, to=to)))
