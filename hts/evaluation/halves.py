"""A head-to-head in halves: A-B-B-A is A-B and then B-A, each of them a comparison by itself.

Two numbers of one policy that were recorded apart tell how far such numbers scatter, whatever makes them scatter:
segments that are alike, a block that went differently, charge that ran down in between. That is what a race needs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from hts.config import EvaluationConfig
from hts.contracts import VELOCITY, Comparison, Objective, Task
from hts.errors import PluginError
from hts.evaluation.across_speeds import mean_comparison
from hts.evaluation.head_to_head import ROLES, TooFewSegments, by_speed, point

if TYPE_CHECKING:
    from hts.recordings.recording import Recording

Half = Mapping[str, Comparison]


def halves(
    objectives: Mapping[str, Objective],
    recordings: Sequence[Recording],
    config: EvaluationConfig,
    task: Task = VELOCITY,
) -> list[Half | None]:
    """One comparison per objective for each half of one round, in order of time.

    recordings: the round's blocks in any order, at each speed as many of the role "policy" as of "reference"; half n is
    the n-th of each, its numbers the means over the speeds. None for a half in which fewer than `config.min_valid` of
    either one's segments are valid at any speed. Raises EvaluationError as `head_to_head.compare` does otherwise, and
    PluginError for other numbers of blocks.
    """
    few, groups = config.model_copy(update={"min_segments": 1}), by_speed(recordings, task)
    _check_blocks(groups, task)
    speeds = [_at_one_speed(objectives, blocks, few, task) for blocks in groups.values()]
    return [_over_speeds(found) for found in zip(*speeds, strict=True)]


def _check_blocks(groups: Mapping[float, Sequence[Recording]], task: Task) -> None:
    """Raise PluginError unless policy and reference have as many blocks as each other, and as at any other speed."""
    counts = {
        speed: tuple(sum(recording.role == role for recording in blocks) for role in ROLES)
        for speed, blocks in groups.items()
    }
    if len({count for pair in counts.values() for count in pair}) > 1:
        found = ", ".join(f"{policy} and {reference}{task.at(speed)}" for speed, (policy, reference) in counts.items())
        raise PluginError(
            f"A round has so many blocks of the policy and of the reference: {found}. Expected as many of both, alike "
            "at every speed: the world must walk two of each (`World.head_to_head_round`)."
        )


def _at_one_speed(
    objectives: Mapping[str, Objective], recordings: Sequence[Recording], config: EvaluationConfig, task: Task
) -> list[Half | None]:
    ordered = sorted(recordings, key=lambda recording: recording.block)
    policy, reference = ([r for r in ordered if r.role == role] for role in ROLES)
    return [_half(objectives, pair, config, task) for pair in zip(policy, reference, strict=True)]


def _over_speeds(found: Sequence[Half | None]) -> Half | None:
    known = [half for half in found if half is not None]
    if len(known) < len(found):
        return None
    return {name: mean_comparison([half[name] for half in known]) for name in known[0]}


def _half(
    objectives: Mapping[str, Objective], pair: Sequence[Recording], config: EvaluationConfig, task: Task
) -> Half | None:
    try:
        return {name: point(objective, pair, config, task) for name, objective in objectives.items()}
    except TooFewSegments:
        return None
