"""The robot's own loop: in real time, or in lockstep with the runtime."""

from __future__ import annotations

import time
from typing import TextIO

import numpy as np

from hts_go1_runtime.link import Command
from hts_go1_runtime.packet import numbers_of_state
from hts_go1_stand_in.body import STATE_SECONDS, Body
from hts_go1_stand_in.line import Line

TRACED = 25  # states between two lines of a trace: 0.1 s
BEHIND = 0.25  # s that a real-time robot may fall behind before it lets time go


def serve(
    body: Body, line: Line, lockstep: bool, quiet: float, states_per_tick: int = 1, trace: TextIO | None = None
) -> None:
    """Until the runtime has been silent for `quiet` s. states_per_tick: after how many states the simulation waits for
    the runtime, in lockstep; each wait costs two changes of process; trace: a file for where the robot is."""
    line.heard = time.monotonic()
    while not line.greeted:
        line.commands(0.0, 0.2)
        if time.monotonic() - line.heard > 10 * quiet:
            return
    began, sequence = time.monotonic(), 0
    while time.monotonic() - line.heard < quiet:
        line.state(sequence, body.clock, numbers_of_state(body.state(sequence)))
        if lockstep:
            if sequence % states_per_tick == 0:
                line.tick(sequence, body.clock)
                if not line.done(sequence, body.clock, quiet):
                    return
            _obey(body, line, 0.0)
        else:
            due = began + body.clock + STATE_SECONDS
            while (left := due - time.monotonic()) > 0:
                _obey(body, line, left)
            if left < -BEHIND:
                began += -left
        body.advance()
        if trace is not None and sequence % TRACED == 0:
            trace.write(",".join(f"{one:.4f}" for one in (body.clock, *body.place())) + "\n")
        sequence += 1


def _obey(body: Body, line: Line, seconds: float) -> None:
    """What comes within so many seconds."""
    commands = line.commands(body.clock, seconds)
    if line.greeting:
        body.greet()
        line.greeting = False
    for numbers in commands:
        body.command(Command(*np.split(numbers, 3)))
