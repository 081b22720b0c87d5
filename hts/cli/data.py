"""`hts data`: what is in a recording store, and what it is good for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hts.cli import options
from hts.cli.printable import say

if TYPE_CHECKING:
    from hts.recordings.recording import Recording
    from hts.recordings.store import RecordingStore

CANNOT_BE_SAID = 3
"""Exit code of a question that the data do not answer: neither no (1) nor an error (2)."""

app = options.group("Look into a recording store: ls, show, compare, validate, lag, enough; export it.")

StorePath = Annotated[Path, typer.Argument(metavar="STORE", help="The store, such as RUN/data.zarr.")]
AsJson = Annotated[bool, typer.Option("--json", help="As JSON, for programs.")]


@app.command()
def ls(store: StorePath, as_json: AsJson = False) -> None:
    """List the recordings, one line each."""
    from hts.errors import RecordingError

    opened = _open(store)
    rows: list[dict[str, Any]] = []
    damaged: list[str] = []
    for recording_id in opened.ids():
        try:
            attributes = opened.attributes(recording_id)
        except RecordingError as error:
            damaged.append(str(error))
        else:
            rows.append({"id": recording_id, **attributes})
    rows.sort(key=lambda row: (row["iteration"], row["session"], row["block"], row["id"]))
    if as_json:
        typer.echo(json.dumps({"recordings": rows, "damaged": damaged}, indent=2))
    elif rows:
        _table(
            (
                "id",
                "robot",
                "world",
                "iter",
                "role",
                "session",
                "block",
                "seconds",
                "speeds m/s",
                "policy",
                "real channels",
            ),
            [_listed(row) for row in rows],
        )
    elif not damaged:
        typer.echo(f"{store}: no recordings.")
    if damaged:
        raise RecordingError(f"{len(damaged)} damaged, `hts data validate {store}` shows all; the first: {damaged[0]}")


@app.command()
def show(
    store: StorePath,
    recording: Annotated[str, typer.Argument(metavar="ID", help="A recording, or the beginning of its id.")],
    as_json: AsJson = False,
) -> None:
    """Show one recording: its attributes, and each channel's unit, rate and range."""
    opened = _open(store)
    recording_id = _complete(opened, recording)
    attributes = opened.attributes(recording_id)
    read = opened.read(recording_id)
    channels = _statistics(read)
    if as_json:
        typer.echo(json.dumps({"id": recording_id, **attributes, "statistics": channels}, indent=2))
        return
    typer.echo(f"recording {recording_id}")
    for key, value in attributes.items():
        if key not in ("arrays", "joint_names", "kp", "kd", "schedule"):
            say(f"  {key}: {value if not isinstance(value, dict) else _pairs(value)}")
    say(f"  schedule: {_schedule(attributes)}")
    for joint, kp, kd in zip(attributes["joint_names"], attributes["kp"], attributes["kd"], strict=True):
        say(f"  joint {joint}: kp {kp:g} N*m/rad, kd {kd:g} N*m*s/rad")
    rows = [
        (
            name,
            about["unit"],
            f"{about['rate_hz']:g}",
            str(tuple(about["shape"])),
            *(f"{about[key]:.4g}" for key in _NUMBERS),
        )
        for name, about in channels.items()
    ]
    _table(("channel", "unit", "Hz", "shape", *_NUMBERS), rows)


@app.command()
def compare(
    store: StorePath,
    first: Annotated[str, typer.Argument(metavar="ID", help="A recording.")],
    second: Annotated[str, typer.Argument(metavar="ID", help="Another.")],
    as_json: AsJson = False,
) -> None:
    """Compare two recordings: attributes that differ, and mean and spread of the channels both have."""
    opened = _open(store)
    ids = [_complete(opened, name) for name in (first, second)]
    headers = [{k: v for k, v in opened.attributes(name).items() if k != "arrays"} for name in ids]
    statistics = [_statistics(opened.read(name)) for name in ids]
    different = {key: [header[key] for header in headers] for key in headers[0] if headers[0][key] != headers[1][key]}
    both = [name for name in statistics[0] if name in statistics[1]]
    only = {ids[i]: [name for name in statistics[i] if name not in both] for i in (0, 1)}
    if as_json:
        channels = {name: [one[name] for one in statistics] for name in both}
        say(json.dumps({"ids": ids, "attributes": different, "channels": channels, "only_in": only}, indent=2))
        return
    _table(("attribute", *ids), [(key, str(left), str(right)) for key, (left, right) in different.items()])
    rows = []
    for name in both:
        left, right = (one[name] for one in statistics)
        rows.append(
            (name, left["unit"], *(f"{one[key]:.4g}" for key in ("mean", "std", "rms") for one in (left, right)))
        )
    _table(("channel", "unit", "mean 1", "mean 2", "std 1", "std 2", "rms 1", "rms 2"), rows)
    for recording_id, names in only.items():
        if names:
            say(f"only in {recording_id}: {', '.join(names)}")


@app.command()
def validate(store: StorePath, as_json: AsJson = False) -> None:
    """Read and hash everything; name what is damaged. Exit code 2 if anything is."""
    opened = _open(store)
    damages = opened.validate()
    if as_json:
        found = [{"id": damage.id, "message": damage.message} for damage in damages]
        typer.echo(json.dumps({"recordings": len(opened.ids()), "damaged": found}, indent=2))
    else:
        for damage in damages:
            typer.echo(damage.message)
        if not damages:
            typer.echo(
                f"{store}: {len(opened.ids())} recordings, all whole. Data set {opened.dataset(opened.ids()).sha256}"
            )
    if damages:
        raise typer.Exit(2)


@app.command()
def lag(
    store: StorePath,
    objective: Annotated[
        str | None, typer.Option(help="Whose gauge and inputs. `hts plugins` lists them. Or --target and --input.")
    ] = None,
    target: options.Target = None,
    input_: options.Inputs = None,
    as_json: AsJson = False,
) -> None:
    """How late a gauge shows what the joints do."""
    from hts.cli.data_use import show_lag
    from hts.measurement.wanted import Wanted

    for line in show_lag(store, objective, Wanted(target, tuple(input_ or ())), as_json):
        say(line)


@app.command()
def enough(
    store: StorePath,
    objective: Annotated[
        str | None, typer.Option(help="Whose model. `hts plugins` lists them. Or --target and --input.")
    ] = None,
    target: options.Target = None,
    input_: options.Inputs = None,
    speed: Annotated[
        list[float] | None, typer.Option(help="At which policies are to be judged, m/s. May be repeated.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Whether this is enough data for a model to trust: what is missing, and the error on policies held out.

    Exit code 1 where something is missing, 3 where that cannot be said of a --speed, since no speeds are stated.
    """
    from hts.cli.data_use import show_enough
    from hts.measurement.wanted import Wanted

    lines, verdict = show_enough(store, objective, Wanted(target, tuple(input_ or ())), speed or (), as_json)
    for line in lines:
        say(line)
    if verdict is not True:
        raise typer.Exit(CANNOT_BE_SAID if verdict is None else 1)


@app.command()
def export(
    store: StorePath,
    to: Annotated[Path, typer.Option(metavar="DIR", help="A new folder.")],
    recording: Annotated[
        list[str] | None, typer.Option(metavar="ID", help="Only these. May be repeated; all if left out.")
    ] = None,
    state: Annotated[
        list[str] | None, typer.Option(metavar="CHANNEL", help="What becomes observation.state. May be repeated.")
    ] = None,
    action: Annotated[str | None, typer.Option(metavar="CHANNEL", help="What becomes action.")] = None,
) -> None:
    """Write the recordings as a LeRobot dataset, layout v3: each becomes an episode."""
    from hts.recordings.lerobot_writer import write_dataset

    opened = _open(store)
    ids = [_complete(opened, one) for one in recording] if recording else list(opened.ids())
    write_dataset([opened.read(one) for one in ids], to, state or (), action)
    say(f"{to}: {len(ids)} episodes")


_NUMBERS = ("min", "mean", "max", "std", "rms")


def _open(path: Path) -> RecordingStore:
    from hts.recordings.store import RecordingStore

    return RecordingStore(path)


def _complete(store: RecordingStore, beginning: str) -> str:
    """The one id that begins so."""
    from hts.errors import RecordingError, unknown_name

    matching = [name for name in store.ids() if name.startswith(beginning)]
    if len(matching) > 1:
        raise RecordingError(
            f"{store.path}: '{beginning}' begins {len(matching)} recordings: {', '.join(matching)}. Give more of it."
        )
    if not matching:
        raise RecordingError(f"{store.path}: " + unknown_name("recording", beginning, store.ids()))
    return matching[0]


def _statistics(recording: Recording) -> dict[str, dict[str, Any]]:
    import numpy as np

    found: dict[str, dict[str, Any]] = {}
    for name, series in recording.channels.items():
        values = series.values.astype(np.float64)
        found[name] = {
            "unit": series.channel.unit,
            "rate_hz": recording.rate_hz,
            "shape": list(series.channel.shape),
            "min": float(values.min()),
            "mean": float(values.mean()),
            "max": float(values.max()),
            "std": float(values.std()),
            "rms": float(np.sqrt((values**2).mean())),
        }
    return found


def _listed(row: dict[str, Any]) -> tuple[str, ...]:
    from hts.recordings.on_schedule import stated

    speeds = list(dict.fromkeys(_commanded(command) for command in row["schedule"]["commands"]))
    shown = "not stated" if not stated(row["notes"]) else " ".join(speeds[:4]) + (" …" if len(speeds) > 4 else "")
    seconds = f"{row['samples'] / row['rate_hz']:.1f}" + (" fell" if row["fell"] else "")
    place = (str(row["iteration"]), row["role"], row["session"], str(row["block"]))
    return (
        row["id"],
        row["robot"],
        row["world"],
        *place,
        seconds,
        shown,
        row["policy_hash"][:12],
        " ".join(row["idle"]),
    )


def _commanded(command: dict[str, Any]) -> str:
    """A forward velocity, m/s; the set-point of another task, in its unit; a dash for nothing."""
    point = command.get("vx", command.get("set_point"))
    return "–" if point is None else f"{point:g}"


def _stretch(command: dict[str, Any]) -> str:
    if "vx" not in command:
        return f"{command['seconds']:g} s at set-point {_commanded(command)}"
    velocity = f"({command['vx']:g}, {command['vy']:g}) m/s, {command['yaw_rate']:g} rad/s"
    return f"{command['seconds']:g} s at {velocity}"


def _schedule(attributes: dict[str, Any]) -> str:
    from hts.recordings.on_schedule import stated

    commands = attributes["schedule"]["commands"]
    if not stated(attributes["notes"]):
        return "commands not stated"
    text = ", ".join(_stretch(command) for command in commands[:6])
    return text + (f", … {len(commands) - 6} more" if len(commands) > 6 else "")


def _pairs(values: dict[str, Any]) -> str:
    return ", ".join(f"{key} = {value}" for key, value in values.items()) or "none"


def _table(titles: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Columns as wide as they need to be, whatever the terminal, so that output can be searched and cut."""
    widths = [max(len(row[i]) for row in [titles, *rows]) for i in range(len(titles))]
    for row in [titles, *rows]:
        say("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
