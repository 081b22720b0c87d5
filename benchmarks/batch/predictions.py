"""What was promised and what came: ranks, calibration, where a model fails, and whether its own doubt knew.

Two things are predicted in a run, and both are here. *Improvements*: of each candidate that was tried, by its model in
simulation, before anybody had measured it (`Tried.predicted`); it errs where the model does, and where simulated walks
differ from real ones. *Levels*: what the same model makes of the log of that candidate's test (`Model.pairs`,
`Model.doubts`); there the walk is the real one, and what is left is the model's own error, which its standard
deviation claims to know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import mean, median

import numpy as np

from batch.groups import Group
from batch.lines import Result, Tried
from batch.tables import NONE, differences, number, ratio, shown, table, with_interval
from hts.evaluation.population import population, quantile
from hts.measurement.scoring import spearman

KEPT = 0.5
"""A reality on which less of the promises came than this share is one on which the model fails (the trust region would
shrink its bounds there)."""


LEVEL = "\\* Over recordings at all speeds, as a share of what was measured at the slowest."
"""Below tables of the level: a line keeps errors over all recordings of a policy, and levels at one speed."""


@dataclass(frozen=True)
class Doubted:
    """A policy's mean level: by how much the model was off and how far off it said it might be, over recordings at all
    speeds, both as a share of the level that was measured at the slowest."""

    error: float
    spread: float


def prediction(groups: Sequence[Group]) -> str:
    """What was predicted of the candidates that were tried, and what was measured."""
    rows = []
    for group in groups:
        found = [pair for one in group.tried for pair in predicted(one, group.objective)]
        ranks = [
            result.pooled_rank[group.objective] for _, result in group.results if group.objective in result.pooled_rank
        ]
        known = [rank for rank in ranks if rank is not None]
        fits = [
            model.held_out_r2
            for _, result in group.results
            for model in result.models
            if model.objective == group.objective and model.held_out_r2 is not None
        ]
        total = sum(one for one, _ in found)
        rows.append(
            [
                group.name,
                str(len(found)),
                number(sum(one for _, one in found) / total if total else None),
                number(_rank(group.tried, group.objective)),
                number(median(known) if known else None),
                number(min(known) if known else None),
                number(median(fits) if fits else None),
                number(min(fits) if fits else None),
            ]
        )
    head = ["method", "promises (a candidate at a speed)", "measured / predicted", "rank correlation at one speed, all"]
    head += ["rank of costs in a run, median", "lowest", "R² held out, median", "lowest"]
    return table(head, rows)


def predicted(one: Tried, objective: str) -> list[tuple[float, float]]:
    """(predicted, measured) improvement at each speed that has both."""
    return list(_by_speed(one, objective).values())


def _by_speed(one: Tried, objective: str) -> dict[str, tuple[float, float]]:
    told, found = (one.predicted or {}).get(objective, {}), one.measured.get(objective, {})
    return {speed: (told[speed], found[speed]) for speed in told if speed in found}


def improvements(group: Group) -> dict[str, list[tuple[float, float]]]:
    """reality -> (predicted, measured) improvement of each candidate tried there at each speed."""
    return group.by_reality(lambda result: [pair for one in result.tried for pair in predicted(one, group.objective)])


def doubts(group: Group) -> dict[str, list[Doubted]]:
    """reality -> each policy that was tried after a fit whose model has a standard deviation."""
    return group.by_reality(lambda result: _doubts(result, group.objective))


def calibration(groups: Sequence[Group]) -> str:
    """Each method over realities: how much of what was promised came, how far off single promises are, and ranks."""
    rows = []
    for group in groups:
        found = improvements(group)
        if not found:
            rows.append([group.name, *[NONE] * 8])
            continue
        kept = {name: [share] for name, each in found.items() if (share := _kept(each)) is not None}
        every = np.array([pair for each in found.values() for pair in each])
        errors = {name: [float(np.mean([got - said for said, got in each]))] for name, each in found.items()}
        show, signed = differences(group.unit, signed=False), differences(group.unit)
        tried = group.by_reality(lambda result: result.tried)
        ranks = [rank for each in tried.values() if (rank := _rank(each, group.objective)) is not None]
        rows.append(
            [
                group.name,
                str(len(found)),
                str(len(every)),
                ratio(population(kept, quantile(0.5))) if kept else NONE,
                f"{sum(share[0] < KEPT for share in kept.values())} of {len(kept)}",
                with_interval(population(errors), signed),
                show(float(np.sqrt(((every[:, 1] - every[:, 0]) ** 2).mean()))),
                number(median(ranks) if ranks else None),
                number(_rank([one for each in tried.values() for one in each], group.objective)),
            ]
        )
    head = ["method", "realities", "promises", "measured / promised: median over realities, 95 %"]
    head += [f"under {KEPT:g} of it on", "measured less promised: mean, 95 %", "RMS"]
    return table([*head, "rank correlation at one speed, in a reality: median", "over all"], rows)


def failures(groups: Sequence[Group]) -> str:
    """Reality by reality, the worst-kept promises first: what the model saw of it before and after."""
    rows = []
    for group in groups:
        found, known, tried = improvements(group), doubts(group), group.by_reality(lambda result: result.tried)
        shares = {name: _kept(each) for name, each in found.items()}
        for name in sorted(found, key=lambda one: np.inf if shares[one] is None else float(shares[one] or 0.0)):
            show, own = shown(group.unit), known.get(name, [])
            runs = group.on(name)
            off = float(np.sqrt(np.mean([one.error**2 for one in own]))) if own else None
            said = float(np.sqrt(np.mean([one.spread**2 for one in own]))) if own else None
            rows.append(
                [
                    group.name,
                    name,
                    show(mean(told for told, _ in found[name])),
                    show(mean(got for _, got in found[name])),
                    number(shares[name]),
                    number(_rank(tried[name], group.objective)),
                    number(_lowest(runs, group.objective, "held_out_r2")),
                    number(_lowest(runs, group.objective, "elites_r2")),
                    _percent(off),
                    _percent(said),
                    number(off / said if off is not None and said else None),
                ]
            )
    head = [
        "method",
        "reality",
        "promised, mean",
        "measured, mean",
        "measured / promised",
        "rank correlation at one speed",
    ]
    head += ["R² held out, lowest", "R² of the elites, lowest", "error of the level, RMS*", "its doubt, RMS*"]
    return f"{table([*head, 'error / doubt'], rows)}\n\n{LEVEL}"


def doubt(groups: Sequence[Group]) -> str:
    """Whether the model knew where it was wrong: shares of policies within one and two of its standard deviations (of a
    Gaussian 0.68, 0.95), the factor it would need, and whether larger doubts came with larger errors."""
    rows = []
    for group in groups:
        found = doubts(group)
        every = [one for each in found.values() for one in each]
        if not every:
            rows.append([group.name, *[NONE] * 8])
            continue
        errors, spreads = np.array([abs(one.error) for one in every]), np.array([one.spread for one in every])
        within = {
            times: population(
                {
                    name: [float(np.mean([abs(o.error) <= times * o.spread for o in each]))]
                    for name, each in found.items()
                }
            )
            for times in (1, 2)
        }
        low, high = np.quantile(spreads, [1 / 3, 2 / 3])
        rows.append(
            [
                group.name,
                str(len(found)),
                str(len(every)),
                ratio(within[1]),
                ratio(within[2]),
                number(float(np.sqrt((errors**2).mean() / (spreads**2).mean()))),
                number(spearman(spreads.tolist(), errors.tolist())),
                _percent(float(errors[spreads <= low].mean())),
                _percent(float(errors[spreads >= high].mean())),
            ]
        )
    head = ["method", "realities", "policies", "within 1, 95 %", "within 2, 95 %", "error / doubt, RMS"]
    head += ["rank correlation of doubt and error", "error where doubt is smallest (a third)*", "where it is largest*"]
    return f"{table(head, rows)}\n\n{LEVEL}"


def _doubts(result: Result, objective: str) -> list[Doubted]:
    found = []
    for model in result.models:
        levels = {pair.policy: pair.measured for pair in model.pairs}
        level = mean(abs(value) for value in levels.values()) if levels else 0.0
        if model.objective == objective and level > 0:
            found += [Doubted(one.error / level, one.spread / level) for one in model.doubts]
    return found


def _kept(pairs: Sequence[tuple[float, float]]) -> float | None:
    """Sum of what came over the sum of what was promised; None where nothing was."""
    promised = sum(told for told, _ in pairs)
    return sum(got for _, got in pairs) / promised if promised > 0 else None


def _rank(tried: Sequence[Tried], objective: str) -> float | None:
    """Whether who was promised more saved more: at each speed by itself, mean over the speeds. How the speeds compare
    among themselves is no part of it, since nobody has to choose between them. None where no speed has two."""
    at: dict[str, list[tuple[float, float]]] = {}
    for one in tried:
        for speed, pair in _by_speed(one, objective).items():
            at.setdefault(speed, []).append(pair)
    ranks = [spearman(*zip(*pairs, strict=True)) for pairs in at.values() if len(pairs) > 1]
    known = [rank for rank in ranks if rank is not None]
    return mean(known) if known else None


def _lowest(runs: Sequence[Result], objective: str, name: str) -> float | None:
    found = [
        value
        for result in runs
        for model in result.models
        if model.objective == objective and (value := getattr(model, name)) is not None
    ]
    return min(found) if found else None


def _percent(value: float | None) -> str:
    return NONE if value is None else f"{100 * value:.1f} %".replace("-", "−")
