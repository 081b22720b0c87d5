"""What is asked of the stand-in on its command line, and how it begins and ends."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TextIO

from hts.errors import HtsError
from hts_go1_runtime.cli import Parser, hurry, whole
from hts_go1_stand_in.body import PER_READING, STATE_SECONDS, Body
from hts_go1_stand_in.line import Line
from hts_go1_stand_in.serve import serve


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve until nobody has spoken for a while, or a signal ends it. Exit code 0; 2 and one line for a mistake in what
    was asked for."""
    parser = Parser(prog="hts_go1_stand_in", description="Play a Go1 over UDP.")
    parser.add_argument("--port", type=whole(0, 65535), required=True, help="on 127.0.0.1; 0: a free one")
    parser.add_argument("--reality", help="name or file of a reality; left out: the twin of the settings")
    parser.add_argument("--seed", type=int, default=0, help="of noise, of the session, of the line")
    parser.add_argument("--objective", action="append", help="whose instruments it carries (default: power)")
    parser.add_argument("--lockstep", action="store_true", help="simulated time that waits for the runtime")
    parser.add_argument("--loss", type=float, default=0.0, help="share of packets that never arrive, each way")
    parser.add_argument("--late", type=float, default=0.0, help="share of packets that arrive late, each way")
    parser.add_argument("--delay-ms", type=float, default=10.0, help="how late at most")
    parser.add_argument("--quiet-seconds", type=float, default=20.0, help="end when nobody has spoken for so long")
    parser.add_argument("--tick-ms", type=float, default=4.0, help="in lockstep: how often the simulation waits")
    parser.add_argument("--priority", type=int, default=0, help="real-time, 1 to 99, where the system allows it")
    parser.add_argument("--trace", type=Path, metavar="FILE", help="of where it walks: time s, x m, y m, heading rad")
    given = parser.parse_args(arguments)
    states = round(given.tick_ms / 1e3 / STATE_SECONDS)
    if states < 1 or abs(given.tick_ms / 1e3 - states * STATE_SECONDS) > 1e-9:
        parser.error(f"--tick-ms {given.tick_ms:g}: expected a multiple of {1e3 * STATE_SECONDS:g}.")
    try:
        body = ready(given.reality, given.objective or ["power"], given.seed)
    except HtsError as error:
        parser.error(" ".join(str(error).split()))
    try:
        try:
            line = Line(given.port, given.loss, given.late, given.delay_ms / 1e3, given.seed)
        except OSError as error:
            parser.error(f"--port {given.port}: {error.strerror}. Choose another; 0 takes a free one.")
        for number in (signal.SIGTERM, signal.SIGINT):
            if signal.getsignal(number) is not signal.SIG_IGN:  # as Ctrl-C is behind `&` in a script
                signal.signal(number, lambda *_: sys.exit(0))
        if given.priority:
            hurry(given.priority)
        try:  # who reads that it is ready may end it in the same instant
            print(f"ready on 127.0.0.1:{line.port}, {body.mass_kg:g} kg", flush=True)
            with _trace(given.trace, parser) as trace:
                serve(body, line, given.lockstep, given.quiet_seconds, states, trace)
        finally:
            print(f"{body.falls} falls, {body.clock:.1f} s, {line.lost} packets lost, {line.delayed} late", flush=True)
    finally:
        body.close()
    return 0


@contextlib.contextmanager
def _trace(path: Path | None, parser: Parser) -> Iterator[TextIO | None]:
    """A file of comma-separated lines, written as they come; None where nobody asked for it."""
    if path is None:
        yield None
        return
    try:
        file = path.open("w", buffering=1, encoding="utf-8")
    except OSError as error:
        parser.error(f"--trace {path}: cannot be written ({error.strerror}).")
    with file:
        file.write("time,x,y,heading\n")
        yield file


def ready(reality: str | None, objectives: list[str], seed: int) -> Body:
    """A robot whose first states take no longer than later ones: what a simulation loads when it is first used, a
    second's work, would be a silence at which a runtime that has just begun stops it."""
    with contextlib.closing(Body(reality, objectives, seed)) as another:
        for number in range(2 * PER_READING):
            another.state(number)
            another.advance()
    return Body(reality, objectives, seed)
