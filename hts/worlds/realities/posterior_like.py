"""What a lab's recordings say of its robot: the sampler's generations, and parameters after them against before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from hts.quantiles import weighted_quantiles
from hts.worlds.realities import sampler
from hts.worlds.realities.folder import LINES, draws_of
from hts.worlds.realities.like import Likeness
from hts.worlds.realities.misfit import in_tolerances
from hts.worlds.realities.population import Generation, generations_of, kept_of
from hts.worlds.realities.posterior import Narrowed, table_of
from hts.worlds.realities.ranges import Drawn
from hts.worlds.realities.space import Space


def is_population(folder: Path) -> bool:
    """Whether the draws of a folder are held against recordings."""
    return (folder / LINES).is_file() and "like" in draws_of(folder).heading


def accepted(folder: Path) -> str:
    """What was kept and what it took: one line."""
    generations = generations_in(folder)
    simulated, moved = sampler.effort(particle for one in generations for particle in one.population)
    tries = sum(one.simulated for one in generations[0].population) if generations else 0
    kept = len(kept_of(folder))
    bound = generations[-1].bound if generations else None
    reached = "no distance yet" if bound is None else f"{bound:.2f} tolerances"
    share = moved / max(simulated - tries, 1)
    return (
        f"kept {kept} realities within {reached} of the recordings, after {len(generations)} generations and "
        f"{simulated} simulations; {share:.0%} of the moves accepted"
    )


def text(parameters: Sequence[Drawn], folder: Path, most: int = 12) -> str:
    """Tables in markdown: generations, figures, parameters, structures, and the realities that were kept."""
    generations, like = generations_in(folder), Likeness.model_validate(draws_of(folder).heading["like"])
    if not generations:
        return "The first generation is not whole yet."
    last = generations[-1]
    weights = sampler.copies(last.population)
    moved = narrowed(parameters, last, weights)
    rows = [accepted(folder), "", *_generations(generations), "", *_figures(like, generations[0], last)]
    rows += table_of(moved, most)
    space = Space(parameters)
    draws = {index: space.draw(last.population[index].point) for index in weights}
    rows += ["", "| structure | on, of all | on, of the kept |", "|---|---|---|"]
    for name in space.switches:
        share = sum(weight for index, weight in weights.items() if name in draws[index].switches)
        rows.append(f"| `{name}` | 50 % | {share:.0%} |")
    kept = kept_of(folder)
    if kept:
        rows += ["", "| reality | weight | tolerances away |", "|---|---|---|"]
        rows += [f"| {one['reality']} | {one['weight']:.3f} | {one['distance']:.2f} |" for one in kept]
    return "\n".join(rows)


def narrowed(parameters: Sequence[Drawn], last: Generation, weights: Mapping[int, float]) -> list[Narrowed]:
    """Those that are single numbers, the most moved first. z: how far the mean share of the range moved, in standard
    errors of as many independent draws as the weights are worth, 1 / Σ w²."""
    space, found = Space(parameters), []
    share = np.array(list(weights.values()))
    worth = 1 / np.square(share).sum()
    draws = [space.draw(last.population[index].point) for index in weights]
    points = np.array([last.population[index].point for index in weights])
    for one in parameters:
        if one.boolean or one.whole or one.counts:
            continue
        there = np.array([one.key in draw.values for draw in draws])
        if there.sum() < 2:
            continue
        own = share[there] / share[there].sum()
        values = np.array([float(draw.values[one.key]) for draw, on in zip(draws, there, strict=True) if on])
        mean = float(own @ points[there, space.at[one.key]])
        z = (mean - 0.5) * np.sqrt(12 * worth * share[there].sum())  # a uniform share has a variance of 1/12
        low, middle, high = map(float, weighted_quantiles(values, own, (0.25, 0.5, 0.75)))
        found.append(Narrowed(one.key, one.quartiles(), (low, middle, high), float(z)))
    return sorted(found, key=lambda one: -abs(one.z))


def _generations(generations: Sequence[Generation]) -> list[str]:
    rows = ["| generation | within | simulations | moves accepted | distance: best, median |", "|---|---|---|---|---|"]
    for one in generations:
        simulated, moved = sampler.effort(one.population)
        distances = [each.found.distance for each in one.population]
        within = "prior" if one.bound is None else f"{one.bound:.2f}"
        share = "" if one.bound is None else f"{moved / max(simulated, 1):.0%}"
        away = f"{min(distances):.2f}, {float(np.median(distances)):.2f}"
        rows.append(f"| {one.number} | {within} | {simulated} | {share} | {away} |")
    return rows


def _figures(like: Likeness, first: Generation, last: Generation) -> list[str]:
    """Each figure of the recordings, of the prior and of what was kept; and how many of the prior agree with it."""
    rows = ["| figure | recordings | tolerance | prior | agree | kept |", "|---|---|---|---|---|---|"]
    for one in like.figures:
        shown = [
            np.array([each.found.shown[one.name] for each in generation.population if one.name in each.found.shown])
            for generation in (first, last)
        ]
        if not all(len(values) for values in shown):
            continue
        before, after = (f"{values.mean():.4g} ± {values.std():.2g}" for values in shown)
        agree = np.mean([in_tolerances(one, value) <= 1 for value in shown[0]])
        width = (one.high - one.low) / 2
        rows.append(f"| {one.name}, {one.unit} | {one.value:.4g} | ± {width:.2g} | {before} | {agree:.0%} | {after} |")
    everything = np.mean([each.found.distance <= 1 for each in first.population])
    rows.append(f"| all | | | | {everything:.0%} | |")
    fallen = sum(each.found.why.startswith("fell") for each in first.population)
    return [
        *rows,
        "",
        f"The prior is that of draws with these idle levels; {fallen} of its {len(first.population)} fell.",
    ]


def generations_in(folder: Path) -> list[Generation]:
    """Those of a folder that are whole. Raises RunError."""
    draws = draws_of(folder)
    return generations_of(draws.lines, draws.heading["size"])
