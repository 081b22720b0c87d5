"""`python -m hts_go1_runtime`."""

from __future__ import annotations

import os
import signal
import sys

INTERRUPTED = 130
"""128 + SIGINT, what shells expect."""


def _end(number: int, frame: object) -> None:
    """Ctrl-C while modules are imported: an exception would pass through libraries in C, which make other errors of
    it."""
    os.write(2, b"interrupted: the runtime had not begun, nothing has moved\n")
    os._exit(INTERRUPTED)


def _main() -> int:
    usual = signal.getsignal(signal.SIGINT)
    if usual is signal.default_int_handler:  # not where it is ignored, as behind `&` in a script
        signal.signal(signal.SIGINT, _end)
    try:
        from hts_go1_runtime.cli import main
    except ImportError as error:
        print(f"refused: {error}. It is needed beside this package: pip install numpy onnxruntime", file=sys.stderr)
        return 2
    try:
        signal.signal(signal.SIGINT, usual)
        return main()
    except KeyboardInterrupt:  # before a robot is met, or after it was damped; meanwhile it is the operator's key
        print("interrupted: the robot is not being moved", file=sys.stderr, flush=True)
        return INTERRUPTED


if __name__ == "__main__":
    sys.exit(_main())
