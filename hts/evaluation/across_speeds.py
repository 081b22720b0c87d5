"""Several speeds as one comparison: the mean of each number over the speeds, every speed counting alike."""

from __future__ import annotations

from collections.abc import Sequence

from hts.contracts import Comparison


def mean_comparison(comparisons: Sequence[Comparison]) -> Comparison:
    """Mean improvement, selection score and metrics of one objective; metrics that not every speed has are left out."""
    first, count = comparisons[0], len(comparisons)
    if count == 1:
        return first
    shared = [name for name in first.metrics if all(name in one.metrics for one in comparisons)]
    return Comparison(
        improvement=sum(one.improvement for one in comparisons) / count,
        selection_score=sum(one.selection_score for one in comparisons) / count,
        metrics={name: sum(one.metrics[name] for one in comparisons) / count for name in shared},
    )
