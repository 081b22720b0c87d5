"""`hts bench env|train|sweep|fit`: speed against bare physics in the same process."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer

from hts.cli import options

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    no_args_is_help=True,
    help="Speed against bare physics: the engine alone replaying the states and actions that were collected.",
)

RobotName = Annotated[
    str | None, typer.Option("--robot", metavar="NAME", help="The machine; default: the first that is installed.")
]
ObjectiveName = Annotated[
    str | None, typer.Option("--objective", metavar="NAME", help="Whose measurement model is in the loop.")
]
Engine = Annotated[str, typer.Option(help="mujoco (CPU) or warp (GPU).")]
Candidates = Annotated[int, typer.Option(min=1, help="P")]
Envs = Annotated[int, typer.Option(min=1, help="N, worlds per candidate.")]
Seconds = Annotated[float, typer.Option(min=0.1, help="Least time to measure, s.")]


@app.command()
def env(
    robot: RobotName = None,
    objective: ObjectiveName = None,
    engine: Engine = "mujoco",
    candidates: Candidates = 6,
    envs: Envs = 64,
    seconds: Seconds = 10.0,
    json_: options.AsJson = False,
) -> None:
    """Collect with a policy and a measurement model in the loop."""
    from hts.bench import bench_env

    tell(bench_env(robot, objective, engine, candidates, envs, seconds), json_)


@app.command()
def train(
    robot: RobotName = None,
    objective: ObjectiveName = None,
    engine: Engine = "mujoco",
    candidates: Candidates = 6,
    envs: Envs = 64,
    seconds: Seconds = 20.0,
    json_: options.AsJson = False,
) -> None:
    """Collect and update: whole batches of fine-tuning."""
    from hts.bench import bench_train

    tell(bench_train(robot, objective, engine, candidates, envs, seconds), json_)


@app.command()
def sweep(
    robot: RobotName = None,
    objective: ObjectiveName = None,
    engine: Engine = "mujoco",
    envs: Envs = 64,
    seconds: Seconds = 10.0,
    json_: options.AsJson = False,
) -> None:
    """Fine-tuning speed as the number of candidates grows."""
    from hts.bench import bench_sweep

    tell(bench_sweep(robot, objective, engine, envs, seconds), json_)


@app.command()
def fit(
    robot: RobotName = None,
    objective: ObjectiveName = None,
    seconds: Seconds = 10.0,
    json_: options.AsJson = False,
) -> None:
    """Fit a measurement model to made-up recordings of the right shape."""
    from hts.bench import bench_fit

    tell(bench_fit(robot, objective, seconds), json_)


def tell(result: dict[str, Any], as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps(result, indent=2))
        return
    for key, value in result.items():
        typer.echo(f"{key}: {value:,.4g}" if isinstance(value, float) else f"{key}: {value}")
