"""`python -m hts_go1_runtime.fake`: a robot that hangs in the pose of standing, legs held fast, says so 250 times a
second, and then fails on purpose. Its motors give the torque that they are asked for.

For the bench and for tests: it notes when it failed and when the damping command came, on the clock that all processes
of a computer share, and prints both as one line of JSON.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import select
import signal
import socket
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hts_go1_runtime.link import DAMPING, State
from hts_go1_runtime.machine import STAND
from hts_go1_runtime.packet import COMMAND, LARGEST, STATE, numbers_of_state, pack, unpack

PERIOD = 0.004  # s
FAULTS = (
    "none", "tilt", "joint limit", "joint speed", "over-current", "low voltage", "temperature", "lost link",
    "stale states", "not finite", "orientation", "not following", "frozen sensor", "operator file", "operator signal",
    "operator key",
)  # fmt: skip


def standing(sequence: int, stamp: float) -> State:
    """A state of a robot in the pose of standing whose joints carry nothing, as on a stool."""
    zero = np.zeros(12)
    return State(
        sequence, stamp, 0.0, STAND.copy(), zero.copy(), zero.copy(), np.array([1.0, 0, 0, 0]), np.zeros(3),
        np.array([0, 0, 9.81]), np.full(4, 30.0), np.zeros(3), 3.0, 22.0, 80.0, np.full(12, 40.0),
    )  # fmt: skip


def noisy(state: State, random: np.random.Generator) -> State:
    """The same state as sensors show it: none of them gives one number twice."""
    turn = np.array([1.0, *(1e-4 * random.standard_normal(3))])
    w, x, y, z = state.quaternion
    a, b, c, d = turn / np.linalg.norm(turn)
    turned = [
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    ]
    return dataclasses.replace(
        state,
        q=state.q + 1e-4 * random.standard_normal(12),
        dq=state.dq + 0.01 * random.standard_normal(12),
        gyro=state.gyro + 1e-3 * random.standard_normal(3),
        quaternion=np.array(turned),
    )


def failing(state: State, fault: str) -> State:
    """The same state with a fault in it; unchanged for faults that are not in a state."""
    lean = math.radians(60) / 2
    changed: dict[str, dict[str, object]] = {
        "tilt": {"quaternion": np.array([math.cos(lean), math.sin(lean), 0, 0])},
        "joint limit": {"q": np.where(np.arange(12) == 2, -3.0, state.q)},
        "joint speed": {"dq": np.where(np.arange(12) == 4, 45.0, 0.0)},
        "over-current": {"current": 35.0},
        "low voltage": {"voltage": 18.0},
        "temperature": {"temperature": np.where(np.arange(12) == 7, 85.0, 40.0)},
        "not finite": {"dq": np.full(12, np.nan)},
        "orientation": {"quaternion": np.zeros(4)},
        "not following": {"tau": np.zeros(12)},
        "frozen sensor": {"gyro": np.array([0.1, -0.2, 0.3])},
    }
    return dataclasses.replace(state, **changed.get(fault, {}))  # type: ignore[arg-type]


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve until the damping command came, or `--seconds` are over."""
    parser = argparse.ArgumentParser(prog="hts_go1_runtime.fake")
    parser.add_argument("--fault", choices=FAULTS, default="none")
    parser.add_argument("--at", type=float, default=1.0, help="s after the first command")
    parser.add_argument("--seconds", type=float, default=5.0, help="after the first command")
    parser.add_argument("--stop-file", type=Path)
    parser.add_argument("--process", type=int, help="that gets the signal")
    parser.add_argument("--key", type=int, help="file descriptor of the runtime's keyboard")
    given = parser.parse_args(arguments)
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    line.bind(("127.0.0.1", 0))
    print(line.getsockname()[1], flush=True)
    partner, begun, failed, damped = None, None, None, None
    torque = np.zeros(12)
    sequence, due, random = 0, time.monotonic(), np.random.default_rng(0)
    while begun is None or time.monotonic() - begun < given.seconds:
        due += PERIOD
        while (left := due - time.monotonic()) > 0:
            if not select.select([line], [], [], left)[0]:
                break
            data, partner = line.recvfrom(LARGEST + 1)
            packet = unpack(data)
            if packet is None or packet[0] != COMMAND:
                continue
            begun = begun or time.monotonic()
            target, kp, kd = np.split(packet[3], 3)
            torque = kp * (target - STAND)
            if not kp.any() and np.allclose(kd, DAMPING.kd) and damped is None:
                damped = time.monotonic()
        if damped is not None:
            break
        state = noisy(dataclasses.replace(standing(sequence, time.monotonic()), tau=torque), random)
        if begun is not None and time.monotonic() - begun > given.at and given.fault != "none":
            if failed is None:
                failed = time.monotonic()
                _from_outside(given)
            if given.fault == "lost link":
                continue
            if given.fault == "stale states":  # the clock in them stands still
                state = dataclasses.replace(state, stamp=failed - 0.05)
            state = failing(state, given.fault)
        if partner is not None:
            line.sendto(pack(STATE, sequence, state.stamp, numbers_of_state(state)), partner)
            sequence += 1
    print(json.dumps({"failed": failed, "damped": damped}), flush=True)
    return 0


def _from_outside(given: argparse.Namespace) -> None:
    """What an operator does."""
    if given.fault == "operator file":
        given.stop_file.touch()
    elif given.fault == "operator signal":
        os.kill(given.process, signal.SIGUSR1)
    elif given.fault == "operator key":
        os.write(given.key, b"\n")


if __name__ == "__main__":
    sys.exit(main())
