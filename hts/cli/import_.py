"""`hts import`: somebody's logs become recordings in a store."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hts.cli.printable import say

if TYPE_CHECKING:
    from hts.contracts import Installed, Robot
    from hts.recordings.recording import Recording
    from hts.recordings.same_data import Known

SAME = " (was there already)"
OTHER_NOTES = " (was there already, with other notes, which it keeps)"


def command(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE…",
            help="Log files. Each is a log of its own, unless the mapping has `files`; bags are folders.",
        ),
    ],
    robot: Annotated[str, typer.Option(help="The robot that made the logs, by name.")],
    mapping: Annotated[
        Path | None, typer.Option(metavar="M.yaml", help="Which column is which channel (docs/recordings.md).")
    ] = None,
    to: Annotated[
        Path | None, typer.Option(metavar="STORE", help="The store, such as data.zarr. Made if it is not there.")
    ] = None,
    drop: Annotated[
        list[str] | None, typer.Option(metavar="CHANNEL", help="Import without this channel. May be repeated.")
    ] = None,
    objective: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Refuse logs that lack what it needs, convert to its units; --suggest asks for it. Repeatable.",
        ),
    ] = None,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Read and check, say what would be stored, store nothing.")
    ] = False,
    figure: Annotated[
        Path | None, typer.Option(metavar="F.png", help="Draw what would be stored; .png, .svg or .pdf.")
    ] = None,
    suggest: Annotated[
        bool, typer.Option("--suggest", help="Print a mapping made from the first file's header, to be checked.")
    ] = False,
) -> None:
    """Import logs of a real robot into a recording store.

    All files are read and checked first; if one is refused, all that are refused are named and none is stored.
    """
    from hts.errors import ConfigError
    from hts.places import check_place
    from hts.plugins import load
    from hts.recordings.commanded import excess, shortfall
    from hts.recordings.drawing import check_picture, draw
    from hts.recordings.mapping import assumed_order, load_mapping
    from hts.recordings.needs import as_declared, check_mapping, check_measured, in_units_of, unjudged

    registry = load()
    machine = registry.make_robot(robot)
    if suggest:
        from hts.recordings.suggest import suggested_mapping

        asked = [registry.make_objective(name) for name in objective or []]
        say(suggested_mapping(files[0], machine, asked), nl=False)
        return
    if mapping is None:
        raise ConfigError(_no_mapping(files[0]))
    if to is None and not dry_run:
        raise ConfigError("--to STORE is needed, or --dry-run, which stores nothing.")
    if to is not None:
        check_place(to, "--to STORE")
    if figure is not None:
        check_picture(figure, to)
    given = load_mapping(mapping)
    _drop(given, drop or (), mapping)
    objectives = [registry.make_objective(name) for name in objective or []]
    for one in objectives:
        check_mapping(one, given, mapping)
        check_measured(one, given, machine.channels(), mapping)
    given = as_declared(objectives, given)
    groups = [files] if given.get("files") else [[file] for file in files]
    own = machine.channels()
    read = [
        [in_units_of(objectives, recording, own, mapping) for recording in recordings]
        for recordings in _read(registry, groups, given, machine, mapping)
    ]
    everything = [recording for recordings in read for recording in recordings]
    if (short := shortfall(everything)) is not None:
        say(f"{short} If a log was not copied whole, copy and import it again.", err=True)
    if (long := excess(everything)) is not None:
        say(long, err=True)
    if objectives and (blind := unjudged(everything, machine)) is not None:
        say(blind, err=True)
    if figure is not None:
        draw(everything, figure)
    none = [[("not stored", "")] * len(recordings) for recordings in read]
    stored = none if dry_run or to is None else _store(to, groups, read)
    order = assumed_order(given, machine.spec.joint_names)
    for group, recordings, ids in zip(groups, read, stored, strict=True):
        for recording, (recording_id, again) in zip(recordings, ids, strict=True):
            notes = "; ".join(f"{key} {text}" for key, text in recording.notes.items() if key != "source")
            notes = "; ".join(filter(None, (notes, order)))
            names = ", ".join(path.name for path in group)
            line = f"{recording_id}  {names}: {recording.seconds:.2f} s at {recording.rate_hz:g} Hz, "
            line += f"{', '.join(recording.channels)}{again}" + (f" [{notes}]" if notes else "")
            say(line)
    if figure is not None:
        say(str(figure))


def _no_mapping(log: Path) -> str:
    """What to type where no mapping is named: the one that a robot's runtime wrote beside the log, or a new one."""
    from shlex import quote

    from hts.worlds.field_logs import FOLDER

    beside = log.parent / FOLDER / f"{log.stem}.yaml"
    if beside.is_file():
        return f"--mapping M.yaml is needed; {log.name} has one beside it: --mapping {quote(str(beside))}."
    return "--mapping M.yaml is needed; `hts import FILE --robot R --suggest > M.yaml` begins one."


def _drop(given: dict[str, Any], names: Sequence[str], mapping: Path) -> None:
    from hts.errors import ConfigError, unknown_name
    from hts.recordings.mapping import ordered

    order_mattered = bool(ordered(given))
    channels = given.get("channels")
    for name in names:
        if not isinstance(channels, dict) or name not in channels:
            known = channels if isinstance(channels, dict) else ()
            raise ConfigError(f"{mapping}: --drop: " + unknown_name("channel", name, known))
        del channels[name]
    if order_mattered and not ordered(given):  # what it was for is left out
        given.pop("joint_order", None)


def _read(
    registry: Installed, groups: Sequence[list[Path]], given: dict[str, Any], machine: Robot, mapping: Path
) -> list[Sequence[Recording]]:
    """The recordings of each group of files; every refused one is named before the command ends."""
    from hts.errors import ConfigError, RecordingError
    from hts.recordings.commanded import check_commanded
    from hts.recordings.reading import read_logs

    read: list[Sequence[Recording]] = []
    refused: list[RecordingError] = []
    for group in groups:
        try:
            recordings = read_logs(registry, group, given, machine)
            for recording in recordings:
                check_commanded(recording, group)
            read.append(recordings)
        except ConfigError as error:
            raise ConfigError(f"{mapping}: {error}") from error
        except RecordingError as error:
            refused.append(error)
    if len(refused) > 1:
        for why in refused:
            say(f"refused: {why}", err=True)
        raise RecordingError(f"{len(refused)} of {len(groups)} logs are refused, see above. Nothing was stored.")
    if refused:
        raise RecordingError(f"{str(refused[0]).rstrip('.')}. Nothing was stored.") from refused[0]
    return read


def _store(to: Path, groups: Sequence[list[Path]], read: Sequence[Sequence[Recording]]) -> list[list[tuple[str, str]]]:
    """The id of each recording, and what is said of one that was there already; "" of others."""
    from hts.recordings.kinship import check_kinship
    from hts.recordings.same_data import Known
    from hts.recordings.store import RecordingStore

    everything = [one for recordings in read for one in recordings]
    check_kinship(RecordingStore(to) if (to / "zarr.json").exists() else None, everything)
    store = RecordingStore(to, create=True)
    known = Known(store)
    stored = []
    for group, recordings in zip(groups, read, strict=True):
        where = ", ".join(str(path) for path in group)
        ids = []
        for recording in recordings:
            there = known.find(recording)
            if there is None:
                _tell_of_copy(known, recording, where, to)
                ids.append((store.write(recording, where), ""))
                known.add(ids[-1][0], recording)
            else:
                ids.append((there[0], SAME if there[1] else OTHER_NOTES))
        stored.append(ids)
    return stored


def _tell_of_copy(known: Known, recording: Recording, where: str, to: Path) -> None:
    """Say so if the store has that walk already, under another name or with other stated facts."""

    found = known.walk_of(recording)
    if found is not None:
        there, source, channel = found
        text = (
            f"note: {where}: '{channel}' holds the same samples as recording {there} of {to} ({source}), which has "
            f"another name or states other facts. No two walks are alike, and this one counts twice now: delete "
            f"{to / there} if it is the one that is wrong, or import each log with its own mapping."
        )
        say(text, err=True)
