"""One robot, one runtime: two bundles are two folders of logs, and what they tell a robot does not mix."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys

import pytest

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.udp import UdpLink


@pytest.fixture
def port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as far:
        far.bind(("127.0.0.1", 0))
        yield far.getsockname()[1]


@pytest.mark.skipif(sys.platform != "linux", reason="names that go with a process are Linux's")
def test_a_robot_is_talked_to_by_one_runtime_of_a_computer(port):
    with contextlib.closing(UdpLink(f"udp://127.0.0.1:{port}")):
        with pytest.raises(RuntimeFault, match=rf"--link udp://localhost:{port}: another runtime of this computer"):
            UdpLink(f"udp://localhost:{port}")
        script = f"from hts_go1_runtime.udp import UdpLink; UdpLink('udp://127.0.0.1:{port}')"
        other = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
        assert "RuntimeFault" in other.stderr and "told two things" in other.stderr
    with contextlib.closing(UdpLink(f"udp://127.0.0.1:{port}")):
        pass
