"""Blocks of a head-to-head in which the target drifts: a person is told, once, that savings come out too small."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from hts.recordings.recording import Series
from hts.run import testing_elites
from hts.testing.known_signals import HEAT, KnownHeat, known_heat


def told(recordings):
    lines = []
    job = SimpleNamespace(objectives={"cool": KnownHeat()}, say_once=lambda about, line: lines.append(line))
    testing_elites._tell_drifts(job, recordings)
    return lines


def cooling(seed, kelvin):
    """A block that begins as warm as the one before it left the robot."""
    r = known_heat(seed)
    rise = (
        40.0 + kelvin * np.exp(-(r.time - r.time[0]) / 60.0) + np.random.default_rng(seed).normal(0, 0.05, len(r.time))
    )
    return r.replace(channels={**r.channels, "heat": Series(HEAT, rise)})


def test_it_is_said_of_a_temperature_and_not_of_a_loss():
    (line,) = told([cooling(1, 10.0), cooling(2, -10.0)])
    assert line.startswith("head-to-heads: while the command stays the same, ")
    assert "savings come out too small" in line and "\n" not in line
    assert told([known_heat(1), known_heat(2)]) == [] and told([]) == []
