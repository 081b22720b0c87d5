"""Every table that is made of groups of lines, by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from batch import curve, predictions, tables
from batch.groups import Group

ALL: dict[str, Callable[[Sequence[Group]], str]] = {
    **tables.TABLES,
    "prediction": predictions.prediction,
    "calibration": predictions.calibration,
    "failures": predictions.failures,
    "doubt": predictions.doubt,
    "curve": curve.curve,
}
"""For `table --name`, and for blocks in pages."""
