"""`hts oracle`: what was possible on a twin."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hts.cli import options

Start = Annotated[
    Path | None,
    typer.Option(
        metavar="POLICY",
        help="Start from this policy (.safetensors), such as a run's best; then it is a candidate too.",
    ),
]
InSimulation = Annotated[
    bool,
    typer.Option(
        "--in-simulation",
        help="Train in simulation as `hts run` does; only the reward sees inside: what a measurement model that never "
        "errs would be worth.",
    ),
]
Steps = Annotated[int | None, typer.Option(help="Control steps per candidate: finetune.steps.")]


def command(
    objective: options.Objectives = None,
    robot: options.RobotName = None,
    preset: options.Preset = None,
    world: options.WorldName = None,
    config: options.ConfigFile = None,
    set_: options.Overrides = None,
    start: Start = None,
    in_simulation: InSimulation = False,
    steps: Steps = None,
    seed: options.Seed = None,
    out: options.Out = None,
    dry_run: options.DryRun = False,
) -> None:
    """What was possible on a twin, for who sees inside: fine-tuning on the reality itself, or only paid by its
    instruments. No method."""
    from hts.cli.one_line import resumable
    from hts.cli.run import default_folder
    from hts.overrides import Override

    overrides: list[str | Override] = list(set_ or ())
    overrides += ["oracle_trains_in=simulation"] if in_simulation else []
    overrides += [Override.by("--steps", "finetune.steps", steps)] if steps is not None else []
    begin = None if start is None else str(start)
    registry, resolved = options.configured(
        objective, robot, preset, world, config, overrides, seed=seed, oracle=True, start=begin
    )
    from hts.oracle import start_oracle

    folder = out or default_folder(resolved)
    with resumable(None if dry_run else folder):
        start_oracle(resolved, folder, dry_run=dry_run, registry=registry)
