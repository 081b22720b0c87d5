"""`hts`: where the command line begins and where every error ends as one line."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from typing import Any

INTERRUPTED = 130  # 128 + SIGINT, what shells expect


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the exit status. HTS_DEBUG=1 shows tracebacks instead of one line."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        return _ended(arguments)
    except KeyboardInterrupt:  # also while modules are imported
        return INTERRUPTED


def _ended(arguments: list[str]) -> int:
    # dm_control looks for a display when it is imported and warns without one; nothing here needs it.
    warnings.filterwarnings("ignore", message=".*DISPLAY environment variable is missing")
    from hts.cli.one_line import one_line
    from hts.cli.output import NobodyReads, careful_output, say_last
    from hts.cli.printable import printable
    from hts.cli.told_to_end import interruptible

    try:
        with careful_output(), interruptible():
            status = _done(arguments)
    except NobodyReads:  # who ended the pipe knows
        return 1
    except Exception as error:
        explained = one_line(error)
        if explained is None or os.environ.get("HTS_DEBUG") == "1":
            raise
        line, code = explained
        say_last(printable(line))
        return code
    return status if isinstance(status, int) else 0


def _done(arguments: list[str]) -> Any:
    if arguments[:1] == ["--version"]:
        from hts import __version__

        print(f"hts {__version__}")
        return 0
    from hts.cli.group import hts_group

    _check_here()
    return hts_group().main(args=arguments or ["--help"], prog_name="hts", standalone_mode=False)


def _check_here() -> None:
    """Raise RunError where the working directory is gone or may not be entered: libraries end the process then, or make
    faults of a disk or of a plugin out of it."""
    from hts.errors import RunError

    try:
        here = os.getcwd()
    except FileNotFoundError as error:
        raise RunError(
            "The folder in which hts is typed was moved away or deleted. `cd` to one that is there."
        ) from error
    except OSError as error:
        raise RunError(
            f"The folder in which hts is typed cannot be found out ({error.strerror}). `cd` to another one."
        ) from error
    try:
        os.stat(os.path.join(here, os.curdir))
    except OSError as error:
        raise RunError(
            f"{here}: the folder in which hts is typed cannot be entered ({error.strerror}). `cd` to another one, or "
            "change the owner or mode of it or of a folder above it."
        ) from error


if __name__ == "__main__":
    sys.exit(main())
