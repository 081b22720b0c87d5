"""The stage `test`: elites against the pretrained policy, whole or in rounds, as the selector wants it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from hts.config import EvaluationConfig
from hts.contracts import (
    Comparison,
    FineTuning,
    HoldSpeed,
    RacedCandidate,
    Rounds,
    Selector,
    Task,
    TestedCandidate,
    World,
)
from hts.contracts.task import FollowVelocity
from hts.evaluation.across_speeds import mean_comparison
from hts.evaluation.asked import asked, complete_each
from hts.evaluation.final import CandidateResult, candidate_result, speeds_missed
from hts.evaluation.halves import Half, halves
from hts.evaluation.held import ask_to_hold
from hts.evaluation.walked_again import walked_again
from hts.measurement.checks import check
from hts.measurement.drift import REMEDY, drift, drift_note
from hts.policy_ids import PRETRAINED
from hts.recordings.recording import Recording, robot_samples_of
from hts.run.head_to_head import ends_the_run
from hts.run.iteration import elites_of, simulated, tuned
from hts.run.job import Job
from hts.run.judging import fine_tuning
from hts.run.learning import bound_scale
from hts.run.stage_files import Result
from hts.run.stages import Report, damaged
from hts.run.trust_region import by_all
from hts.training.sweep import iteration_of


@dataclass
class Tests:
    """What was recorded of the elites.

    of: elite -> its recordings and its reference's, which elites may share; recorded: each once, in order of time;
    races: of each round, who was in it, their selection scores over all rounds so far, and who goes on (nobody after
    the last one); empty for whole tests.
    """

    of: dict[str, list[Recording]]
    recorded: list[Recording]
    results: dict[str, CandidateResult]
    races: list[dict[str, Any]] = field(default_factory=list)

    __test__ = False  # its name begins like a pytest class

    def for_best(self, selector: Selector) -> list[TestedCandidate]:
        """Those of whom the best is chosen: after a race who was in its last round, since whoever left before was found
        to be worse, and scores over other rounds do not compare; everybody, where nobody of them is good enough."""
        everybody = [found.tested for found in self.results.values() if found.tested is not None]
        last = self.races[-1]["racing"] if self.races else list(self.results)
        still = [one for one in everybody if one.id in last]
        return everybody if selector.best(still) is None else still


def test(job: Job, iteration: int, best: str, report: Report) -> dict[str, Any]:
    """Elites against the pretrained policy; π_best <- the best of them, if it beats the best so far.

    Raises TooFewSegments as `check_reference` does.
    """
    elites = elites_of(job, iteration)
    selector = job.selector()
    rounds = selector.rounds()
    tests = in_rounds(job, elites, selector, rounds, report) if rounds is not None and elites else None
    if tests is None:  # this selector, or this world, knows no rounds
        tests = whole(job, elites, job.config.selection.tested_speeds, job.spent(iteration), report)
    else:
        check_reference(tests, job.world, job.say)
    ids = job.keep(tests.recorded, iteration + 1)
    _tell_drifts(job, tests.recorded)
    tested = tests.for_best(selector)
    incumbent = [] if best == job.first else [tested_before(job, best)]  # nobody before the first success
    races = {"rounds": tests.races} if tests.races else {}
    results = {elite: result_row(found) for elite, found in tests.results.items()}
    return {
        "elites": elites,
        "results": results,
        "recordings": ids,
        "best": selector.best(tested),
        # The protocol is the same in every iteration, so an earlier winner that measured better stays.
        "best_so_far": selector.best([*tested, *incumbent]) or best,
        "samples": robot_samples_of(tests.recorded),
        **races,
        "model_checks": _check_models(job, iteration, ids),
        **_trust(job, iteration, results),
    }


test.__test__ = False  # type: ignore[attr-defined]  # not a pytest test


def whole(
    job: Job, elites: Sequence[str], speeds: Sequence[float], spent: int, report: Report, before: int = 0
) -> Tests:
    """A whole head-to-head of each elite at every one of the speeds, on one machine where the world can; speeds whose
    commands were not found once more, as `selection.trims_again` says. spent: real samples before; before: how many
    trials these elites may have had, so that a speed walked again is another session than in any of those.

    Raises TooFewSegments as `check_reference` does.
    """
    job.watch(report)
    of = dict(zip(elites, _head_to_heads(job, elites, speeds), strict=True))
    vain = _again(job, of, spent, before)
    recorded = [recording for session in of.values() for recording in session] + vain
    tests = Tests(of, recorded, {elite: _result(job, elite, recordings) for elite, recordings in of.items()})
    check_reference(tests, job.world, job.say)
    return tests


def check_reference(tests: Tests, world: World, say: Callable[[str], None]) -> None:
    """Raise TooFewSegments if no trial gave a number and, in one of them, the reference itself kept too few seconds.

    Then nothing can be compared, and whoever stands beside the robot should look at it. Where another trial gave a
    number the reference can walk, and only who met it otherwise is refused, which is said in one line each.
    """
    results = tests.results.values()
    comparable = any(found.tested is not None for found in results)
    for found in results:
        if found.reference is not None and not comparable:
            raise ends_the_run(found.reference, world) from found.reference
        if found.reference is not None:
            say(str(found.refused))


def _head_to_heads(job: Job, elites: Sequence[str], speeds: Sequence[float]) -> list[list[Recording]]:
    """Of each elite, its recordings and its reference's; a world is not asked to walk nobody."""
    if not elites:
        return []
    selection = job.config.selection
    policies, reference = [job.exported(elite) for elite in elites], job.exported(PRETRAINED)
    if len(selection.tested_speeds) > 1 or selection.block_seconds is not None:
        call = "head_to_heads_in_session"
        sessions = asked(job.world, call, policies, reference, speeds, selection.block_seconds)
        if sessions is not None:
            return complete_each(job.world, call, sessions, len(policies), speeds, job.check_recordings)
        world = job.config.world.name
        job.say(f"World '{world}' knows whole head-to-heads only: {one_for_each(job.robot.task())}")
    found = asked(job.world, "head_to_heads", policies, reference, speeds)
    return complete_each(job.world, "head_to_heads", found, len(policies), speeds, job.check_recordings)


def _again(job: Job, of: dict[str, list[Recording]], spent: int, before: int = 0) -> list[Recording]:
    """Walk the speeds of each elite again whose commands were not found: changes `of`, gives what was in vain."""
    selection, most = job.config.selection, job.config.max_real_samples
    if job.hold is None or selection.trims_again == 0:
        return []
    hold = replace(job.hold, again=before * selection.trims_again)
    config, task, objective = _evaluation(job), job.robot.task(), next(iter(job.objectives.values()))
    asked = config.model_copy(update={"min_valid": max(config.min_valid, selection.min_valid or 0.0)})
    spent += sum(map(robot_samples_of, of.values()))
    vain: list[Recording] = []
    for elite, session in of.items():

        def missed(recordings: Sequence[Recording], seed: int = job.seed("interval", elite)) -> list[float]:
            return speeds_missed(objective, recordings, asked, seed, task)

        def ask(hold: HoldSpeed, speeds: Sequence[float], elite: str = elite) -> list[Recording]:
            ask_to_hold(job.world, hold)
            return _head_to_heads(job, [elite], speeds)[0]

        room = math.inf if most is None else most - spent
        good, more = walked_again(session, hold, selection.trims_again, missed, ask, room)
        spent += robot_samples_of([*good, *more]) - robot_samples_of(session)
        of[elite] = good
        vain += more
    ask_to_hold(job.world, job.hold)
    return vain


def one_for_each(task: Task) -> str:
    """The end of a sentence about head-to-heads that are not shared, in the task's words."""
    if task.set_points == ():  # nothing is commanded, so there is one of them
        return "each elite gets one."
    return f"each {'speed' if isinstance(task, FollowVelocity) else 'set-point'} gets one of its own."


def in_rounds(job: Job, elites: Sequence[str], selector: Selector, rounds: Rounds, report: Report) -> Tests | None:
    """Short head-to-heads of those that are still racing; None if the world knows no rounds."""
    reference, speeds = job.exported(PRETRAINED), job.config.selection.tested_speeds
    speed: float | tuple[float, ...] = speeds if len(speeds) > 1 else speeds[0]

    def ask(racing: Sequence[str], number: int) -> list[list[Recording]] | None:
        job.watch(lambda share: report((number + share) / rounds.most))
        policies = [job.exported(elite) for elite in racing]
        call = "head_to_head_round"
        found = asked(job.world, call, policies, reference, speed, number, rounds.block_seconds)
        return (
            None
            if found is None
            else complete_each(job.world, call, found, len(policies), speeds, job.check_recordings)
        )

    def judge(elite: str, recordings: Sequence[Recording]) -> CandidateResult:
        return _result(job, elite, recordings)

    def split(row: Sequence[Recording]) -> Sequence[Half | None]:
        return halves(job.objectives, row, _evaluation(job), job.robot.task())

    tests = race(elites, selector, rounds, ask, judge, split)
    if tests is None:
        world = job.config.world.name
        job.say(f"World '{world}' knows no rounds: each elite gets a whole head-to-head.")
    return tests


def race(
    elites: Sequence[str],
    selector: Selector,
    rounds: Rounds,
    ask: Callable[[Sequence[str], int], Sequence[Sequence[Recording]] | None],
    judge: Callable[[str, Sequence[Recording]], CandidateResult],
    split: Callable[[Sequence[Recording]], Sequence[Half | None]],
) -> Tests | None:
    """Rounds until the selector has seen enough or they are spent; None if `ask` gives None.

    ask(who is racing, number of the round): recordings of each; judge(elite, all its recordings so far);
    split(an elite's recordings of a round): its halves. Nothing is kept between calls: begun anew after a stop, with a
    world that gives the rounds it gave before, it ends the same.
    """
    tests = Tests({elite: [] for elite in elites}, [], {})
    found: dict[str, list[Half | None]] = {elite: [] for elite in elites}
    racing = list(elites)
    for number in range(rounds.most):
        rows = ask(racing, number)
        if rows is None:
            return None
        tests.recorded += {id(recording): recording for row in rows for recording in row}.values()
        for elite, row in zip(racing, rows, strict=True):
            tests.of[elite] += row
            found[elite] += split(row)
            tests.results[elite] = judge(elite, tests.of[elite])
        raced = [RacedCandidate(name, tests.results[name].tested, name in racing, found[name]) for name in elites]
        kept = set(selector.keep(raced)) if number + 1 < rounds.most else set()
        going_on = [name for name in racing if name in kept] if len(kept) > 1 else []
        scores = {name: _scores(tests.results[name].tested) for name in racing}
        tests.races.append({"racing": racing, "selection_score": scores, "going_on": going_on})
        racing = going_on
        if not racing:
            break
    return tests


def _result(job: Job, elite: str, recordings: Sequence[Recording]) -> CandidateResult:
    seed, task = job.seed("interval", elite), job.robot.task()
    steady = job.config.selection.min_valid
    found = candidate_result(elite, job.objectives, recordings, _evaluation(job), seed, task, steady)
    if found.tested is None:
        return found
    return replace(found, tested=replace(found.tested, made=_made(job, elite)))


def _made(job: Job, name: str) -> FineTuning:
    """How a candidate was made."""
    iteration = iteration_of(name)
    row = next(one for one in tuned(job, iteration)["candidates"] if one["id"] == name)
    return fine_tuning(row, simulated(job, iteration).get("task_rewards") or {})


def _scores(tested: TestedCandidate | None) -> dict[str, float] | None:
    """Selection score per objective."""
    if tested is None:
        return None
    return {key: value.selection_score for key, value in tested.comparisons.items()}


def result_row(found: CandidateResult) -> dict[str, Any]:
    """A candidate's part of the stage's result."""
    row: dict[str, Any] = {"real": found.entry, "refused": found.refused}
    if found.refusal is not None:
        row["refusal"] = dict(found.refusal)
    if found.refused_falls:
        row["refused_falls"] = dict(found.refused_falls)
    if found.tested is not None:
        row["tested"] = {"fell": found.tested.fell, "selection_score": _scores(found.tested)}
    return row


def tested_before(job: Job, name: str) -> TestedCandidate:
    """A candidate as it was measured in its own iteration, where nothing refused it."""
    iteration = iteration_of(name)
    row = Result.model_validate(job.read("test", iteration)["results"][name])
    if row.real is None or row.tested is None:
        raise damaged(job.path("test", iteration), f"nothing about what was measured of {name}")
    comparisons = {}
    for key, score in row.tested.selection_score.items():
        speeds = [Comparison(one.improvement, score, one.metrics) for one in row.real[key].values()]
        comparisons[key] = mean_comparison(speeds)  # `score` is the mean over them already
    return TestedCandidate(name, comparisons, row.tested.fell, _made(job, name))


def _evaluation(job: Job) -> EvaluationConfig:
    """How tests become numbers: as in the final, but for how far held speeds may be apart."""
    changed = {"held_tolerance": job.config.selection.held_tolerance}
    return job.config.evaluation.model_copy(update=changed)


def _trust(job: Job, iteration: int, results: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """How far the next iteration's candidates may go: {"trust_region": …}; nothing where the bounds do not move."""
    config = job.config.sweep.trust_region
    if not config.enabled:
        return {}
    predicted = simulated(job, iteration)["predicted"]
    rows = {row["id"]: row | {"predicted": predicted.get(row["id"], {})} for row in tuned(job, iteration)["candidates"]}
    scale, why, found = by_all(
        bound_scale(job, iteration), list(job.objectives), rows, results, config, job.config.sweep.kl_bounds
    )
    return {"trust_region": {"scale": scale, "why": why, **found.entry()}}


def _tell_drifts(job: Job, recordings: Sequence[Recording]) -> None:
    """Where a target drifts within the blocks, a policy's block still shows the one before: said once a run."""
    for name, objective in job.objectives.items():
        if note := drift_note(objective.target.name, drift(recordings, objective.target.name)):
            job.say_once(
                f"{name}: blocks drift",
                f"head-to-heads: {note}. A block then shows what the policy before it did, and savings come "
                f"out too small however narrow their intervals; {REMEDY}.",
            )


def _check_models(job: Job, iteration: int, ids: list[str]) -> dict[str, Any]:
    """How well this iteration's models predicted the policies that were made with them: the hardest test."""
    if not job.config.fits_models or not ids:  # ids: of the tests, none where nobody could be tested
        return {}
    tried = job.recordings(ids)
    known = job.recordings(job.known(iteration))
    found = {
        name: check(objective, job.model(iteration, name), tried, known) for name, objective in job.objectives.items()
    }
    for name, objective in job.objectives.items():
        r2 = found[name]["r2"]
        if r2 is not None and r2 < 0:
            job.say(
                f"'{objective.target.name}' of the policies that were tried is predicted worse than by its mean (R² "
                f"{r2:.3g}), so what the model promises of candidates tells little. Is it more than the inputs of the "
                "last second decide, as a temperature is? (docs/measurement.md)"
            )
    return found
