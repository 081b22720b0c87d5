"""`python -m hts_go1_stand_in`."""

from __future__ import annotations

import os
import signal
import sys

INTERRUPTED = 130
"""128 + SIGINT, what shells expect."""


def _end(number: int, frame: object) -> None:
    """Ctrl-C while it loads: nothing is there to be wound up, and an exception would pass through libraries in C."""
    os._exit(INTERRUPTED)


def _main() -> int:
    os.environ["MUJOCO_GL"] = "disable"  # nothing is drawn, so no library need look for a display, and warn without one
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where it is ignored
        signal.signal(signal.SIGINT, _end)
    from hts_go1_stand_in.cli import main

    return main()


if __name__ == "__main__":
    sys.exit(_main())
