"""The last word on the bound: a candidate leaves training inside it."""

from __future__ import annotations

import torch

from hts.rl.given import as_numbers
from hts.rl.kl import gaussian_kl
from hts.rl.population import Population
from hts.rl.rows import row_mean


@torch.no_grad()
def mean_kl(population: Population, reference: Population, observation: torch.Tensor) -> torch.Tensor:
    """Mean KL(pi || reference) [P] over observations [P, S, O]."""
    return row_mean(
        gaussian_kl(
            population.mean(observation), population.log_std(), reference.mean(observation), reference.log_std()
        )
    )


@torch.no_grad()
def project_to_kl_bound(
    population: Population,
    reference: Population,
    observation: torch.Tensor,
    bounds: float | torch.Tensor,
    steps: int = 12,
) -> torch.Tensor:
    """Shrink every candidate that ended beyond its bound towards its reference until it is inside; returns s [P].

    theta <- reference + s (theta - reference), the largest s in [0, 1] with KL <= c on these observations, by
    bisection. The multiplier holds the mean over batches; a single last batch may end a little beyond. Who has an
    infinite bound is left alone.

    observation: [P, S, O], S from 1 on; bounds: c, nats, [P], or a float that holds for each candidate.

    Raises ValueError, with the population as it was given, if the KL of a candidate with a finite bound is NaN or
    whoever has to be shrunk has weights that are not finite, for bounds that are not one above 0 for each, for
    a reference of other sizes, and for observations of another shape or none. TypeError for bounds that are no numbers.
    """
    size = population.sizes.observation
    told = [f"{one.count} candidates of {one.sizes}" for one in (reference, population)]
    if told[0] != told[1]:
        raise ValueError(
            f"reference is {told[0]}, population {told[1]}; expected the same of both, as population.frozen() before "
            "training gives it."
        )
    if observation.ndim != 3 or observation.shape[0] != population.count or observation.shape[-1] != size:
        raise ValueError(
            f"observation has the shape {tuple(observation.shape)}, expected ({population.count}, S, {size}), S states "
            "of each candidate: flatten(1, 2) makes that of a batch's [P, N, T, O]."
        )
    if observation.shape[1] == 0:
        raise ValueError(
            f"observation has the shape {tuple(observation.shape)}, no state is in it, so no KL can be measured; "
            "expected one of each candidate at least."
        )
    if not isinstance(bounds, torch.Tensor):
        bounds = as_numbers("bounds", bounds, "a number, or [P] for P candidates", population.device)
    if bounds.ndim == 0:
        bounds = bounds.repeat(population.count)
    if bounds.shape != (population.count,) or not bool((bounds > 0).all()):
        raise ValueError(
            f"bounds are {bounds.tolist()}; expected a positive number for each of {population.count} candidates, "
            "infinity for no bound."
        )
    ends = [vector.clone() for vector in population.vectors]
    scale = torch.ones_like(bounds)

    def place(scales: torch.Tensor) -> torch.Tensor:
        for vector, end, start, s in zip(population.vectors, ends, reference.vectors, scales.tolist(), strict=True):
            vector.copy_(start + s * (end - start) if s < 1.0 else end)
        population.refresh()
        return mean_kl(population, reference, observation)

    kl = place(scale)
    outside = kl > bounds
    broken = kl.isnan() & bounds.isfinite()
    broken |= outside & ~torch.stack([end.isfinite().all() for end in ends])
    if bool(broken.any()):
        raise ValueError(
            f"kl is {kl.tolist()}: candidates {torch.nonzero(broken).flatten().tolist()} cannot be held to their "
            "bounds, for their weights, their reference's or an observation is not finite. Leave them out."
        )
    if not bool(outside.any()):
        return scale
    low, high = torch.zeros_like(scale), torch.ones_like(scale)
    for _ in range(steps):
        middle = torch.where(outside, (low + high) / 2, 1.0)
        inside = place(middle) <= bounds
        low, high = torch.where(inside, middle, low), torch.where(inside, high, middle)
    scale = torch.where(outside, low, 1.0)
    place(scale)
    return scale
