"""A link over UDP on this computer or a cable: to a stand-in for a robot, or to a process that speaks its SDK.

In lockstep the far side is a simulation that waits: its TICK says what the clock is and is answered by DONE once
everything due by then has been done. States and commands may be lost or late there too.
"""

from __future__ import annotations

import select
import socket
import time
from dataclasses import replace
from urllib.parse import urlsplit

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.link import Command, Counts, Link, State
from hts_go1_runtime.lock import alone_with
from hts_go1_runtime.packet import (
    COMMAND,
    DONE,
    LARGEST,
    STATE,
    TICK,
    numbers_of_command,
    pack,
    state_of,
    unpack,
)

GLANCE = 0.004  # s: how long to look at the line before looking at everything else
PATIENCE = 60.0  # s that a simulation may take for a step


class UdpLink(Link):
    """To HOST:PORT. The first packet is sent by us, so the far side needs no address of ours.

    Raises RuntimeFault for an address that is none, for one that another runtime of this computer talks to, and in
    lockstep for a simulation that has ended.
    """

    def __init__(self, url: str, lockstep: bool = False) -> None:
        host, port = _address(url)
        self.simulated, self.counts = lockstep, Counts()
        self._url, self._sequence, self._newest = url, 0, -1
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.connect((host, port))
        except OSError as error:
            self._socket.close()
            raise RuntimeFault(f"--link {url}: {error.strerror or error}. Correct host and port.") from error
        self._clock, self._tick = 0.0, -1
        try:
            self._alone = alone_with(url, self._socket.getpeername())
        except RuntimeFault:
            self._socket.close()
            raise
        self.hello()

    def now(self) -> float:
        return self._clock if self.simulated else time.monotonic()

    def wait(self, until: float) -> list[State]:
        if self.simulated:
            return self._lockstep()
        left = until - time.monotonic()
        if left > 0:
            select.select([self._socket], [], [], min(left, GLANCE))
        return self._drain()

    def send(self, command: Command) -> None:
        self._sequence += 1
        self.counts.sent += 1
        self._send(pack(COMMAND, self._sequence, self.now(), numbers_of_command(command)))

    def hello(self) -> None:
        """Ask a far side that is not up yet, or has forgotten us, to begin."""
        self._send(pack(DONE, 0xFFFFFFFF, 0.0))

    def close(self) -> None:
        self._socket.close()
        if self._alone is not None:
            self._alone.close()

    def _lockstep(self) -> list[State]:
        """Everything up to the next tick of the simulation, which goes on once this one is done with."""
        if self._tick >= 0:
            self._send(pack(DONE, self._tick, self._clock))
        states: list[State] = []
        tick, end = self._tick, time.monotonic() + PATIENCE
        while self._tick == tick:
            if not select.select([self._socket], [], [], 0.2)[0]:
                if time.monotonic() > end:
                    raise RuntimeFault(
                        f"{self._url}: the simulation has not answered for {PATIENCE:g} s. Start both again."
                    )
                self._send(pack(DONE, self._tick if tick >= 0 else 0xFFFFFFFF, self._clock))
                continue
            states += self._drain()
        return [replace(state, received=self._clock) for state in states]

    def _drain(self) -> list[State]:
        states: list[State] = []
        while True:
            try:
                data = self._socket.recv(LARGEST + 1)
            except BlockingIOError:
                return states
            except ConnectionRefusedError:  # nobody there yet, or no longer: silence says so soon enough
                continue
            except OSError:  # no way there any more: the same
                return states
            packet = unpack(data)
            if packet is None:
                self.counts.broken += 1
                continue
            kind, sequence, stamp, numbers = packet
            if kind == TICK and self.simulated:
                self._clock, self._tick = stamp, sequence
                return states
            if kind == STATE:
                if sequence <= self._newest:  # it was counted as lost when the newer one came
                    self.counts.late += 1
                    self.counts.lost = max(0, self.counts.lost - 1)
                    continue
                if self._newest >= 0:
                    self.counts.lost += sequence - self._newest - 1
                self._newest = sequence
                self.counts.received += 1
                states.append(state_of(sequence, stamp, self.now(), numbers))

    def _send(self, data: bytes) -> None:
        try:
            self._socket.send(data)
        except OSError:  # nobody there, a full buffer, a cable that was pulled: silence stops the robot
            self.counts.extra["unsent"] = self.counts.extra.get("unsent", 0) + 1


def _address(url: str) -> tuple[str, int]:
    """Host and port of udp://HOST:PORT. Raises RuntimeFault."""
    try:
        parts = urlsplit(url)  # raises ValueError for half of an IPv6 address
        host, port = parts.hostname, parts.port  # and here for a port that is no number from 0 to 65535
        if parts.scheme == "udp" and host and port:
            host.encode("idna")  # and, as UnicodeError, for what is no name of a host
            return host, port
    except ValueError:
        pass
    raise RuntimeFault(f"--link {url}: expected udp://HOST:PORT, such as udp://127.0.0.1:9870.")
