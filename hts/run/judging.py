"""The stage that judges candidates in simulation: scores, what is promised for reality, who is tried there."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from hts.contracts import VELOCITY, FineTuning, HoldSpeed, Objective, SimulatedCandidate, Task
from hts.evaluation.final import speed_key
from hts.evaluation.predicted import pieces, predicted_comparison
from hts.evaluation.simulation import SimulatedTrial, test_config, trial_seconds, trial_steps
from hts.evaluation.simulation import simulate as trials
from hts.measurement.baseline import fit_proxy
from hts.measurement.proxy import proxy_along
from hts.measurement.transform import channels_read
from hts.policies.files import Policy
from hts.policy_ids import PRETRAINED
from hts.recordings.recording import Recording
from hts.rl.kl_bound import mean_kl
from hts.rl.population import Population
from hts.run.felt_pull import pulled
from hts.run.job import Job
from hts.run.learning import transforms
from hts.run.stages import Report, number
from hts.run.task_watch import gave_up, gave_up_line
from hts.training.finetune import measured_env

InUnit = Callable[[np.ndarray], np.ndarray]
NOT_WRITTEN = ("worlds", "pieces", "piece_speed")  # of a trial: what the stage's result is made from


def simulate(job: Job, iteration: int, report: Report) -> dict[str, Any]:
    """Judge candidates by their mean action in the training simulation; Π_{i+1} <- top K."""
    tuned = job.read("finetune", iteration)
    return judge(job, iteration, tuned, tuned["candidates"])


def judge(
    job: Job,
    iteration: int,
    tuned: Mapping[str, Any],
    rows: Sequence[Mapping[str, Any]],
    anchors: Sequence[Policy] | None = None,
) -> dict[str, Any]:
    """Judge these candidates, and the pretrained policy beside them, in the same worlds whoever they are.

    tuned: finetune.json; rows: as in it; anchors: of each candidate, where the mean KL(pi || anchor) over the states
    of its own trials is asked for: candidate -> nats, in `kl`. Says where the task is being given up.
    """
    config, pull = job.config, tuned.get("pull")
    test = config.simulation_test
    names = [PRETRAINED, *(row["id"] for row in rows)]
    policies = [job.policy(name) for name in names]
    worlds = test.num_envs * len(test.speeds)
    seed = job.seed("simulate")  # the same worlds in every iteration
    env_config = test_config(config.finetune.env, test.speeds, trial_seconds(test), seed)
    if pull is not None and test.measured_pull:
        env_config = pulled(env_config, tuple(pull["pull"]))
    task = job.robot.task()
    channels = tuple(dict.fromkeys((*channels_read(transforms(job, iteration)), *task.channels)))
    bare = job.robot.make_env(
        config.engine, len(names), worlds, env_config, channels=channels, seeds=[seed] * len(names)
    )
    env = measured_env(bare, transforms(job, iteration))
    population = _population(policies, bare.device)
    distance = None if anchors is None else Distance(population, _population([policies[0], *anchors], bare.device))
    hold = HoldSpeed(config.finetune.env.commands.vx) if test.hold_speed else None
    walks = trials(env, population, test.speeds, test.seconds, test.speed_tolerance, task, hold, distance)
    results = dict(zip(names, walks, strict=True))
    env.close()
    promised = _promised(job, iteration, results)
    task_rewards = {name: sum(t.task_reward for t in row) / len(row) for name, row in results.items()}
    share = needed(test.min_valid, rows, {name: least_valid(walked) for name, walked in results.items()})
    judged = [
        replace(
            _judge(row, results[row["id"]], test.speed_tolerance, task, share),
            made=fine_tuning(row, task_rewards),
            predicted=mean_gain(promised.get(row["id"], {})),
            predicted_speeds=speeds_predicted(promised.get(row["id"], {})),
        )
        for row in rows
    ]
    selector = job.selector()
    lenient, alike = is_lenient(job), same_policies(rows)
    able = [
        one
        for one, row in zip(judged, rows, strict=True)
        if may_be_tested(one.falls, row["stopped"], lenient) and one.id not in alike
    ]
    details = {
        name: [{key: value for key, value in vars(trial).items() if key not in NOT_WRITTEN} for trial in row]
        for name, row in results.items()
    }
    elites = selector.elites(able, job.elites(iteration))
    found = {
        "policy_hashes": {row["id"]: row["policy_hash"] for row in rows},
        "scores": {c.id: c.score for c in judged},
        "objective_scores": {name: _scores(row) for name, row in results.items()},  # of the pretrained policy too
        "task_rewards": task_rewards,  # likewise, per second
        "falls": {c.id: c.falls for c in judged},
        "tracked": {c.id: c.tracked for c in judged},
        "pretrained_tracked": does_it(task, results[PRETRAINED], test.speed_tolerance),
        "elites": elites,
        "trials": details,
        "predicted": promised,
        "steps": trial_steps(test, job.robot.spec.control_rate_hz) * worlds * len(names),
        **({} if distance is None else {"kl": dict(zip(names[1:], distance.means()[1:], strict=True))}),
    }
    line = gave_up_line(elites, found, tuned.get("reward_scale") or {}, task.quantity, task.unit)
    if line is not None:
        job.say(f"iteration {iteration:02d}: {line}")
    return {**found, "gave_up": {"elites": gave_up(elites, found), "line": line}}


class Distance:
    """Mean KL(pi || reference) [P] over the states that policies are seen in."""

    def __init__(self, population: Population, reference: Population) -> None:
        self.population, self.reference = population, reference
        self._sum, self._count = torch.zeros((), device=population.device), 0

    def __call__(self, observation: torch.Tensor) -> None:
        """observation [P, N, O]: of one step."""
        self._sum, self._count = self._sum + mean_kl(self.population, self.reference, observation), self._count + 1

    def means(self) -> list[float]:
        """Of each policy over the steps so far, one at least; nats."""
        found: list[float] = (self._sum / self._count).tolist()
        return found


def _population(policies: Sequence[Policy], device: torch.device | None) -> Population:
    return Population.from_candidates(policies[0].card.sizes(), [policy.tensors for policy in policies], device)


def _promised(
    job: Job, iteration: int, results: Mapping[str, Sequence[SimulatedTrial]]
) -> dict[str, dict[str, dict[str, Any]]]:
    """Candidate -> objective -> speed -> the improvement over the pretrained policy that its model predicts, with the
    metrics that a head-to-head will have. A speed at which nothing can be predicted is left out."""
    if not job.config.records_first:
        return {}
    known, task = job.recordings(job.known(iteration)), job.robot.task()
    found: dict[str, dict[str, dict[str, Any]]] = {name: {} for name in results if name != PRETRAINED}
    for key, objective in job.objectives.items():
        in_unit = _in_unit(job, iteration, key, objective, known)

        def seen(trial: SimulatedTrial, objective: Objective = objective, in_unit: InUnit = in_unit) -> Any:
            target = in_unit(trial.pieces[objective.target.name])
            tolerance = job.config.evaluation.speed_tolerance
            return pieces(objective, target, trial.piece_speed, trial.speed, known, tolerance, task)

        def tell(why: str, objective: Objective = objective) -> None:
            who = f"Objective '{objective.name}'"
            job.say_once(f"{who}: not predicted", f"{who}: what candidates would save cannot be predicted. {why}")

        references = [seen(trial) for trial in results[PRETRAINED]]
        for name, row in found.items():
            compared = {
                speed_key(trial.speed): predicted_comparison(objective, seen(trial), reference, tell)
                for trial, reference in zip(results[name], references, strict=True)
            }
            row[key] = {
                speed: {
                    "improvement": one.improvement,
                    "selection_score": one.selection_score,
                    "metrics": dict(one.metrics),
                }
                for speed, one in compared.items()
                if one is not None
            }
    return found


def _in_unit(job: Job, iteration: int, key: str, objective: Objective, known: Sequence[Recording]) -> InUnit:
    """From what the env writes of a target to its unit: a model's z-scores, or a proxy, which a line through the known
    recordings turns into the target. A line says nothing beyond what it was drawn through, and of levels, which are
    summed as energies, one sample far beyond it would decide: the proxy counts as far as the recordings reach."""
    if job.config.fits_models:
        model = job.model(iteration, key)
        return lambda found: model.denormalise(torch.from_numpy(found)).numpy()
    line = fit_proxy(objective, known)
    assert line is not None  # without a proxy there is nothing to train with
    ends = [(seen.min(), seen.max()) for one in known if (seen := proxy_along(objective, one)) is not None]
    low, high = min(end[0] for end in ends), max(end[1] for end in ends)
    return lambda found: line.scale * np.clip(found, low, high) + line.offset


def mean_gain(promised: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> dict[str, float]:
    """Objective -> the mean over speeds of the selection score that is predicted; only what is predicted at all."""
    return {
        key: sum(one["selection_score"] for one in speeds.values()) / len(speeds)
        for key, speeds in promised.items()
        if speeds
    }


def speeds_predicted(promised: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> dict[str, int]:
    """Objective -> over how many speeds that mean is."""
    return {key: len(speeds) for key, speeds in promised.items() if speeds}


def same_policies(rows: Sequence[Mapping[str, Any]]) -> set[str]:
    """Ids of candidates that ended as the same policy as an earlier one, as those do that no bound held back: trying
    both would tell nothing new. rows: of finetune.json."""
    seen: set[str] = set()
    alike = set()
    for row in rows:
        if row["policy_hash"] in seen:
            alike.add(row["id"])
        seen.add(row["policy_hash"])
    return alike


def is_lenient(job: Job) -> bool:
    """Whether the run's world gets who fell or was stopped in simulation too: a simulated one without a strict gate. A
    world that does not say what it is counts as a machine."""
    return job.world.simulated is True and not (job.config.gate.enabled and job.gate_is_strict)


def may_be_tested(falls: int, stopped: str | None, lenient: bool) -> bool:
    """A machine never gets a candidate that fell in simulation, so often, or whose training was stopped, for this
    reason; a simulated world may, where no gate stands before it. lenient: as `is_lenient` says."""
    return lenient or (falls == 0 and stopped is None)


def fine_tuning(row: Mapping[str, Any], task_rewards: Mapping[str, float | None]) -> FineTuning:
    """How a candidate was made. row: its part of finetune.json; task_rewards: of simulate.json."""
    return FineTuning(
        anchor=row["anchor"],
        weights=row["weights"],
        kl_bound=number(row["kl_bound"], math.inf),
        kl=number(row["kl"]),
        task_reward=number(task_rewards.get(row["id"])),
        pretrained_task_reward=number(task_rewards.get(PRETRAINED)),
    )


def needed(share: float, rows: Sequence[Mapping[str, Any]], reached: Mapping[str, float]) -> float:
    """Share of its seconds that a candidate must do its task at its worst set-point: `share`, or what the steadiest
    candidate reaches, so that somebody does. Who was stopped stands at its anchor, is nobody to try, and sets no
    measure. rows: of the candidates; reached: by each, as `least_valid` says."""
    return min(share, max((reached[row["id"]] for row in rows if row["stopped"] is None), default=0.0))


def least_valid(results: Sequence[SimulatedTrial]) -> float:
    """Share of its seconds in which the task was done, at the worst set-point."""
    return min(trial.valid for trial in results)


def _judge(
    row: Mapping[str, Any],
    results: Sequence[SimulatedTrial],
    tolerance: float,
    task: Task = VELOCITY,
    share: float = 0.0,
) -> SimulatedCandidate:
    """Score = unweighted mean r_real over speeds, summed over objectives (each in its own standard deviations).
    share: of its seconds at each set-point that must be good, beside what the task itself asks for."""
    falls = sum(trial.falls for trial in results)
    tracked = does_it(task, results, tolerance) and least_valid(results) >= share
    scores = _scores(results)
    if row["stopped"] is not None:
        scores, tracked = dict.fromkeys(scores, float("-inf")), False
    return SimulatedCandidate(row["id"], sum(scores.values()), falls, tracked, scores)


def does_it(task: Task, results: Sequence[SimulatedTrial], tolerance: float) -> bool:
    """Whether a policy does the task at every set-point."""
    return all(task.does_it(trial.mean_speed, trial.valid, trial.speed, tolerance) for trial in results)


def _scores(results: Sequence[SimulatedTrial]) -> dict[str, float]:
    """Mean r_real over speeds of each objective, per second."""
    names = dict.fromkeys(name for trial in results for name in trial.rewards)
    return {name: sum(trial.rewards[name] for trial in results) / len(results) for name in names}
