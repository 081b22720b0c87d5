"""`hts evaluate`: a run's policy against the pretrained one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from hts.cli import options


def command(
    folder: options.RunFolder,
    speed: Annotated[list[float] | None, typer.Option(help="m/s; repeat for several. Default: those of the run.")] = None,
    policy: Annotated[str, typer.Option(help="best, pretrained, a candidate's id, or an ONNX file.")] = "best",
    world: Annotated[str | None, typer.Option(metavar="NAME", help="Another world than that of the run.")] = None,
    seed: options.Seed = None,
) -> None:
    """Head-to-head against the pretrained policy, written to DIR/evaluation.json."""
    from hts.cli.one_line import resumable
    from hts.cli.run_folder import existing_run

    existing_run(folder)
    from hts.evaluation.final import evaluate_run

    with resumable(folder):
        result = evaluate_run(folder, speeds=speed or None, policy=policy, world=world, seed=seed)
    for name, entry in result["objectives"].items():
        for metres_per_second, numbers in entry["speeds"].items():
            typer.echo(f"{name} at {metres_per_second} m/s: {told(numbers, entry['unit'])}")
    typer.echo(str(folder / "evaluation.json"))


def told(numbers: Mapping[str, Any], unit: str) -> str:
    """One speed's improvement with its interval, as a person says it; a fraction (unit "1") in per cent."""
    scale, shown = (100.0, "%") if unit == "1" else (1.0, unit)
    low, high = numbers["improvement_ci95"]
    return (
        f"{scale * numbers['improvement']:+.1f} {shown} (95 %: {scale * low:+.1f} to {scale * high:+.1f}), "
        f"{numbers['segments']} segments, {numbers['falls']} falls"
    )
