"""Packets of the loopback link."""

from __future__ import annotations

import dataclasses
import socket
import time

import numpy as np
import pytest

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.fake import standing
from hts_go1_runtime.packet import COMMAND, LARGEST, SIZE, STATE, numbers_of_state, pack, state_of, unpack
from hts_go1_runtime.udp import UdpLink


def packet(sequence: int = 5) -> bytes:
    return pack(STATE, sequence, 1.25, numbers_of_state(standing(sequence, 1.25)))


def test_a_state_comes_out_as_it_went_in():
    kind, sequence, stamp, numbers = unpack(packet())
    found, sent = state_of(sequence, stamp, 2.0, numbers), standing(5, 1.25)
    assert (kind, found.sequence, found.stamp, found.received) == (STATE, 5, 1.25, 2.0)
    for field in dataclasses.fields(sent)[3:]:
        np.testing.assert_allclose(getattr(found, field.name), getattr(sent, field.name), rtol=1e-6)


def test_every_flipped_byte_is_seen():
    good = packet()
    for place in range(len(good)):
        bad = bytearray(good)
        bad[place] ^= 0x10
        assert unpack(bytes(bad)) is None


@pytest.mark.parametrize("data", [b"", b"HTSR", packet()[:-1], packet() + b"x", b"x" * SIZE[COMMAND]])
def test_what_is_no_packet_is_nothing(data):
    assert unpack(data) is None


BAD = ("tcp://127.0.0.1:1", "udp://127.0.0.1", "127.0.0.1:9870", "udp://:9870", "udp://127.0.0.1:99999", "udp://h:abc")
NO_HOST = ("udp://[::1:9870", "udp://127.0.0.1:-1", "udp://127.0.0.1:0", "udp://a..b:9870")


@pytest.mark.parametrize("url", [*BAD, *NO_HOST])
def test_an_address_that_is_none_is_named(url):
    with pytest.raises(RuntimeFault, match=r"expected udp://HOST:PORT"):
        UdpLink(url)


def test_a_state_that_was_overtaken_is_dropped_and_counted():
    far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    far.bind(("127.0.0.1", 0))
    link = UdpLink(f"udp://127.0.0.1:{far.getsockname()[1]}")
    _, partner = far.recvfrom(LARGEST)
    damaged = packet(9)[:-1] + b"\x00"
    for data in (packet(3), packet(7), packet(6), damaged, packet(8)):
        far.sendto(data, partner)
    seen, end = [], time.monotonic() + 5
    while len(seen) < 3 and time.monotonic() < end:
        seen += [state.sequence for state in link.wait(link.now() + 0.02)]
    assert seen == [3, 7, 8]
    assert (link.counts.received, link.counts.lost, link.counts.late, link.counts.broken) == (
        3,
        2,
        1,
        1,
    )  # 4 and 5 never came
    far.close()
    link.close()


def test_gravity_and_heading_are_those_of_the_quaternion():
    half = np.deg2rad(30) / 2
    yawed = dataclasses.replace(standing(0, 0.0), quaternion=np.array([np.cos(half), 0, 0, np.sin(half)]))
    assert yawed.heading == pytest.approx(np.deg2rad(30))
    assert yawed.gravity == pytest.approx([0, 0, -1])
    pitched = dataclasses.replace(standing(0, 0.0), quaternion=np.array([np.cos(half), 0, np.sin(half), 0]))
    assert pitched.gravity == pytest.approx([0.5, 0, -np.sqrt(3) / 2])  # nose down: gravity pulls forward


def test_a_stand_ins_quaternion_shows_the_gravity_it_was_made_of():
    from hts_go1_stand_in.body import quaternion_of

    rng = np.random.default_rng(0)
    for _ in range(20):
        gravity = np.array([0.0, 0.0, -1.0]) + 0.4 * rng.standard_normal(3)
        gravity /= np.linalg.norm(gravity)
        heading = rng.uniform(-3, 3)
        found = dataclasses.replace(standing(0, 0.0), quaternion=quaternion_of(gravity, heading))
        assert found.gravity == pytest.approx(gravity)
        assert found.heading == pytest.approx(heading)
