"""`hts bench env|train|sweep|fit`: speed against bare physics in the same process."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hts.cli import options
from hts.errors import ConfigError

if TYPE_CHECKING:
    from hts.bench import Sizes

app = options.group(
    "Speed against bare physics: the engine alone replaying the states and actions that were collected."
)

RobotName = Annotated[
    str | None, typer.Option("--robot", metavar="NAME", help="The machine; default: the first that is installed.")
]
ObjectiveName = Annotated[
    str | None, typer.Option("--objective", metavar="NAME", help="Whose measurement model is in the loop.")
]
Engine = Annotated[str, typer.Option(help="mujoco (CPU), warp (GPU), or auto.")]
Device = Annotated[str, typer.Option(help="Of the warp engine: auto (cuda), cuda:1, or cpu (slow, for trials).")]
Hidden = Annotated[
    str | None, typer.Option(metavar="N-N-…", help="Hidden layers, e.g. 512-256-128; default: the shipped policy's.")
]
Memory = Annotated[int, typer.Option(min=0, help="Units of the measurement model; 0: the objective's own.")]
Candidates = Annotated[int, typer.Option(min=1, help="P")]
Envs = Annotated[int, typer.Option(min=1, help="N, worlds per candidate.")]
Alone = Annotated[
    list[int] | None,
    typer.Option(min=1, help="Worlds at which one candidate alone is tried; repeat for several. Default: by device."),
]
Seconds = Annotated[float, typer.Option(min=0.1, help="Least time to measure, s.")]


@app.command()
def env(
    robot: RobotName = None,
    objective: ObjectiveName = None,
    engine: Engine = "mujoco",
    device: Device = "auto",
    candidates: Candidates = 6,
    envs: Envs = 64,
    hidden: Hidden = None,
    memory: Memory = 0,
    seconds: Seconds = 10.0,
    json_: options.AsJson = False,
) -> None:
    """Collect with a policy and a measurement model in the loop."""
    from hts.bench import bench_env

    tell(bench_env(robot, objective, engine, candidates, envs, seconds, sizes(device, hidden, memory)), json_)


@app.command()
def train(
    robot: RobotName = None,
    objective: ObjectiveName = None,
    engine: Engine = "mujoco",
    device: Device = "auto",
    candidates: Candidates = 6,
    envs: Envs = 64,
    hidden: Hidden = None,
    memory: Memory = 0,
    seconds: Seconds = 20.0,
    json_: options.AsJson = False,
) -> None:
    """Collect and update: whole batches of fine-tuning."""
    from hts.bench import bench_train

    tell(bench_train(robot, objective, engine, candidates, envs, seconds, sizes(device, hidden, memory)), json_)


@app.command()
def sweep(
    robot: RobotName = None,
    objective: ObjectiveName = None,
    engine: Engine = "mujoco",
    device: Device = "auto",
    candidates: Candidates = 6,
    envs: Envs = 64,
    hidden: Hidden = None,
    memory: Memory = 0,
    alone: Alone = None,
    whole: Annotated[
        int, typer.Option(min=0, help="Also time whole trainings of so many control steps per candidate.")
    ] = 0,
    seconds: Seconds = 10.0,
    json_: options.AsJson = False,
) -> None:
    """Train candidates together and one after another, at the same worlds each and at the fastest for one alone."""
    from hts.bench import bench_sweep

    chosen = sizes(device, hidden, memory)
    tell(bench_sweep(robot, objective, engine, envs, seconds, candidates, chosen, alone or (), whole), json_)


@app.command()
def fit(
    robot: RobotName = None,
    objective: ObjectiveName = None,
    samples: Annotated[int, typer.Option(min=3000, help="Recorded samples, about.")] = 15_000,
    epochs: Annotated[int, typer.Option(min=0, help="A whole fit of so many; 0: as many as fit into --seconds.")] = 0,
    seconds: Seconds = 10.0,
    json_: options.AsJson = False,
) -> None:
    """Read made-up recordings from a store and fit a measurement model to them."""
    from hts.bench import bench_fit

    tell(bench_fit(robot, objective, seconds, samples, epochs), json_)


def sizes(device: str, hidden: str | None, memory: int) -> Sizes:
    """The options that are not the default. Raises ConfigError for hidden layers that are no numbers."""
    from hts.bench import Sizes

    layers = hidden.split("-") if hidden else []
    if not all(layer.isdecimal() and int(layer) for layer in layers):
        raise ConfigError(f"--hidden {hidden}: expected widths joined by '-', e.g. --hidden 512-256-128")
    return Sizes(device, tuple(int(layer) for layer in layers), memory)


def tell(result: dict[str, Any], as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps(result, indent=2))
        return
    for key, value in result.items():
        typer.echo(f"{key}: {value:,.4g}" if isinstance(value, float) else f"{key}: {value}")
