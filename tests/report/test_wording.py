"""How numbers and names are written."""

from __future__ import annotations

import pytest

from hts.report import wording


@pytest.mark.parametrize(
    ("value", "unit", "shown"),
    [
        (0.182, "1", "18.2 %"),
        (-0.02, "1", "−2.0 %"),
        (-0.001, "dB", "0.00 dB"),
        (3.214, "dB", "3.21 dB"),
        (None, "1", "–"),
    ],
)
def test_quantities_are_written_in_their_unit(value, unit, shown):
    assert wording.quantity(value, unit) == shown


def test_durations_and_names_read_as_words():
    assert [wording.duration(s) for s in (12, 554.2, 7380)] == ["12 s", "9 min 14 s", "2 h 3 min"]
    assert wording.label("cost_of_transport_reduction") == "Cost of transport reduction"
    assert wording.weights({"a": 0.5}) == "0.5" and wording.weights({"a": 0.5, "b": 1.0}) == "0.5 a + 1 b"


def test_a_metric_that_is_the_improvement_itself_is_told_from_the_others():
    slow, fast = ({"improvement": one, "metrics": {"net": one, "gross": 0.2}} for one in (0.3, 0.2))
    assert wording.metric_names({"0.5": slow, "1.1": fast}) == (["gross"], ["net"])
    assert wording.metric_names({"0.5": {"improvement": 0.3}}) == ([], [])
