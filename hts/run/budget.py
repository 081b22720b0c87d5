"""How a run keeps within its real samples: `max_real_samples`, planned before anything is spent.

Robot time goes into first data and into tests of elites. Where the configuration would take more than it may, first
data may shrink to half (LEAST_SHARE), recorded by the same schedule in shorter stretches. So many elites are tested as
then fit, spread over as many iterations as there are tests for, the earlier ones first, since every later fit learns
from them; first data get what is left. What a stage took in truth counts: before each iteration the plan is cut to what
is left, tests that the iterations before did not use (the gate may let nobody pass) are spread over those that are left
likewise, and where there is not one test, the iterations end. The final is measured apart and not counted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hts.checked_selector import checked_selector
from hts.config import RunConfig, ScheduleConfig
from hts.contracts import World
from hts.errors import ConfigError
from hts.parts import objectives_of, robot_of
from hts.plugins import Registry
from hts.training.sweep import candidates, weights_of

LEAST_SHARE = 0.5
"""Of the first data that are configured: with fewer there is nothing to trust in what a model promises."""
LEAST_SECONDS = 4.0
"""Of a command in a shortened schedule, s: two to settle, and as many to learn from."""
ALLOWANCE, LEAST_ALLOWANCE = 1.01, 1.0
"""On what a world says a test takes, a share and at least so many seconds: it does not count standing up, for
instance."""


@dataclass(frozen=True)
class Budget:
    """schedule: of each first recording; elites: tested in each iteration, which are as many as this is long;
    first, each: samples of all first data and of one elite; most: the cap, None without one; wanted: elites of every
    iteration, if there were no cap; confirm: tried again in the end, of which a cap leaves as many as then fit."""

    schedule: ScheduleConfig
    elites: tuple[int, ...]
    first: int
    each: int
    most: int | None
    wanted: tuple[int, ...]
    confirm: int = 0

    @property
    def samples(self) -> int:
        """Of the robot before the final, by estimate."""
        return self.first + self.each * (sum(self.elites) + self.confirm)

    def affordable(self, tried: Sequence[int], spent: int) -> int:
        """Elites that the next iteration may test when so many samples are spent. tried: by each one before it; what
        they left of the plan is planned again."""
        left = spread(sum(self.elites) - sum(tried), self.wanted[len(tried) :])
        planned = left[0] if left else 0
        return planned if self.most is None else max(0, min(planned, (self.most - spent) // self.each))


def candidate_counts(config: RunConfig, registry: Registry) -> list[int]:
    """How many candidates each iteration trains, if every anchor is another policy from the second on."""
    weights = weights_of(objectives_of(config, registry), config)
    counts = []
    for iteration in range(config.iterations):
        hashes: dict[str, str] = {anchor: anchor if iteration else "one" for anchor in config.sweep.anchors}
        counts.append(len(candidates(iteration, hashes, weights, config.sweep.kl_bounds)))
    return counts


def second_trials(config: RunConfig) -> int:
    """How many of the best are to be tried again: none at a single speed, which has no second order."""
    return config.selection.confirm if len(config.selection.tested_speeds) > 1 else 0


def seconds_per_elite(config: RunConfig, world: World) -> float:
    """Robot time of one elite's test, s, as the world says it. The world holds the speed already, if it is to."""
    speeds, block = config.selection.tested_speeds, config.selection.block_seconds
    if len(speeds) > 1 or block is not None:
        return world.head_to_head_session_seconds(len(speeds), block)
    return world.head_to_head_seconds()


def plan(config: RunConfig, registry: Registry, world: World) -> Budget:
    """The plan of a run. Raises ConfigError for a cap that one recording and one test do not fit in, or with a
    selector that tests in rounds, whose time nobody knows before."""
    robot = robot_of(config, registry)
    rate, most, schedule = robot.spec.control_rate_hz, config.max_real_samples, config.collection.schedule
    seconds = seconds_per_elite(config, world)
    each = math.ceil(rate * max(ALLOWANCE * seconds, seconds + LEAST_ALLOWANCE))
    moments = 1 + len(config.finetune.also_at)  # of a training that can be tried
    wanted = [min(config.selection.elites, moments * count) for count in candidate_counts(config, registry)]
    recordings = config.collection.repeats + config.collection.exploring if config.records_first else 0
    first = math.ceil(schedule.seconds * rate) * recordings
    again = second_trials(config) if sum(wanted) > 1 else 0
    whole = Budget(schedule, tuple(wanted), first, each, most, tuple(wanted), min(again, sum(wanted)))
    if most is None:
        return whole
    selector = checked_selector(registry, config.selection.selector)
    if selector.rounds() is not None:
        raise ConfigError(
            f"max_real_samples: selector '{config.selection.selector.name}' tests in rounds, and how many there will "
            "be is not known before. Choose another selector, or take the cap away: --set max_real_samples=null."
        )
    if whole.samples <= most:
        return whole
    least = math.ceil(LEAST_SHARE * first)
    tests = min((most - least) // each, sum(wanted))
    if tests < 1:
        raise ConfigError(
            f"max_real_samples={most}: half of the first data are {least} real samples and the test of one elite "
            f"takes {each}, so none fits. Expected {least + each} at least; or ask for shorter tests "
            "(selection.block_seconds, selection.speeds)."
        )
    if first > most - tests * each:
        schedule = shortened(schedule, (most - tests * each) / recordings / rate, rate)
        first = math.ceil(schedule.seconds * rate) * recordings
    return Budget(schedule, tuple(spread(tests, wanted)), first, each, most, tuple(wanted))


def spread(tests: int, wanted: Sequence[int]) -> list[int]:
    """So many tests over iterations: one for each as long as they last, then a second one from the first on, and so
    forth, never more than an iteration wants. Iterations without a test are left out."""
    found = [0] * len(wanted)
    while tests > 0 and found != list(wanted):
        for index, most in enumerate(wanted):
            if tests > 0 and found[index] < most:
                found[index] += 1
                tests -= 1
    return [count for count in found if count > 0]


def shortened(schedule: ScheduleConfig, seconds: float, rate: float) -> ScheduleConfig:
    """The same commands in at most so many seconds, each by the same share, in whole control steps.

    Raises ConfigError where a command would be shorter than LEAST_SECONDS (or than it is, if it is shorter already).
    """
    share = seconds / schedule.seconds
    commands = []
    for command in schedule.commands:
        length = math.floor(command.seconds * share * rate) / rate
        if length < min(LEAST_SECONDS, command.seconds):
            raise ConfigError(
                f"max_real_samples leaves {length:.1f} s for each {command.seconds:g} s of collection.schedule, and "
                f"{LEAST_SECONDS:g} s are needed. Raise it, or record less often (collection.repeats, "
                "collection.exploring)."
            )
        commands.append(command.model_copy(update={"seconds": length}))
    return schedule.model_copy(update={"commands": tuple(commands)})
