"""`hts pretrain`: the policy to start from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hts.cli import options


def command(
    robot: Annotated[str, typer.Option(help="The machine. `hts plugins` lists them.")],
    out: Annotated[Path, typer.Option(help="Folder for the policy and its log.")],
    config: options.ConfigFile = None,
    set_: options.Overrides = None,
    engine: options.Engine = None,
    seed: options.Seed = None,
) -> None:
    """Train the policy to start from, with the robot's own task and no measured reward."""
    from hts.ppo.pretrain import pretrain

    pretrain(robot, out, config, engine=engine, seed=seed, overrides=set_ or ())
