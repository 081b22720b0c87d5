"""Recordings that no one model is for are told apart, with how many there are of each."""

import numpy as np
import pytest

from hts.channels import Channel
from hts.errors import RecordingError
from hts.measurement.alike import check_alike
from hts.recordings.recording import Series
from hts.testing.known_signals import known_heat

CHANNELS = ("effort", "rate", "heat")


def in_unit(recording, unit):
    heat = Series(Channel("heat", unit), recording.values("heat"))
    return recording.replace(channels={**recording.channels, "heat": heat}, id=recording.id)


def wider(recording):
    heat = Series(Channel("heat", "W", (2,)), np.ones((recording.num_samples, 2)))
    return recording.replace(channels={**recording.channels, "heat": heat})


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda r: r.replace(robot="other"), "robot: fake in 2 recordings .*other in 1 recording .*--robot"),
        (lambda r: r.replace(rate_hz=100.0), "rate in Hz: 50 in 2 .*100 in 1"),
        (lambda r: r.replace(joint_names=("x", "z", "y")), "joints: x, y, z in 2 .*x, z, y in 1"),
        (lambda r: in_unit(r, "mW"), "unit of 'heat': W in 2 .*mW in 1"),
        (wider, "shape of 'heat'"),
    ],
)
def test_what_differs_is_said_in_one_line(change, said):
    first = [known_heat(i, seconds=2.0, id=f"r{i}") for i in range(3)]
    check_alike(first, CHANNELS)
    with pytest.raises(RecordingError, match=said) as caught:
        check_alike([*first[:2], change(first[2])], CHANNELS)
    assert "\n" not in str(caught.value)


def test_one_unit_may_be_spelled_in_two_ways():
    first = known_heat(1, seconds=2.0)
    check_alike([first, in_unit(first, "J/s")], CHANNELS)
