"""A selector: which candidates are tested, and which tested one goes on."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from hts.contracts.objective import Comparison


@dataclass(frozen=True)
class FineTuning:
    """How a candidate was made, and what became of its task.

    anchor: "best", "pretrained" or a candidate's id; weights: λ, one per objective; kl_bound: c in nats, inf without
    one; kl: mean KL(π ‖ anchor) of the finished policy, nats; task_reward: the task's own reward per second in
    simulation, by its mean action; pretrained_task_reward: the same of the pretrained policy. NaN: not known, as in
    runs of earlier versions.
    """

    anchor: str
    weights: Mapping[str, float]
    kl_bound: float
    kl: float
    task_reward: float = math.nan
    pretrained_task_reward: float = math.nan


@dataclass(frozen=True)
class SimulatedCandidate:
    """A candidate after fine-tuning, judged in simulation by its mean action.

    id: its name in this run; score: unweighted mean r_real, larger is better, summed over objectives; falls: worlds
    that fell; tracked: whether it keeps the speed, or does whatever else its task is; scores: the parts of `score`,
    objective -> mean r_real, in the order of the run's objectives; made: how; a run always says, made-up candidates may
    leave it out; predicted: objective -> the selection score that a head-to-head should find, mean over the speeds of
    the trial, in the objective's unit; without those that no model predicts; predicted_speeds: objective -> at how many
    of these speeds it is predicted: at one where a candidate does its task in no second nothing is, and means over
    other speeds are no equals. Made-up candidates may leave it out.
    """

    id: str
    score: float
    falls: int
    tracked: bool
    scores: Mapping[str, float] = field(default_factory=dict)
    made: FineTuning | None = None
    predicted: Mapping[str, float] = field(default_factory=dict)
    predicted_speeds: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class TestedCandidate:
    """An elite after its head-to-head.

    id: of the candidate; comparisons: objective -> what was measured against the reference; fell: whether it fell;
    made: how, None in made-up ones.
    """

    id: str
    comparisons: Mapping[str, Comparison]
    fell: bool
    made: FineTuning | None = None

    __test__ = False  # its name begins like a pytest class


@dataclass(frozen=True)
class Rounds:
    """How a selector wants tests in rounds.

    block_seconds: length of each block of a round, s; most: how many rounds at most.
    """

    block_seconds: float
    most: int


@dataclass(frozen=True)
class RacedCandidate:
    """An elite after the rounds so far.

    id: of the candidate; tested: all its rounds together, None if nothing could be reported; racing: whether it was in
    the last round; halves: two a round, in order, each one block of the policy against one of the reference, as one
    Comparison per objective (None if it could not be compared). Half n of one candidate was recorded beside half n of
    the others.
    """

    id: str
    tested: TestedCandidate | None
    racing: bool
    halves: Sequence[Mapping[str, Comparison] | None]


class Selector(ABC):
    """Which candidates are worth the robot's time, and which of the tested ones goes on."""

    def check(self, objectives: Sequence[str]) -> None:  # noqa: B027 - most settings name no objective
        """Asked before anything is spent: raise ConfigError if the settings name an objective that this run has not, or
        could choose nobody. By default nothing is checked.

        objectives: names of the run's, in order.
        """

    @abstractmethod
    def elites(self, candidates: Sequence[SimulatedCandidate], count: int) -> list[str]:
        """Ids of the candidates to test, best first."""

    @abstractmethod
    def best(self, tested: Sequence[TestedCandidate]) -> str | None:
        """Id of the anchor of the next iteration; None if nothing beats the reference."""

    def rounds(self) -> Rounds | None:
        """None, the default: every elite gets one whole head-to-head. Else they are tested in rounds, and `keep` is
        asked after each."""
        return None

    def keep(self, raced: Sequence[RacedCandidate]) -> list[str]:
        """Ids of those still racing that get another round; fewer than two end the test. By default nobody does.

        raced: every elite, also those that are out. It must be a function of `raced` alone: after a stop it is asked
        again from the first round.
        """
        return []
