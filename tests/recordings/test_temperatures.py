"""Temperatures that look as if they were in the other unit."""

from __future__ import annotations

import numpy as np
import pytest

from hts.channels import Channel
from hts.recordings import Series
from hts.recordings.doubts import doubts
from hts.recordings.logs import recording_from_columns, temperature_notes


def noted(median, said, unit="degC", **options):
    """median: what the log shows, in the unit `said`, stored in `unit`."""
    number = {("degF", "degC"): (median - 32) / 1.8}.get((said, unit), median)
    channels = {"warmth": Series(Channel("warmth", unit, (2,)), np.full((50, 2), number))}
    return temperature_notes(channels, {"warmth": said}, **options).get("temperature_unit", "")


@pytest.mark.parametrize("unit", ["degC", "degF"])
def test_degrees_celsius_that_are_called_fahrenheit_are_told(unit):
    assert "warmth is 41 degF (5 degC) at the median, colder than a room" in noted(41.0, "degF", unit)


def test_degrees_fahrenheit_that_are_called_celsius_are_told():
    assert "warmth is 104 degC at the median" in noted(104.0, "degC")
    assert "(then it is 40 degC; say unit: degF)" in noted(104.0, "degC")
    assert noted(104.0, "degC", stated={"warmth"}) == ""


@pytest.mark.parametrize(
    ("median", "said"), [(40.0, "degC"), (-5.0, "degC"), (104.0, "degF"), (104.0, "K"), (5.0, "A")]
)
def test_ordinary_ones_and_other_quantities_are_not(median, said):
    assert noted(median, said, said) == ""


def test_an_import_tells_of_it(tmp_path, two_joints, mapping):
    time = np.arange(100) / 50
    mapping["channels"] = {"warmth": {"columns": "T", "unit": "degC", "idle": 77.0, "may_be_constant": True}}
    columns = {"t": 1000 * time, "T": 95.0 + time}
    recording = recording_from_columns([tmp_path / "log"], mapping, two_joints, lambda path: columns)
    assert any("temperature_unit of log: warmth is 96 degC" in line for line in doubts([recording]))
