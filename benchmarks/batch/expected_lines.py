"""Lines of what a run was expected to save on a reality, by twins fitted from its logs, and of what one saved there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydantic import Field

from batch.lines import Part, parsed
from batch.tables import NONE, differences, shown, table
from hts.atomic import atomic_write
from hts.errors import RunError
from hts.measurement.scoring import spearman

MEAN = "mean"  # over the speeds, beside them


class Speed(Part):
    """At one speed, or on average over them; savings as fractions, in the objective's unit."""

    predicted: float
    interval95: tuple[float, float] | None = Field(None, description="of one more run on one more such machine")
    measured: float | None = Field(None, description="of the run on the reality, mean over seeds; none: not made")
    error: float | None = Field(None, description="measured less predicted")
    inside: bool | None = None


class Expected(Part):
    """One reality."""

    version: int = 1
    reality: str
    reality_hash: str
    objective: str
    unit: str
    method: str
    preset: str
    commit: str = Field(description="of the runs on draws")
    within: float = Field(description="tolerances that every draw is within")
    draws: int = Field(description="that were run on")
    worth: float = Field(description="so many independent draws, by their weights")
    failed: int = Field(0, description="runs on draws that failed and are left out")
    refused: int = Field(0, description="speeds of runs on draws that were refused, counted as 0")
    measured_runs: int
    measured_commits: tuple[str, ...] = ()
    speeds: dict[str, Speed]
    error: str | None = Field(None, description="why there is no prediction")


def write_expected(path: Path, rows: Sequence[Expected]) -> None:
    """All of it, one JSON line each."""
    atomic_write(path, "".join(row.model_dump_json() + "\n" for row in rows))


def read_expected(path: Path) -> list[Expected]:
    """Lines that `write` wrote. Raises RunError."""
    if not path.is_file():
        raise RunError(f"{path}: there is no such file. `benchmarks/expected.py run` writes it.")
    return list(parsed([path], Expected, "version 1, as benchmarks/expected.py run writes it"))


def expected_table(rows: Sequence[Expected]) -> str:
    """In markdown, a row for each reality and speed; and below it what the errors are together."""
    head = ["reality", "speed", "predicted", "95 % interval", "measured", "error", "inside"]
    text = table(head, [line for row in rows for line in _rows(row)])
    pairs = [
        (row.speeds[MEAN].predicted, row.speeds[MEAN].measured)
        for row in rows
        if MEAN in row.speeds and row.speeds[MEAN].measured is not None
    ]
    if not pairs:
        return text
    told, came = np.array(pairs, dtype=float).T
    plain, signed = differences(rows[0].unit, signed=False), differences(rows[0].unit)
    errors = came - told
    said = f"{len(pairs)} realities: mean error {signed(errors.mean())}, mean size {plain(abs(errors).mean())}"
    if len(pairs) > 2:  # what one would say of each machine without its logs: what the others saved
        others = (came.sum() - came) / (len(came) - 1)
        rank = f"{spearman(told.tolist(), came.tolist()):.2f}".replace("-", "−")
        said += f" ({plain(abs(came - others).mean())} for the mean of the others' savings instead of a prediction)"
        said += f"; rank correlation of predicted and measured {rank}"
    return f"{text}\n\n{said}."


def _rows(row: Expected) -> list[list[str]]:
    if row.error:
        return [[row.reality, "", row.error, "", "", "", ""]]
    show, signed = shown(row.unit), differences(row.unit)
    return [
        [
            row.reality,
            speed,
            show(one.predicted),
            "none" if one.interval95 is None else f"{show(one.interval95[0])} to {show(one.interval95[1])}",
            NONE if one.measured is None else show(one.measured),
            NONE if one.error is None else signed(one.error),
            {True: "yes", False: "no", None: NONE}[one.inside],
        ]
        for speed, one in row.speeds.items()
    ]
