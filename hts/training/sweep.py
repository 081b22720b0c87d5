"""The sweep of Algorithm 1: anchors x weights λ x KL bounds c."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from hts.config import RunConfig
from hts.config_base import percent
from hts.contracts import Objective
from hts.errors import ConfigError

Weights = Mapping[str, float]
FRONT = "front"
"""Name of the anchor that each combination of weights chooses for itself."""


@dataclass(frozen=True)
class Candidate:
    """One way to fine-tune.

    id: its name in the run; anchor: "best", "pretrained" or a policy's id; weights: objective -> λ; kl_bound: c, nats.
    """

    id: str
    anchor: str
    weights: Weights
    kl_bound: float


def iteration_of(candidate: str) -> int:
    """The iteration that a candidate was trained in: "01-03" -> 1."""
    return int(candidate.split("-")[0])


def nearer_id(candidate: str, share: float) -> str:
    """The id of a candidate at a share of the way from its anchor: 01-03 at a half is 01-03-w50."""
    return f"{candidate}-w{percent(share)}"


def is_nearer(name: str) -> bool:
    """Whether a policy's id is one of these."""
    return re.search(r"-w\d+$", name) is not None


def own_weights(objectives: Mapping[str, Objective], config: RunConfig) -> dict[str, tuple[float, ...]]:
    """Each objective's own λ: for what pays in such a run, its measurement model or its analytic proxy, and then for
    the baseline or for the method itself."""
    return {name: _own(one, config) for name, one in objectives.items()}


def _own(objective: Objective, config: RunConfig) -> tuple[float, ...]:
    if config.reward_source != "proxy":
        return objective.weights
    return (config.records_first and objective.proxy_weights) or objective.baseline_weights


def weights_of(objectives: Mapping[str, Objective], config: RunConfig) -> list[dict[str, float]]:
    """The λ of a run's candidates, as `combinations` gives them, with each objective's own. Raises ConfigError."""
    return combinations(own_weights(objectives, config), config.sweep.weights)


def combinations(own: Mapping[str, Sequence[float]], given: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
    """The λ of each candidate, one per objective, in the order of the objectives. Raises ConfigError if none is left.

    own: each objective's own λ; given: those that the configuration names instead. Never all zero: such a candidate
    would be trained for nothing that was measured.

    One objective: its λ in turn. Several, none of them given: each one alone at each of its λ, as in a run of its own;
    then any two together, any three, at the same level of each (lowest with lowest, highest with highest). Several,
    some given: all combinations of what is given, and of 0 and its own λ for an objective that is not.
    """
    if len(own) == 1 or any(given.get(name) for name in own):
        lists = {name: given.get(name) or ((0.0, *values) if len(own) > 1 else values) for name, values in own.items()}
        found = [dict(zip(lists, values, strict=True)) for values in itertools.product(*lists.values())]
    else:
        found = _levels({name: sorted(values) for name, values in own.items() if values}, list(own))
    chosen = [one for index, one in enumerate(found) if any(one.values()) and one not in found[:index]]
    if found and not chosen:
        raise ConfigError(
            f"sweep.weights: every combination of λ for {', '.join(own)} is zero, so nothing measured would be "
            "learned from. Give one of them a value above 0."
        )
    return chosen


def _levels(lists: Mapping[str, Sequence[float]], names: Sequence[str]) -> list[dict[str, float]]:
    """Every set of objectives, small sets first, at every level; the others at 0.
    Shorter lists are spread over levels."""
    count = max((len(values) for values in lists.values()), default=0)

    def at(values: Sequence[float], level: int) -> float:
        return values[round(level * (len(values) - 1) / (count - 1)) if count > 1 else 0]

    return [
        {name: float(at(lists[name], level)) if name in members else 0.0 for name in names}
        for size in range(1, len(lists) + 1)
        for members in itertools.combinations(lists, size)
        for level in range(count)
    ]


def candidates(
    iteration: int,
    anchors: Mapping[str, str],
    weights: Sequence[Weights],
    bounds: Sequence[float],
    front: Callable[[Weights], tuple[str, str]] | None = None,
) -> list[Candidate]:
    """All of them, in the order anchors, weights, bounds; nothing is trained twice.

    anchors: name -> hash of the policy behind it; two names of one policy are one anchor (in the first iteration
    best is pretrained). front: what the anchor of that name is for given weights: (name, hash).
    """
    made: list[Candidate] = []
    known: list[tuple[str, Weights, float]] = []
    for (anchor, behind), chosen, bound in itertools.product(anchors.items(), weights, bounds):
        name, policy_hash = front(chosen) if anchor == FRONT and front is not None else (anchor, behind)
        if (policy_hash, chosen, bound) not in known:
            known.append((policy_hash, chosen, bound))
            made.append(Candidate(f"{iteration:02d}-{len(made):02d}", name, chosen, bound))
    return made
