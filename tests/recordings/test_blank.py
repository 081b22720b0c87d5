"""Rows of zeros, written before the first message came or where one was lost, are no measurements."""

from __future__ import annotations

import numpy as np
import pytest
from two_joint_log import a_log, a_mapping, read

STEPS = np.arange(200)
HEADER = "t,H_q,K_q,H_dq,K_dq,H_tau,K_tau,amps"


def written(folder, values, blank=()):
    """A log of 50 Hz of these positions, velocities, torques and amperes, zeros in the `blank` rows."""
    values = values.copy()
    values[[*blank]] = 0
    return a_log(
        folder, [",".join([str(20 * i), *(f"{one:.6f}" for one in row)]) for i, row in enumerate(values)], HEADER
    )


def swinging():
    """About 0.9 rad."""
    sine, cosine = np.sin(STEPS / 5), np.cos(STEPS / 5)
    return np.stack([0.9 + 0.2 * sine, 0.9 + 0.2 * cosine, 2 * cosine, -2 * sine, sine, cosine, 2 + sine**2], axis=1)


@pytest.fixture
def mapping():
    units = {"position": ("q", "rad"), "velocity": ("dq", "rad/s"), "torque": ("tau", "N*m")}
    channels = {f"joint_{name}": {"columns": f"{{joint}}_{end}", "unit": unit} for name, (end, unit) in units.items()}
    return a_mapping(channels={**channels, "draw": {"columns": "amps", "unit": "A", "idle": 1.5}})


def test_zeros_before_the_first_message_and_of_a_lost_one_are_left_out(tmp_path, mapping):
    values = swinging()
    recording = read(written(tmp_path, values, blank=[*range(25), 100, 130, 131]), mapping)
    assert recording.notes["blank_rows_dropped"] == "28 in which all joints are 0"
    assert recording.notes["starts_after_first_stamp"] == "0.500000 s" and recording.num_samples == 175
    np.testing.assert_allclose(recording.values("draw"), values[25:, 6], atol=0.05)
    np.testing.assert_allclose(recording.values("joint_position"), values[25:, :2], atol=0.02)


def test_a_machine_that_gets_up_from_its_zeros_does_not_jump(tmp_path, mapping):
    """Its first 31 rows are zeros as well."""
    phase = np.clip(STEPS - 30, 0, None) / 30
    at, speed = 0.9 * (1 - np.cos(phase)), 0.9 / 30 * 50 * np.sin(phase)
    values = np.stack([at, at / 2, speed, speed / 2, at, at, 2 + at], axis=1)
    assert not values[:31, :6].any()
    assert "blank_rows_dropped" not in read(written(tmp_path, values), mapping).notes
