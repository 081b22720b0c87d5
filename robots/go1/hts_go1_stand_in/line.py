"""The line to the runtime, with packets that are lost and packets that are late, both ways."""

from __future__ import annotations

import heapq
import select
import socket
import time

import numpy as np

from hts_go1_runtime.packet import COMMAND, DONE, LARGEST, STATE, TICK, Packet, pack, unpack

HELLO = 0xFFFFFFFF
TAKEN = 0.1  # s after a command in which nobody else is heard: a robot that is told two things does neither


class Line:
    """A UDP socket on 127.0.0.1. loss, late: shares of states and commands; delay: of late ones, at most, s. Times are
    those of the robot's clock, given by the caller."""

    def __init__(self, port: int, loss: float, late: float, delay: float, seed: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(("127.0.0.1", port))
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)
        self.port = self._socket.getsockname()[1]
        self._loss, self._late, self._delay = loss, late, delay
        self._random = np.random.default_rng([seed, 7])
        self._partner: tuple[str, int] | None = None
        self._commanded = -np.inf  # when the partner's last command came
        self._out: list[tuple[float, int, bytes]] = []
        self._in: list[tuple[float, int, Packet]] = []
        self._number, self._newest = 0, -1
        self.lost = self.delayed = 0
        self.heard = time.monotonic()
        self.greeting = False  # another runtime has spoken; whoever greets it says False

    @property
    def greeted(self) -> bool:
        """Whether a runtime has spoken."""
        return self._partner is not None

    def state(self, sequence: int, clock: float, numbers: np.ndarray) -> None:
        """Send a state, which may be lost or late, and what was late and is due."""
        release = self._fate(clock)
        if release is not None:
            self._number += 1
            heapq.heappush(self._out, (release, self._number, pack(STATE, sequence, clock, numbers)))
        while self._out and self._out[0][0] <= clock:
            self._send(heapq.heappop(self._out)[2])

    def tick(self, sequence: int, clock: float) -> None:
        """Say what the simulation's clock is; never lost."""
        self._send(pack(TICK, sequence, clock))

    def commands(self, clock: float, seconds: float) -> list[np.ndarray]:
        """Numbers of the commands that have arrived by now, in order; an older one than was seen is dropped. Waits at
        most so long for something to come."""
        if seconds > 0:
            select.select([self._socket], [], [], seconds)
        self._receive(clock)
        found = []
        while self._in and self._in[0][0] <= clock:
            _, sequence, _, numbers = heapq.heappop(self._in)[2]
            if sequence > self._newest:
                self._newest = sequence
                found.append(numbers)
        return found

    def done(self, sequence: int, clock: float, patience: float) -> bool:
        """Wait until the runtime is done with a tick, or another one has come, which was told of none; False if it is
        silent for `patience` s."""
        end = time.monotonic() + patience
        self._finished = -1
        while time.monotonic() < end:
            if not select.select([self._socket], [], [], 0.05)[0]:
                continue
            self._receive(clock)
            if self._finished == sequence or self.greeting:
                return True
        return False

    def _receive(self, clock: float) -> None:
        while True:
            try:
                data, sender = self._socket.recvfrom(LARGEST + 1)
            except (BlockingIOError, ConnectionRefusedError):
                return
            packet = unpack(data)
            if packet is None:
                continue
            kind, sequence = packet[:2]
            if sender != self._partner:
                greets = kind == DONE and sequence == HELLO
                if not greets or time.monotonic() - self._commanded < TAKEN:
                    continue  # a stranger, or another runtime while one commands the robot
                self._newest, self._in, self.greeting = -1, [], True  # it counts from 1
            self._partner, self.heard = sender, time.monotonic()
            if kind == COMMAND:
                self._commanded = self.heard
            if kind == DONE and sequence != HELLO:
                self._finished = sequence
            elif kind == COMMAND:
                release = self._fate(clock)
                if release is not None:
                    self._number += 1
                    heapq.heappush(self._in, (release, self._number, packet))

    def _fate(self, clock: float) -> float | None:
        """When a packet arrives; None: never."""
        if self._loss and self._random.random() < self._loss:
            self.lost += 1
            return None
        if self._late and self._random.random() < self._late:
            self.delayed += 1
            return clock + self._delay * self._random.random()
        return clock

    def _send(self, data: bytes) -> None:
        if self._partner is not None:
            try:
                self._socket.sendto(data, self._partner)
            except (BlockingIOError, ConnectionRefusedError):
                self.lost += 1
