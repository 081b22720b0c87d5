"""`hts play`: see a policy walk."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hts.cli import options


def command(
    folder: options.RunFolder,
    policy: Annotated[str, typer.Option(help="best, pretrained, a candidate's id, or a policy file.")] = "best",
    speed: Annotated[float, typer.Option(help="Commanded forward speed, m/s.")] = 0.8,
    video: Annotated[Path | None, typer.Option(help="Write a video file instead of opening a window.")] = None,
) -> None:
    """See a policy walk, in a window or as a video."""
    from hts.cli.run_folder import existing_run

    existing_run(folder)
    from hts.play import play

    play(folder, policy=policy, speed=speed, video=video)
