"""The sweep of Algorithm 1: anchors x weights λ x KL bounds c."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Candidate:
    """One way to fine-tune: id; anchor "best" or "pretrained"; weights: objective -> λ; kl_bound: c in nats."""

    id: str
    anchor: str
    weights: Mapping[str, float]
    kl_bound: float


def candidates(
    iteration: int, anchors: Mapping[str, str], weights: Mapping[str, Sequence[float]], bounds: Sequence[float]
) -> list[Candidate]:
    """All combinations, in the order anchors, weights, bounds.

    anchors: name -> hash of the policy behind it; two names of one policy are one anchor (in the first iteration
    best is pretrained), so that nothing is trained twice.
    """
    distinct: dict[str, str] = {}
    for name, policy_hash in anchors.items():
        if policy_hash not in distinct.values():
            distinct[name] = policy_hash
    combinations = [dict(zip(weights, values, strict=True)) for values in itertools.product(*weights.values())]
    grid = itertools.product(distinct, combinations, bounds)
    return [
        Candidate(id=f"{iteration:02d}-{index:02d}", anchor=anchor, weights=chosen, kl_bound=bound)
        for index, (anchor, chosen, bound) in enumerate(grid)
    ]
