"""Numbers that stand for readings that were not there."""

from __future__ import annotations

import numpy as np
import pytest

from hts.channels import Channel
from hts.errors import RecordingError
from hts.recordings import Series
from hts.recordings.logs import check_no_reading, recording_from_columns

SAMPLES = 800
BULK = 4.4 + 0.2 * np.random.default_rng(0).standard_normal(SAMPLES)


def looked_at(values, **options):
    check_no_reading({"draw": Series(Channel("draw", "A"), values)}, ["draw"], "01.csv", **options)


def with_(number, where):
    values = BULK.copy()
    values[where] = number
    return values


@pytest.mark.parametrize(
    ("number", "where", "count"),
    [
        (0.0, slice(None, None, 3), 267),  # every third reading was missed
        (0.0, slice(5, None, 60), 14),
        (-1.0, slice(100, 140), 40),
        (9999.0, slice(100, 109), 9),
        (65535.0, slice(7, 8), 1),
        (-32768.0, slice(7, None, 50), 16),
    ],
)
def test_a_number_that_stands_for_no_reading_is_refused(number, where, count):
    with pytest.raises(RecordingError, match=rf"^01.csv: 'draw' is {number:g} A in {count} of 800 samples, between ot"):
        looked_at(with_(number, where))
    looked_at(with_(number, where), stated={"draw"})


def test_what_resampling_leaves_of_a_zero_is_called_zero():
    with pytest.raises(RecordingError, match="'draw' is 0 A in 267 of 800 samples"):
        looked_at(with_(4e-13, slice(None, None, 3)))


def test_a_number_of_the_other_sign_that_stays_for_several_readings_of_a_slow_gauge_is_refused():
    slow = np.repeat(BULK[::10], 10)
    slow[400:410] = slow[390:400]  # two readings that are alike
    slow[100:140] = -1.0
    with pytest.raises(RecordingError, match="'draw' is -1 A in 40 of 800 samples"):
        looked_at(slow)


def test_what_machines_do_is_taken():
    looked_at(BULK)
    times = np.arange(SAMPLES) / 50
    looked_at(np.maximum(0.0, 4.0 + 6.0 * np.sin(2 * np.pi * times)))  # gives power back, seen by a gauge that cannot
    looked_at(with_(0.0, slice(300, 303)))  # once, for a moment
    braking = BULK.copy()
    for begin in (200, 400, 600):
        braking[begin : begin + 20] -= 7.0 * np.sin(np.linspace(0, np.pi, 20))
    looked_at(braking)
    slow = np.repeat(BULK[::10], 10)
    slow[200:210], slow[500:510] = -1.3, -1.3  # a gauge of 5 Hz saw the same twice
    looked_at(slow)
    looked_at(np.where(times % 4 < 0.3, 20.0, 1.3))  # a tool that works now and then
    looked_at(np.zeros(SAMPLES))


def test_logs_are_looked_at_so(tmp_path, two_joints, mapping):
    columns = {"t": 20 * np.arange(SAMPLES), "amps": -1000 * with_(0.0, slice(None, None, 3))}
    mapping["channels"] = {"draw": {"columns": "amps", "unit": "A", "sign": -1, "scale": 0.001, "idle": 1.5}}
    with pytest.raises(RecordingError, match=r"log: 'draw' is 0 A in 267 of 800 samples, between others of 4\.\d* to"):
        recording_from_columns([tmp_path / "log"], mapping, two_joints, lambda path: columns)
