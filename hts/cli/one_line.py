"""From an exception to the one line that a user reads, and the exit status. Bugs keep their traceback."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from hts.cli.device_faults import device_fault
from hts.cli.output import OutputFault, say_last
from hts.cli.told_to_end import ToldToEnd, told_to_end
from hts.errors import HtsError, PluginError, RunError, UnfitWorldError, WaitingForRobot
from hts.places import place_fault, resume_command

OF_PATHS = (errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.ENAMETOOLONG, errno.ELOOP)
"""Said only of the error itself: as the cause of another one they may have been dealt with."""
IN_TEXTS = (errno.ENOSPC, errno.EROFS, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.ESTALE, errno.EMFILE)
"""Looked for in the texts of errors that are not the system's own."""


def one_line(error: Exception) -> tuple[str, int] | None:
    """The line for stderr and the exit status; None for an error that is ours, not the user's."""
    if isinstance(error, WaitingForRobot):  # not a failure
        return str(error), error.exit_code
    if isinstance(error, HtsError):
        fault = device_fault(error.__cause__) if isinstance(error, PluginError) else None  # not the plugin's then
        return " ".join(["error:", *str(error).split(), *([fault] if fault else [])]), error.exit_code
    if isinstance(error, typer.TyperException):
        if type(error).__name__ == "NoArgsIsHelpError":
            return error.format_message(), error.exit_code
        return _usage(error), error.exit_code
    if isinstance(error, typer.Abort):
        return "stopped", 1
    from pydantic import ValidationError

    if isinstance(error, ValidationError):  # what a plugin or a script put together, such as a schedule
        from hts.explain import explain

        return f"error: {error.title}: {explain(error)}", HtsError.exit_code
    fault = disk_fault(error) or device_fault(error)
    return (f"error: {fault}", RunError.exit_code) if fault else None


def disk_fault(error: BaseException | None, place: Path | None = None, option: str = "--out or --to") -> str | None:
    """What a full or read-only disk, or a wrong path, did, and what to do; None if neither is at fault.

    Libraries written in other languages give only the text of the system's error, so that is looked at too;
    place: named where the error itself names no file; option: what names another place, empty where nothing does.
    """
    first = error
    while error is not None:
        number = next((one for one in IN_TEXTS if os.strerror(one) in str(error)), 0)
        number = (error.errno or 0) if isinstance(error, OSError) else number
        said = None if number == errno.ENOENT else place_fault(number, option)  # a file that we forgot is a bug
        if said is not None and (error is first or number not in OF_PATHS):
            file = (error.filename if isinstance(error, OSError) else None) or place or "a file"
            return f"{file}: {said}."
        error = error.__cause__ or error.__context__
    return None


@contextmanager
def resumable(folder: Path | None, begun: str = "config.yaml", option: str = "--out or --to") -> Iterator[None]:
    """Whatever stops a run ends in one line that says how to go on with `folder`; None: nothing is written, as in a dry
    run; begun: its file from the start; option: as of `disk_fault`."""

    def left() -> bool:
        return folder is not None and (folder / begun).exists()

    go_on = resume_command(folder or "")
    threading.excepthook = _in_a_thread
    try:
        with told_to_end():
            yield
    except KeyboardInterrupt as stop:
        by = f" by {stop.name}" if isinstance(stop, ToldToEnd) else ""
        say_last(f"\nstopped{by}" + (f": `{go_on}` goes on" if left() else " before anything was written"))
        raise typer.Exit(stop.exit_code if isinstance(stop, ToldToEnd) else 130) from None
    except OutputFault as error:
        if not left():
            raise
        raise RunError(f"{error} `{go_on}` then goes on.") from error
    except HtsError as error:
        said = str(error)
        advised = isinstance(error, (WaitingForRobot, UnfitWorldError)) or "resume" in said or "begin anew" in said
        if advised or not left():
            raise
        raise type(error)(f"{error} `{go_on}` then goes on.") from error
    except Exception as error:
        fault = disk_fault(error, folder, option) or device_fault(error)
        if fault is None:
            raise
        resume = f" Then `{go_on}` goes on." if left() else ""
        raise RunError(f"{fault}{resume}") from error
    finally:
        threading.excepthook = threading.__excepthook__


@contextmanager
def clearing_up() -> Iterator[None]:
    """SIGTERM and SIGHUP end what is done inside as Ctrl-C does, with what was begun taken away, and in one line."""
    try:
        with told_to_end():
            yield
    except ToldToEnd as stop:
        say_last(f"stopped by {stop.name}")
        raise typer.Exit(stop.exit_code) from None


def _in_a_thread(what: threading.ExceptHookArgs) -> None:
    """A thread that a disk stopped (TensorBoard writes in one) need not show it: who waits for it will say it."""
    if not isinstance(what.exc_value, OutputFault) and disk_fault(what.exc_value) is None:
        threading.__excepthook__(what)


def _usage(error: typer.TyperException) -> str:
    context = vars(error).get("ctx")  # only some of them have one
    hint = f" (`{context.command_path} --help`)" if context is not None else ""
    return f"error: {' '.join(error.format_message().split())}{hint}"
