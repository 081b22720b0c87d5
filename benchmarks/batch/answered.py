"""A benchmark's command line with subcommands, answered like `hts` answers: one line for a mistake, and a status."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence

from hts.errors import HtsError


def answered(parser: argparse.ArgumentParser, arguments: Sequence[str] | None = None) -> int:
    """Do what the subcommand's `do` does, and return its status; an HtsError's own for a mistake, 130 for Ctrl-C, 1
    where whoever reads the output has gone (`| head`)."""
    given = parser.parse_args(arguments)
    do: Callable[[argparse.Namespace], int] = given.do
    try:
        status = do(given)
        sys.stdout.flush()
        return status
    except HtsError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or the interpreter fails at its last flush
        return 1
