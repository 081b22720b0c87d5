"""`hts import`: somebody's logs become recordings in a store."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE…", help="Log files. Each is a recording, unless the mapping has `files`."),
    ],
    robot: Annotated[str, typer.Option(help="The robot that made the logs, by name.")],
    mapping: Annotated[
        Path, typer.Option(metavar="M.yaml", help="Which column is which channel (docs/recordings.md).")
    ],
    to: Annotated[Path, typer.Option(metavar="STORE", help="The store, such as data.zarr. Made if it is not there.")],
    drop: Annotated[
        list[str] | None, typer.Option(metavar="CHANNEL", help="Import without this channel. May be repeated.")
    ] = None,
    objective: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Refuse logs that lack what this objective needs. May be repeated."),
    ] = None,
) -> None:
    """Import logs of a real robot into a recording store.

    All files are read and checked first; if one is refused, all that are refused are named and none is stored.
    """
    from hts.cli.printable import printable
    from hts.errors import ConfigError, RecordingError, unknown_name
    from hts.plugins import load
    from hts.recordings.mapping import assumed_order, load_mapping
    from hts.recordings.needs import check_mapping
    from hts.recordings.reading import read_log
    from hts.recordings.store import RecordingStore

    registry = load()
    machine = registry.make_robot(robot)
    given = load_mapping(mapping)
    channels = given.get("channels")
    for name in drop or []:
        if not isinstance(channels, dict) or name not in channels:
            known = channels if isinstance(channels, dict) else ()
            raise ConfigError(f"{mapping}: --drop: " + unknown_name("channel", name, known))
        del channels[name]
    for name in objective or []:
        check_mapping(registry.make_objective(name), given, mapping)
    groups = [files] if given.get("files") else [[file] for file in files]
    recordings, refused = [], []
    for group in groups:
        try:
            recordings.append(read_log(registry, group, given, machine))
        except ConfigError as error:
            raise ConfigError(f"{mapping}: {error}") from error
        except RecordingError as error:
            refused.append(error)
    if len(refused) > 1:
        for why in refused:
            typer.echo(printable(f"refused: {why}"), err=True)
        raise RecordingError(f"{len(refused)} of {len(groups)} logs are refused, see above. Nothing was stored.")
    if refused:
        raise RecordingError(f"{refused[0]} Nothing was stored.") from refused[0]
    store = RecordingStore(to, create=True)
    before = set(store.ids())
    for group, recording in zip(groups, recordings, strict=True):
        recording_id = store.write(recording, ", ".join(str(path) for path in group))
        again = " (was there already)" if recording_id in before else ""
        notes = "; ".join(f"{key} {text}" for key, text in recording.notes.items() if key != "source")
        notes = "; ".join(filter(None, (notes, assumed_order(given, machine.spec.joint_names))))
        names = ", ".join(path.name for path in group)
        line = f"{recording_id}  {names}: {recording.seconds:.2f} s at {recording.rate_hz:g} Hz, "
        line += f"{', '.join(recording.channels)}{again}" + (f" [{notes}]" if notes else "")
        typer.echo(printable(line))
