"""Saving over the robot's time: what each method has after so many real samples, over all its runs.

A run's curve is a staircase: nothing saved before its first iteration ends, then the best so far until the next one
does, and what it had at its end from there on. Medians over runs are taken at equal numbers of samples, not at equal
iterations, which take longer with one method than with another.

How a step's height was measured: like the final, where runs did that after each iteration
(`evaluation.each_iteration`); else as the best was when it was tried, which flatters, because it was chosen for that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import mean

import numpy as np

from batch.groups import Group
from batch.lines import Point, Result
from batch.tables import NONE, shown, table
from hts.errors import EvaluationError
from hts.evaluation.population import Values, population, quantile

BUDGETS = (24_000, 48_000, 72_000, 96_000, 144_000, 192_000, 288_000, 384_000)
"""Real samples at which the table reads the staircases; 3,000 are a minute at 50 Hz."""


@dataclass(frozen=True)
class Staircase:
    """One run: `heights[i]` from `samples[i]` real samples on; finally: whether heights are measured like the final."""

    samples: tuple[int, ...]
    heights: tuple[float, ...]
    finally_measured: bool

    def at(self, samples: float) -> float:
        """What it had saved after so many real samples."""
        passed = [height for spent, height in zip(self.samples, self.heights, strict=True) if spent <= samples]
        return passed[-1] if passed else 0.0


def staircase(result: Result, objective: str) -> Staircase:
    """Of a run. Raises EvaluationError for one whose iterations are not all measured in one way."""
    ways = {point.final is not None for point in result.curve}
    if len(ways) > 1:
        raise EvaluationError("A run's iterations are measured in two ways: its line was put together by hand.")
    like_final = ways == {True}
    heights = tuple(_height(point, objective, result.asked_speeds if like_final else None) for point in result.curve)
    return Staircase(tuple(point.samples for point in result.curve), heights, like_final)


def staircases(group: Group) -> dict[str, list[Staircase]]:
    """reality -> its runs'. Raises EvaluationError where some runs are measured like the final and some are not."""
    found = group.by_reality(lambda result: [staircase(result, group.objective)] if result.curve else [])
    ways = {one.finally_measured for each in found.values() for one in each}
    if len(ways) > 1:
        raise EvaluationError(
            f"Method '{group.name}': some runs measured the best so far like the final and some did not, and one "
            "flatters. Run all with evaluation.each_iteration=true, or give only lines of one kind."
        )
    return found


def saved_at(found: dict[str, list[Staircase]], samples: float) -> Values:
    """reality -> what each of its runs had saved after so many real samples."""
    return {reality: [one.at(samples) for one in runs] for reality, runs in found.items()}


def median_curve(found: dict[str, list[Staircase]]) -> tuple[np.ndarray, np.ndarray]:
    """Every number of samples at which some run climbs, (S,), and the median over realities there, (S,)."""
    steps = sorted({spent for runs in found.values() for one in runs for spent in one.samples})
    heights = [population(saved_at(found, spent), quantile(0.5)).estimate for spent in steps]
    return np.array([0, *steps], dtype=float), np.array([0.0, *heights])


def curve(groups: Sequence[Group]) -> str:
    """Median over realities of what is saved after so many real samples, with how many runs have ended by then."""
    head = ["method", "measured", *(f"{budget:,}" for budget in BUDGETS), "samples at the last iteration, median"]
    rows = []
    for group in groups:
        found = staircases(group)
        if not found:
            continue
        show, last = shown(group.unit), [one.samples[-1] for runs in found.values() for one in runs]
        like_final = next(iter(found.values()))[0].finally_measured
        cells = []
        for budget in BUDGETS:
            begun = any(one.samples[0] <= budget for runs in found.values() for one in runs)
            cells.append(show(population(saved_at(found, budget), quantile(0.5)).estimate) if begun else NONE)
        how = "like the final" if like_final else "when it was tried"
        rows.append([group.name, how, *cells, f"{np.median(last):,.0f}"])
    return table(head, rows)


def _height(point: Point, objective: str, asked: Sequence[float] | None) -> float:
    """Mean over the speeds; asked: those of the final, None: those that it was tried at."""
    values = (point.improvement if asked is None else point.final or {}).get(objective, {})
    if asked is None:
        return mean(values.values()) if values else 0.0
    return mean(values.get(str(speed), 0.0) for speed in asked)
