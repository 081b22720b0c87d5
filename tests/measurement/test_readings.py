"""Which samples of a log are new readings of a sensor."""

from __future__ import annotations

import numpy as np

from hts.measurement.readings import new_readings


def test_a_reading_that_is_shown_again_is_old() -> None:
    assert new_readings(np.array([1.0, 1.0, 2.0, 2.0, 2.0, 1.0])).tolist() == [False, False, True, False, False, True]


def test_all_samples_count_where_hardly_any_differ() -> None:
    assert new_readings(np.full(100, 3.0)).all()
    assert new_readings(np.repeat([3.0, 4.0], 200)).all()
