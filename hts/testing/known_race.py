"""Rounds of head-to-heads in worlds with known answers, to test selectors that ask for rounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from hts.config import EvaluationConfig
from hts.contracts import TestedCandidate
from hts.evaluation.final import CandidateResult
from hts.evaluation.halves import halves
from hts.evaluation.head_to_head import TooFewSegments, point
from hts.recordings.recording import Recording
from hts.run.testing_elites import Tests, race
from hts.selection.racing import Racing, RacingSettings
from hts.testing.made_up_recordings import CostObjective, known_recording
from hts.worlds.base import round_order, shared_out


@dataclass(frozen=True)
class KnownRounds:
    """What walking costs, and how its measurement scatters.

    savings: of each candidate, as a fraction of the reference's cost; scatter, correlation: standard deviation of 1 s
    segments as a fraction, and of neighbours; block_scatter: the same of whole blocks (charge that was renewed, another
    floor); drift: from the first to the last second of a round, as a fraction of the reference's cost.
    """

    savings: Sequence[float]
    scatter: float = 0.007
    correlation: float = 0.3
    block_scatter: float = 0.0
    drift: float = 0.0

    @property
    def names(self) -> list[str]:
        return [f"candidate-{index}" for index in range(len(self.savings))]

    def round(
        self, racing: Sequence[int], number: int, block_seconds: float, rng: np.random.Generator
    ) -> list[list[Recording]]:
        """One session of those racing, as a world gives it. block_seconds: whole seconds."""
        seconds = round(block_seconds)
        order = round_order(len(racing), number)
        total = seconds * len(order)
        shocks = rng.standard_normal(total)
        shocks[1:] *= np.sqrt(1 - self.correlation**2)
        series = lfilter([1.0], [1.0, -self.correlation], shocks)
        wandering = self.scatter * series + self.drift * np.arange(total) / total
        blocks = []
        for block, who in enumerate(order):
            part = slice(block * seconds, (block + 1) * seconds)
            cost = 100.0 if who is None else 100.0 * (1 - self.savings[racing[who]])
            own = cost * (1 + wandering[part] + self.block_scatter * rng.standard_normal())
            blocks.append(
                known_recording(
                    own,
                    role="reference" if who is None else "policy",
                    block=block,
                    session=f"round-{number}",
                    start=float(part.start),
                    rate_hz=5.0,
                )
            )
        return shared_out(blocks, order, len(racing))


def run_race(world: KnownRounds, settings: RacingSettings, seed: int) -> Tests:
    """A whole race, by the code that a run uses."""
    objective, config, rng = CostObjective(), EvaluationConfig(), np.random.default_rng(seed)
    names = world.names

    def ask(racing: Sequence[str], number: int) -> list[list[Recording]]:
        return world.round([names.index(name) for name in racing], number, settings.block_seconds, rng)

    def judge(name: str, recordings: Sequence[Recording]) -> CandidateResult:
        try:
            comparison = point(objective, recordings, config)
        except TooFewSegments as error:
            return CandidateResult(None, None, str(error))
        fell = any(recording.fell for recording in recordings if recording.role == "policy")
        return CandidateResult({}, TestedCandidate(name, {objective.name: comparison}, fell), None)

    selector = Racing(settings)
    tests = race(
        names, selector, selector.rounds(), ask, judge, lambda row: halves({objective.name: objective}, row, config)
    )
    assert tests is not None  # this world knows rounds
    return tests
