"""`hts export`: a policy for the robot, or a measurement model for those who train elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hts.cli import options
from hts.errors import ConfigError, unknown_name

FORMATS = {"onnx": (".onnx",), "torchscript": (".pt", ".pth", ".jit", ".ts", ".torchscript")}
"""Format of a policy -> endings of its files, by which `hts policy import`, `play` and others know them again."""


def command(
    to: Annotated[Path, typer.Option(help="File to write, with an ending of its format.")],
    folder: options.RunFolderOrNone = None,
    policy: Annotated[str | None, typer.Option(help=f"Of a run {options.POLICIES}; or a .safetensors file.")] = None,
    robot: Annotated[
        str | None, typer.Option(metavar="NAME", help="Whose it must be; another robot's policy is refused.")
    ] = None,
    format_: Annotated[str, typer.Option("--format", help="onnx or torchscript.")] = "onnx",
    held_speed: Annotated[
        bool,
        typer.Option(
            "--held-speed",
            help="With the commands in front that the run's final found: a commanded forward speed is then about the "
            "speed that was walked there, on that machine.",
        ),
    ] = False,
    measurement_model: Annotated[
        str | None,
        typer.Option(
            metavar="MODEL",
            help="Instead of a policy: of a run an objective, its last model; or a model.safetensors of `hts fit`.",
        ),
    ] = None,
) -> None:
    """Write a policy as ONNX or TorchScript, with all that the robot's computer must know about it.

    Of a run: hts export DIR --to best.onnx. Of a file: hts export --policy mine.safetensors --to mine.onnx.
    A measurement model, for rsl_rl, mjlab and Isaac Lab: hts export DIR --measurement-model OBJECTIVE
    --to model.safetensors.
    """
    from hts.cli.run_folder import run_or_policy_file
    from hts.places import existing_run

    if measurement_model is not None:
        for given, option in ((policy is not None, "--policy"), (held_speed, "--held-speed")):
            if given:
                raise ConfigError(f"{option} and --measurement-model: one export writes one of them. Leave one out.")
        from hts.measurement.export_command import export_measurement_model
        from hts.plugins import load

        place, registry = None if folder is None else existing_run(folder), load()
        spec = None if robot is None else registry.make_robot(robot).spec
        typer.echo(str(export_measurement_model(place, measurement_model, to, spec, registry)))
        return
    if format_ not in FORMATS:
        raise ConfigError("--format: " + unknown_name("format", format_, FORMATS))
    check_ending(to, format_)
    chosen = run_or_policy_file(folder, policy)
    from hts.cli.one_line import clearing_up
    from hts.plugins import load
    from hts.policies.export_command import export_policy
    from hts.policies.gate_notes import warning_beside

    spec = None if robot is None else load().make_robot(robot).spec
    if held_speed and folder is not None:
        from hts.policies.held_commands import held_commands_of

        typer.echo(held_commands_of(folder, chosen).said(), err=True)
    with clearing_up():
        written = export_policy(folder, policy=chosen, format=format_, to=to, robot=spec, held_speed=held_speed)
    if warning := warning_beside(written):
        typer.echo(warning, err=True)
    typer.echo(str(written))


def check_ending(to: Path, form: str) -> None:
    """Raises ConfigError for a name by which nobody would know the format again."""
    endings = FORMATS[form]
    if to.suffix in endings:
        return
    *others, last = endings
    listed = f"{', '.join(others)} or {last}" if others else last
    found = (
        f"ends in '{to.suffix}', a policy as {form} in" if to.suffix else f"has no ending, a policy as {form} ends in"
    )
    other = next((name for name, its in FORMATS.items() if to.suffix in its), None)
    remedy = f", or say --format {other}" if other else ""
    raise ConfigError(f"--to {to}: {found} {listed}. Name the file so{remedy}.")
