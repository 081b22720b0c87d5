"""`hts play`: see a policy walk."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hts.cli import options


def command(
    folder: options.RunFolderOrNone = None,
    policy: Annotated[
        str | None, typer.Option(help=f"Of a run {options.POLICIES}; or a file, .onnx or .safetensors.")
    ] = None,
    robot: Annotated[
        str | None, typer.Option(metavar="NAME", help="Without a run: the machine; default: that of the policy file.")
    ] = None,
    speed: Annotated[float, typer.Option(help="Commanded forward speed, m/s.")] = 0.8,
    video: Annotated[Path | None, typer.Option(help="Write a video file instead of opening a window.")] = None,
) -> None:
    """See a policy walk, in a window or as a video.

    Of a run: hts play DIR. Of a file: hts play --policy mine.safetensors.
    """
    from hts.cli.run_folder import run_or_policy_file

    chosen = run_or_policy_file(folder, policy)
    from hts.play import play

    play(folder, policy=chosen, speed=speed, video=video, robot=robot)
