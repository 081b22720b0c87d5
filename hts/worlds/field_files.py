"""Which files in a bundle's `logs/` are the log of a row, and whether they are there as a whole.

Logs come from another computer, over a slow network or a stick, while a person types `hts resume`: what is still being
copied must not be taken for the log. What file managers and editors leave beside it is nobody's log.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from hts.errors import RecordingError, WaitingForRobot, WorldError
from hts.recordings.commanded import ends_early
from hts.recordings.recording import Recording

NOT_WHOLE = (".part", ".partial", ".filepart", ".crdownload", ".download", ".tmp")
"""How programs that copy call a file until all of it is there."""
LEFT_BESIDE = ("thumbs.db", "ehthumbs.db", "desktop.ini")
PLAN = "plan.json"
"""Of a bundle: its rows, and the names of their sessions, which no other bundle has."""
LOOK_AGAIN_SECONDS = 2.0
"""A copy that stands still for so long is taken for one that is done."""

Stamps = dict[Path, tuple[int, int]]


def log_files(folder: Path, name: str) -> list[Path]:
    """Whole files of one log: everything in a folder NAME, and NAME.something; none while a part of it is copied. A row
    that has both may have been walked again, and somebody has to say which of them is its log.

    Raises WorldError where they cannot be read.
    """
    found = _of_row(folder, name)
    return [] if any(_not_whole(path) for path in found) else found


def beside(folder: Path, missing: Sequence[str]) -> str:
    """What lies in `logs/` that may be the log of a missing row: what is still being copied, and names that are almost
    a row's. A sentence each, "" for nothing."""
    copied = [path.name for name in missing for path in _of_row(folder, name) if _not_whole(path)]
    said = [f"Still being copied, by its name: {', '.join(copied)}. "] if copied else []
    for path in sorted(folder.glob("*")):
        number = re.search(r"\d+", path.name)
        row = next((name for name in missing if number and name.isdigit() and int(number[0]) == int(name)), None)
        if row is not None and not _is_left_beside(path) and path.name.partition(".")[0] != row:
            said.append(f"'{path.name}' is no row's name: if it is the log of row {row}, call it {row}{path.suffix}. ")
            break
    return "".join(said) or _elsewhere(folder, missing)


def _elsewhere(folder: Path, missing: Sequence[str]) -> str:
    """A sentence where logs of missing rows lie in another folder of the bundle, such as logs/logs, or in one that was
    this bundle until somebody gave it another name; "" for nothing."""
    bundle = folder.parent
    plan = _bytes(bundle / PLAN)
    renamed = [one for one in sorted(bundle.parent.iterdir()) if one != bundle and plan and _bytes(one / PLAN) == plan]
    for old in renamed:
        if any(_of_row(old / folder.name, name) for name in missing):
            return (
                f"{old} holds this bundle's logs under another name: put what is in its {folder.name} into {folder}. "
            )
    inside = [bundle, *sorted(one for one in bundle.iterdir() if one.is_dir()), *sorted(folder.glob("*/"))]
    for place in inside:
        own = (folder, folder / "mappings", *(folder / name for name in missing))
        found = [path for name in missing for path in _of_row(place, name)] if place not in own else []
        if found:
            return (
                f"{found[0]} may be the log of row {found[0].name.split('.')[0]}: put what lies there into {folder}. "
            )
    return ""


def _bytes(path: Path) -> bytes | None:
    """What a small file holds; None where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError:
        return None


@contextmanager
def whole(files: Sequence[Path], command: str) -> Iterator[None]:
    """Around the reading of a log. Raises WaitingForRobot where it was being written meanwhile, or what is wrong with
    it may come of that. command: what to type then."""
    before = stamps(files)
    try:
        yield
    except RecordingError as error:
        time.sleep(LOOK_AGAIN_SECONDS)
        check_still(before, command, error)
        raise
    check_still(before, command)


def may_be_cut(recording: Recording) -> bool:
    """Whether a log may be a copy of which the end has still to come."""
    return "last_line_dropped" in recording.notes or ends_early(recording)


def check_still(before: Stamps, command: str, cause: Exception | None = None) -> None:
    """Raise WaitingForRobot if one of the files is another than it was."""
    now = stamps(before)
    for path, (size, _) in before.items():
        if now[path] != before[path]:
            raise WaitingForRobot(
                f"{path}: is still being written ({size} bytes, now {now[path][0]}). Wait until all logs are copied; "
                f"then type: {command}"
            ) from cause


def stamps(files: Iterable[Path]) -> Stamps:
    """Size in bytes and time of the last change of each; of one that is gone, -1."""
    found: Stamps = {}
    for path in files:
        try:
            about = path.stat()
        except OSError:
            found[path] = (-1, -1)
        else:
            found[path] = (about.st_size, about.st_mtime_ns)
    return found


def _of_row(folder: Path, name: str) -> list[Path]:
    try:
        inside = _files((folder / name).iterdir()) if (folder / name).is_dir() else []
        return [*inside, *_files(folder.glob(f"{name}.*"))]
    except OSError as error:
        raise WorldError(f"{folder}: cannot be read ({error.strerror}).") from error


def _files(paths: Iterable[Path]) -> list[Path]:
    return sorted(path for path in paths if path.is_file() and not _is_left_beside(path))


def _is_left_beside(path: Path) -> bool:
    """A hidden file, an editor's copy of what was there before, or what Windows keeps about a folder or a download."""
    low = path.name.lower()
    return low.startswith(".") or low.endswith(("~", ":zone.identifier")) or low in LEFT_BESIDE


def _not_whole(path: Path) -> bool:
    return path.name.lower().endswith(NOT_WHOLE)
