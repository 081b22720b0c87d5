"""What each valid segment counts in a mean: every block the same, and every session the same.

A-B-B-A gives both policies the same mean time, and sessions of one machine are dear or cheap for both of them. That
holds of blocks and sessions, not of the seconds that are left of them: a policy that keeps more seconds in one block
than in the other has another mean time than its reference, and one that keeps fewer in dear sessions has cheap ones.
Were all seconds pooled, a drift would not cancel then, and a difference between sessions would count as one between
policies. So a mean is that of blocks within a session, and of sessions.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from hts.evaluation.segments import Segments, kept

Blocks = list[np.ndarray]
"""Rows of a table, one array for each block in the order of time."""


@dataclass(frozen=True)
class Balance:
    """Which segments of policy and reference make up the blocks and sessions of a comparison.

    sessions: names of those that hold valid segments of both, at least two, and then nothing else counts; empty: all
    blocks count, whatever session they are of. policy, reference: for each session (or once) the rows of each block.
    """

    sessions: tuple[str, ...]
    policy: tuple[Blocks, ...]
    reference: tuple[Blocks, ...]

    @classmethod
    def of(cls, policy: Segments, reference: Segments) -> Balance:
        """Of the valid segments of two policies, at least one of each."""
        named = [_blocks_by_session(one) for one in (policy, reference)]
        common = _common(*named)
        if common:
            return cls(common, *(tuple(found[name] for name in common) for found in named))
        return cls((), *(([block for blocks in found.values() for block in blocks],) for found in named))

    def means(self, policy: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means of both, each (Q,), of tables (S, Q) with a row for each of their segments."""
        one, other = self.session_means(policy, reference)
        return one.mean(axis=0), other.mean(axis=0)

    def session_means(self, policy: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same for each session, each (sessions, Q)."""
        return _means(self.policy, policy), _means(self.reference, reference)


def in_common(policy: Segments, reference: Segments) -> tuple[Segments, Segments]:
    """Both without the segments of sessions that hold valid ones of one of them alone, where at least two hold of both:
    nothing can be compared with them."""
    named = [[one.recordings[index].session for index in one.recording] for one in (policy, reference)]
    common = _common(*named)
    if not common:
        return policy, reference
    first, second = (kept(one, np.isin(names, common)) for one, names in zip((policy, reference), named, strict=True))
    return first, second


def mean_of_blocks(table: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Mean (Q,) of a table (S, Q) in which every block counts the same; block (S,): as in `Segments`."""
    return np.mean([table[block == number].mean(axis=0) for number in np.unique(block)], axis=0)


def _common(first: Iterable[str], second: Iterable[str]) -> tuple[str, ...]:
    """Sessions of both in the order of the first, each once; none of fewer than two, which nothing is compared over."""
    known = set(second)
    common = tuple(dict.fromkeys(name for name in first if name in known))
    return common if len(common) > 1 else ()


def _means(sessions: Sequence[Blocks], table: np.ndarray) -> np.ndarray:
    return np.array([np.mean([table[rows].mean(axis=0) for rows in blocks], axis=0) for blocks in sessions])


def _blocks_by_session(segments: Segments) -> dict[str, Blocks]:
    """Rows of each block, by session, in the order of the recordings."""
    found: dict[str, Blocks] = {}
    for number in np.unique(segments.block):
        rows = np.flatnonzero(segments.block == number)
        found.setdefault(segments.recordings[segments.recording[rows[0]]].session, []).append(rows)
    return found
