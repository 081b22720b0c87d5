"""Packets of the loopback link: little-endian, a header, numbers, a CRC-32 of all before it.

header   magic "HTSR", version u8, kind u8, flags u16, sequence u32, stamp f64 s of the sender's clock
STATE    q dq tau (12 f32 each), quaternion 4, gyro 3, acc 3, foot force 4, velocity 3, current, voltage, charge,
         temperature 12; NaN: not measured
COMMAND  q kp kd (12 f32 each)
TICK     nothing: in lockstep the simulation's clock is now `stamp`; it waits for a DONE with that sequence
DONE     nothing; with the sequence 0xFFFFFFFF it is a greeting

Commands are numbered from 1 by each runtime, and the far side drops one that is older than the newest it has. A
greeting from another address than before is another runtime: from then on the far side counts anew.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np

from hts_go1_runtime.link import Command, State

MAGIC, VERSION = b"HTSR", 1
STATE, COMMAND, TICK, DONE = 1, 2, 3, 4
HEADER = struct.Struct("<4sBBHId")
CRC = struct.Struct("<I")
FLOATS = {STATE: 3 * 12 + 4 + 3 + 3 + 4 + 3 + 3 + 12, COMMAND: 36, TICK: 0, DONE: 0}
SIZE = {kind: HEADER.size + 4 * count + CRC.size for kind, count in FLOATS.items()}
LARGEST = max(SIZE.values())

Packet = tuple[int, int, float, np.ndarray]
"""kind, sequence, stamp, numbers."""


def pack(kind: int, sequence: int, stamp: float, numbers: np.ndarray | None = None) -> bytes:
    """A packet. numbers: as many as the kind has."""
    body = HEADER.pack(MAGIC, VERSION, kind, 0, sequence & 0xFFFFFFFF, stamp)
    if numbers is not None:
        body += numbers.astype("<f4").tobytes()
    return body + CRC.pack(zlib.crc32(body))


def unpack(data: bytes) -> Packet | None:
    """What is in a packet; None if it is damaged, cut short, or none of ours."""
    if len(data) < HEADER.size + CRC.size:
        return None
    magic, version, kind, _, sequence, stamp = HEADER.unpack_from(data)
    if magic != MAGIC or version != VERSION or SIZE.get(kind) != len(data):
        return None
    if CRC.unpack_from(data, len(data) - CRC.size)[0] != zlib.crc32(data[: -CRC.size]):
        return None
    return kind, sequence, stamp, np.frombuffer(data, "<f4", FLOATS[kind], HEADER.size).astype(np.float64)


def numbers_of_state(state: State) -> np.ndarray:
    """The numbers of a STATE."""
    rest = [state.current, state.voltage, state.charge]
    arrays = (state.q, state.dq, state.tau, state.quaternion, state.gyro, state.acc, state.foot_force, state.velocity)
    return np.concatenate([*arrays, rest, state.temperature])


def state_of(sequence: int, stamp: float, received: float, numbers: np.ndarray) -> State:
    """The state in the numbers of a STATE."""
    q, dq, tau, quaternion, gyro, acc, feet, velocity, rest, temperature = np.split(
        numbers, np.cumsum([12, 12, 12, 4, 3, 3, 4, 3, 3])
    )
    current, voltage, charge = (float(one) for one in rest)
    return State(
        sequence,
        stamp,
        received,
        q,
        dq,
        tau,
        quaternion,
        gyro,
        acc,
        feet,
        velocity,
        current,
        voltage,
        charge,
        temperature,
    )


def numbers_of_command(command: Command) -> np.ndarray:
    """The numbers of a COMMAND."""
    return np.concatenate([command.q, command.kp, command.kd])
