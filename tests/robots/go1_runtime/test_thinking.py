"""While a person thinks nobody reads the line: what waited on it says how the robot was, not how it is."""

from __future__ import annotations

import contextlib
import dataclasses
import socket
import threading
import time
from typing import Self

import numpy as np
import pytest

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.fake import standing
from hts_go1_runtime.loop import Loop
from hts_go1_runtime.machine import SIT, Limits
from hts_go1_runtime.meeting import check_lies, meet
from hts_go1_runtime.packet import STATE, numbers_of_state, pack
from hts_go1_runtime.udp import UdpLink


class Robot:
    """Says 250 times a second how it is, from a thread, over UDP."""

    def __init__(self) -> None:
        self.stands, self._over = False, threading.Event()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.url = f"udp://127.0.0.1:{self._socket.getsockname()[1]}"
        self._thread = threading.Thread(target=self._talk, daemon=True)

    def _talk(self) -> None:
        _, partner = self._socket.recvfrom(4096)
        sequence = 0
        while not self._over.wait(0.004):
            state = standing(sequence, time.monotonic())
            knees = np.tile([0.0, 0.0, 5.0], 4)
            state = dataclasses.replace(state, tau=knees) if self.stands else dataclasses.replace(state, q=SIT)
            self._socket.sendto(pack(STATE, sequence, state.stamp, numbers_of_state(state)), partner)
            sequence += 1

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._socket.close()


@pytest.mark.parametrize("stands", [True, False])
def test_a_robot_that_was_stood_up_while_a_person_thought_is_seen_to_stand(stands):
    with Robot() as robot, contextlib.closing(UdpLink(robot.url)) as link:
        loop = Loop(link, 0.02, Limits())
        try:
            meet(loop)  # it lies
            loop.pause()
            time.sleep(1.0)  # the line holds about as much
            robot.stands, changed = stands, time.monotonic()
            time.sleep(0.3)
            seen = loop.resume()
            assert seen and all(state.stamp > changed for state in seen)
            if stands:
                with pytest.raises(RuntimeFault, match="stands, its legs carry it"):
                    check_lies(seen)
            else:
                check_lies(seen)
        finally:
            loop.close()
