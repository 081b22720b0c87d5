"""What a run asks of its world, as a range: how often, and for how long the robot walks.

At least: somebody is good enough for a final, nobody is refused, and every command is found at the first try. At most:
everything is done again that the settings allow. Whoever stands beside a machine plans by both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from hts.checked_selector import checked_selector
from hts.config import RunConfig
from hts.contracts import HoldSpeed, Requests, Rounds, World
from hts.evaluation.held import ask_to_hold, hold_of
from hts.evaluation.walked_again import LONGEST
from hts.parts import robot_of
from hts.plugins import Registry
from hts.run.budget import Budget, second_trials, seconds_per_elite

Seconds = Callable[[HoldSpeed | None], float]
"""Robot time of something, s, while the world holds the speed so."""


@dataclass(frozen=True)
class Asked:
    """requests: for recordings; before, after: robot time before the final, and of the final with what is measured like
    it, s, at least and at most; raced: trials go in rounds, of which the least is one."""

    requests: Requests
    before: tuple[float, float]
    after: tuple[float, float]
    raced: bool

    @property
    def seconds(self) -> tuple[float, float]:
        """Of robot time in all."""
        return self.before[0] + self.after[0], self.before[1] + self.after[1]


def asked_of(config: RunConfig, registry: Registry, world: World, budget: Budget) -> Asked:
    """What a run with this budget asks of its world, which holds the speed as it did before when this returns. Raises
    ConfigError if the world cannot hold the speed as it is to."""
    hold, rounds = hold_of(config), _rounds(config, registry, world)
    elites = sum(budget.elites)
    planned, confirmed = _confirmed(config, budget)
    recordings = config.collection.repeats + config.collection.exploring if config.records_first else 0

    def trial(hold: HoldSpeed | None) -> float:
        ask_to_hold(world, hold)
        return seconds_per_elite(config, world)

    def final(hold: HoldSpeed | None) -> float:
        ask_to_hold(world, hold)
        return world.head_to_head_seconds() * len(config.evaluation.speeds) * _sessions(config, world)

    more: dict[str, int] = {}
    trials = elites * trial(hold)
    least = most = budget.schedule.seconds * recordings
    if rounds is not None:
        more[f"for the rounds of selector '{config.selection.selector.name}'"] = sum(
            (rounds.most - 1) for racing in budget.elites if racing > 1
        )
        trials = sum(_round(config, world, racing, rounds, hold) for racing in budget.elites)
    least += trials + planned * trial(hold)
    most += trials + confirmed * trial(hold)
    if rounds is not None:
        most += (rounds.most - 1) * sum(_round(config, world, one, rounds, hold) for one in budget.elites if one > 1)
    if confirmed and not planned:
        more["for second trials, if the cap leaves room for them (selection.confirm)"] = 1
    if hold is not None:
        whole, times = confirmed + (elites if rounds is None else 0), config.selection.trims_again
        more["for trials that did not find their commands (selection.trims_again)"] = whole * times
        most += whole * _again(trial, hold, times)
    if config.max_real_samples is not None:  # what is walked again has to fit, too
        rate = robot_of(config, registry).spec.control_rate_hz
        most = max(least, min(most, config.max_real_samples / rate))

    evaluation, both = config.evaluation, 1 if hold is None else 2
    times = 0 if hold is None else evaluation.trims_again
    held = final(hold)  # also what the best so far is measured by
    once = held if hold is None else held + final(None)
    again = 0.0 if hold is None else _again(final, hold, times)
    others = max(0, min(evaluation.finals, elites) - 1)
    measured = _measured(config, budget, confirmed)
    more["for a final that did not find its commands (evaluation.trims_again)"] = times
    more["for finals of the next best where one is given up (evaluation.finals)"] = others * (both + times)
    more["for the best so far after each iteration (evaluation.each_iteration)"] = measured * (1 + times)
    ask_to_hold(world, hold)
    comparisons = len(budget.elites) + (planned > 0) + both
    return Asked(
        Requests(comparisons + (recordings > 0), comparisons, {why: count for why, count in more.items() if count}),
        (least, most),
        (once, once + again + others * (once + again) + measured * (held + again)),
        rounds is not None,
    )


def _again(seconds: Seconds, hold: HoldSpeed, times: int) -> float:
    """Of what is walked again so often at every one of its speeds, trimmed longer each time as `walked_again` does."""
    longer = (min(2.0**number, LONGEST) * hold.seconds for number in range(1, times + 1))
    return sum(seconds(replace(hold, seconds=one)) for one in longer)


def _measured(config: RunConfig, budget: Budget, confirmed: int) -> int:
    """How many of the best so far are measured at most, beside who goes to the final: that one's logs are asked for
    twice, and the same question has the same answer."""
    if not config.evaluation.each_iteration:
        return 0
    return len(budget.elites) - (0 if confirmed else 1)


def _confirmed(config: RunConfig, budget: Budget) -> tuple[int, int]:
    """How many second trials are planned, and how many there are at most, for which a cap that plans none may leave
    room. One alone is not walked."""
    most = budget.confirm
    if config.max_real_samples is not None and sum(budget.elites) > 1:
        most = min(second_trials(config), sum(budget.elites))
    return budget.confirm if budget.confirm > 1 else 0, most if most > 1 else 0


def _rounds(config: RunConfig, registry: Registry, world: World) -> Rounds | None:
    """How trials are raced; None where they are whole: this selector, or this world, knows no rounds."""
    if type(world).head_to_head_round is World.head_to_head_round:
        return None
    return checked_selector(registry, config.selection.selector).rounds()


def _round(config: RunConfig, world: World, racing: int, rounds: Rounds, hold: HoldSpeed | None) -> float:
    """Robot time of a round of so many, s, who share its warming up and the reference's blocks; a little more than that
    where the speed is held, since a world does not say how long it trims the reference alone."""
    speeds = len(config.selection.tested_speeds)

    def alone(hold: HoldSpeed | None) -> float:
        ask_to_hold(world, hold)
        return world.head_to_head_session_seconds(speeds, rounds.block_seconds)

    shared = alone(None) - 2 * speeds * rounds.block_seconds
    return racing * alone(hold) - (racing - 1) * shared


def _sessions(config: RunConfig, world: World) -> int:
    """Of a final; one where the world makes a head-to-head once."""
    once = type(world).head_to_head_sessions is World.head_to_head_sessions
    return 1 if once else config.evaluation.sessions
