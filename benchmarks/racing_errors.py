"""How often a race drops the best of equals, in tables of random numbers: what `racing` states as its error."""

from __future__ import annotations

from typing import Any

import numpy as np

from hts.selection.anytime import still_racing as by_sequences
from hts.selection.racing import Racing, RacingSettings, of_rounds, still_racing

SESSIONS = (0.0, 0.5, 1.0, 2.0, 4.0)
"""Standard deviations of what a session has of its own for one candidate, in those of a half."""


def tables(trials: int) -> dict[str, Any]:
    """Races of equal candidates in tables of random numbers, which is quick: how often candidate 0 is dropped.

    Halves scatter by 1 and share something that scatters by 3. `corrected` is what `racing` does with its default
    `unit`; `uncorrected` tests at its whole error after each round. `session of its own` is what both halves of a round
    have in common for one candidate, in standard deviations of a half.
    """
    result: dict[str, Any] = {}
    for candidates in (2, 3, 6):
        result[f"{candidates} equal"] = {
            "corrected": dropped(trials, candidates),
            "corrected, heavy tails (t, 3)": dropped(trials, candidates, degrees=3),
            "uncorrected": dropped(trials, candidates, level=RacingSettings().error),
            **{
                f"{test}, session of its own": {
                    unit: {own: dropped(trials, candidates, own=own, test=test, unit=unit) for own in SESSIONS}
                    for unit in ("half", "round")
                }
                for test in ("looks", "anytime")
            },
            "looks, session of its own for one alone": {
                own: dropped(trials, candidates, own=own, alone=True) for own in SESSIONS
            },
        }
    return result


def dropped(
    trials: int,
    candidates: int,
    *,
    level: float | None = None,
    degrees: int | None = None,
    own: float = 0.0,
    alone: bool = False,
    test: str = "looks",
    unit: str = "round",
) -> float:
    """Share of races in which candidate 0 of equals is dropped, of four rounds, of ten with `anytime`.

    level: of one comparison, None: as `racing` has it. degrees: of the t distribution that halves come from; None:
    normal. own: standard deviation of a session's own for each candidate, alone: for candidate 0 only. test, unit: as
    in `racing`'s settings.
    """
    anytime = test == "anytime"
    rounds = 10 if anytime else 4
    racing = Racing(RacingSettings.model_validate({"unit": unit, "rounds": rounds, "test": test}))
    decide, far = (by_sequences, 100.0) if anytime else (still_racing, 0.0)  # above the reference, who is 0
    if level is None:
        level = racing.settings.error / candidates if anytime else racing.level(candidates)
    rng, without, shape = np.random.default_rng(0), 0, (candidates, 2 * rounds)
    seen = of_rounds if unit == "round" else np.asarray
    share = np.array([own if row == 0 or not alone else 0.0 for row in range(candidates)])[:, None]
    for _ in range(trials):
        scores = rng.standard_normal(shape) if degrees is None else rng.standard_t(degrees, shape)
        scores += far + 3.0 * rng.standard_normal(shape[1])
        if own:
            scores += np.repeat(share * rng.standard_normal((candidates, rounds)), 2, axis=1)
        left = list(range(candidates))
        for number in range(1, rounds):  # nothing is decided after the last
            left = decide(seen(scores[:, : 2 * number]), left, level, 0.0)
            if 0 not in left or len(left) < 2:
                break
            scores[[row for row in range(candidates) if row not in left], 2 * number :] = np.nan
        without += 0 not in left
    return without / trials
