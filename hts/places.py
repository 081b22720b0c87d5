"""Places to write to: whether something can be made there, known before anything is spent on it."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path
from shlex import quote

from hts.atomic import temporary_of
from hts.errors import RunError
from hts.policy_ids import PRETRAINED

PRETRAINING = "pretraining.json"
"""In the folder of a pretraining that is not done: what was asked for."""
PRETRAINED_FILE, CURVE = f"{PRETRAINED}.safetensors", "curve.json"
"""In the folder of one that is done: its policy, with a card beside it, and its learning curve."""

PLACE_FAULTS: dict[int, str] = {
    errno.EROFS: "the file system is read-only. Choose a place that can be written{option}",
    errno.EACCES: "no permission. Change its owner or mode, or choose another place{option}",
    errno.EPERM: "not permitted. Change its owner or mode, or choose another place{option}",
    errno.ENOSPC: "the disk is full. Nothing finished is lost: free some space and give the command again",
    errno.EDQUOT: "the disk quota is used up. Nothing finished is lost: free some space and give the command again",
    errno.EFBIG: "the file would be larger than is allowed here (`ulimit -f`, or the file system's limit). Nothing "
    "finished is lost: raise it and give the command again",
    errno.EIO: "the disk reports an input/output error. Look at it, or choose another place{option}",
    errno.ESTALE: "the network file system has lost it. Mount it anew, or choose another place{option}",
    errno.EMFILE: "too many files are open. Raise the limit (`ulimit -n`) and give the command again",
    errno.ENOTDIR: "a part of this path is a file, not a folder. Choose another place{option}",
    errno.EISDIR: "is a folder, a file was expected. Choose another place{option}",
    errno.ENOENT: "is not there, or cannot be made there. Check the path, or choose another place{option}",
    errno.EEXIST: "exists already. Nothing is overwritten: choose another place{option}",
    errno.ENAMETOOLONG: "a name in this path is too long for the file system. Choose a shorter one{option}",
    errno.ELOOP: "a link in this path leads back to itself. Choose another place{option}",
}
"""errno -> what is wrong and what to do, the end of a sentence that began with the path."""


def resume_command(folder: str | Path) -> str:
    """What goes on with a run or a pretraining, to be pasted into a shell: a folder with a blank is quoted."""
    return f"hts resume {quote(str(folder))}"


def place_fault(number: int, option: str = "") -> str | None:
    """What a system error of this number says of a place; None if it is about something else.

    option: of the command line that names the place, such as "--out DIR"; empty where it is not known.
    """
    found = PLACE_FAULTS.get(number)
    return None if found is None else found.format(option=f" with {option}" if option else "")


def check_text(place: Path, remedy: str) -> None:
    """Raise RunError for a path with bytes that are no UTF-8: some libraries open no such file. remedy: what to do."""
    try:
        os.fsencode(place).decode("utf-8")
    except UnicodeDecodeError as error:
        raise RunError(f"{place}: a name in this path is no text (bytes that are not UTF-8). {remedy}") from error


def check_place(place: Path, option: str, *, file: bool = False) -> None:
    """Raise RunError unless a folder, or a file, can be made at `place`; option: what names it, such as "--out DIR".

    It is tried: a folder with the same names is made beside it and taken away again. A folder that is there counts as
    made; whether it may be used is for the caller to say.
    """
    check_text(place, f"Choose another place with {option}.")
    above = place.parent if file else place
    while not os.path.lexists(above) and above != above.parent:
        above = above.parent
    if not above.is_dir():
        what = "a link to nothing" if above.is_symlink() else "a file, not a folder"
        where = f"{above} is" if above != place else "is"
        raise RunError(f"{place}: {where} {what}. Choose another place with {option}.")
    names = [name for name in place.relative_to(above).parts if name != ".."]
    if file and names:
        names[-1] = temporary_of(Path(names[-1])).name  # the longest name that it will have
    try:
        with tempfile.TemporaryDirectory(prefix=".hts-", dir=above) as beside:
            Path(beside, *names).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = (
            place_fault(error.errno or 0, option) or f"cannot be written ({error}). Choose another place with {option}"
        )
        raise RunError(f"{place}: {why}.") from error


def check_new_file(to: Path) -> None:
    """Raise RunError unless a file can be made there, which `--to` names, and nothing is there yet."""
    check_place(to, "--to FILE", file=True)
    if to.exists():
        raise RunError(f"{to}: exists already. Choose another file with --to.")


def check_new_folder(folder: Path) -> None:
    """Raise RunError if something is there already: nothing is ever overwritten."""
    left = temporary_of(folder / "config.yaml")  # all that a run leaves which was killed before it began
    if folder.is_dir() and all(entry == left for entry in folder.iterdir()):
        return
    if (folder / "config.yaml").exists():
        raise RunError(
            f"{folder}: this folder holds a run already. Go on with it: `{resume_command(folder)}`; or start anew in "
            "another: --out DIR."
        )
    if (folder / PRETRAINING).exists():
        raise RunError(
            f"{folder}: a pretraining was begun here and is not done. Go on with it: `{resume_command(folder)}`; or "
            "start anew in another: --out DIR."
        )
    if folder.exists():
        raise RunError(f"{folder}: exists already and is not an empty folder. Choose another one: --out DIR.")


def existing_run(folder: Path) -> Path:
    """The folder itself. Raises RunError where there is no run in it."""
    if not folder.exists():
        raise RunError(f"{folder}: there is no such folder. Give the folder that `hts run` named at its end.")
    policy = folder / PRETRAINED_FILE
    if not (folder / "config.yaml").is_file() and policy.is_file() and (folder / CURVE).is_file():
        raise RunError(
            f"{folder}: holds a finished pretraining and no run, so there is nothing to go on with. Its policy is "
            f"{policy}: `hts play --policy {policy}` shows it; to start runs from it, let the robot's "
            "pretrained_policy() name it (some robots have a setting for that: `hts plugins NAME`)."
        )
    if not (folder / "config.yaml").is_file():
        raise RunError(f"{folder}: holds no run (no config.yaml). Give the folder that `hts run` named at its end.")
    return folder
