"""The stage `gate`: elites are tried over varied dynamics, and who fails is not tried for real.

Where some fail the selector is asked again without them, until all that it names have passed or nobody is left.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from hts.contracts import SimulatedCandidate
from hts.evaluation.simulation import test_config
from hts.policy_ids import PRETRAINED
from hts.rl.population import Population
from hts.run.gate_checks import Worst, limits, sentence, told_by, untold_by
from hts.run.gate_trials import LostPackets, channels_of, commands_of, dynamics, rollout, varied
from hts.run.job import Job
from hts.run.judging import fine_tuning, mean_gain, same_policies, speeds_predicted
from hts.run.stages import Report, number

FORMAT = 1  # of gate.json


def gate(job: Job, iteration: int, report: Report) -> dict[str, Any]:
    """The elites of simulate.json, or those behind them."""
    rows, simulated = job.read("finetune", iteration)["candidates"], job.read("simulate", iteration)
    return tried(job, iteration, rows, simulated, report, again=bool(job.config.gate.nearer))


def tried(
    job: Job,
    iteration: int,
    candidates: Sequence[Mapping[str, Any]],
    simulated: Mapping[str, Any],
    report: Report,
    *,
    again: bool = False,
    yardstick: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Try the elites, and where they fail those behind them, over varied dynamics. Says each refusal in one line.

    candidates: rows of finetune.json; simulated: how they were judged, as in simulate.json; again: whether others are
    looked at where nobody passes; yardstick: the pretrained policy's row, where it was tried before.
    """
    strict, settings = job.gate_is_strict, job.config.gate
    able, kept_out = _able(simulated, candidates)
    trials = Trials(job, simulated)
    elites, rows = _passing(job, iteration, simulated["elites"], able, trials, report)
    refused = [row["refused"] for row in rows.values() if not row["passed"]]
    pretrained = yardstick
    if refused and yardstick is None:
        pretrained = trials.of([PRETRAINED])[PRETRAINED]
    said_before = yardstick is not None
    lines = [*refused, *_closing(rows, elites, None if said_before else pretrained, strict and again)]
    if not strict and (fell := [name for name in elites if name in kept_out or not rows[name]["passed"]]):
        lines.append(f"a machine would not get {', '.join(fell)}; this world is simulated, so they are tried")
    for line in lines:
        job.say(f"iteration {iteration:02d}: {line}")
    for name, row in rows.items():
        job.note_gate(name, {"instances": trials.instances, "set_points": list(trials.set_points), **row})
    _note_others(job, candidates, simulated, kept_out, set(rows))
    return {
        "format": FORMAT,
        "checks": list(trials.checks),
        "untold": list(untold_by(job.robot)),
        "accepted_untold": [check for check in settings.accept_untold if check in untold_by(job.robot)],
        "limits": {check: value for check, value in limits(settings).items() if check in trials.checks},
        "dynamics": {
            name: list(getattr(settings, name)) for name in ("friction", "payload", "gains", "latency", "lost_packets")
        },
        "set_points": list(trials.set_points),
        "seconds": settings.seconds,
        "instances": trials.instances,
        "proposed": simulated["elites"],
        "strict": strict,
        "kept_out": kept_out if strict else {},
        "policies": rows,
        "pretrained": pretrained,
        "elites": elites,
        "lines": lines,
        "first_run": settings.first_run.model_dump(),
        "steps": trials.steps,
    }


def _passing(
    job: Job,
    iteration: int,
    proposed: Sequence[str],
    able: Sequence[SimulatedCandidate],
    trials: Trials,
    report: Report,
) -> tuple[list[str], dict[str, dict[str, Any]]]:
    """Who is tried for real, and the row of each that the gate looked at. Where the gate is strict and refuses one, the
    selector chooses anew among those that are left, until all whom it chooses have passed; else those that were
    proposed go, whatever is seen."""
    selector = job.selector()
    strict, chosen, rows = job.gate_is_strict, list(proposed), dict[str, dict[str, Any]]()
    while waiting := [name for name in chosen if name not in rows]:
        rows |= trials.of(waiting)
        if not strict:
            break
        able = [one for one in able if rows.get(one.id, {}).get("passed", True)]
        if all(rows[name]["passed"] for name in waiting):
            break
        chosen = selector.elites(able, job.elites(iteration))
        report(min(0.9, len(rows) / max(1, len(rows) + len(able))))
    return [name for name in chosen if rows[name]["passed"] or not strict], rows


def _note_others(
    job: Job,
    candidates: Sequence[Mapping[str, Any]],
    simulated: Mapping[str, Any],
    kept_out: Mapping[str, str],
    looked_at: set[str],
) -> None:
    """What was known of a candidate before the gate looked, for whoever asks for one of these later."""
    for candidate in candidates:
        name, stopped = candidate["id"], candidate["stopped"] is not None
        if name not in looked_at and (stopped or simulated["falls"][name]):
            known = {"failed": ["training stopped" if stopped else "falls"], "refused": f"{name}: {kept_out[name]}"}
            job.note_gate(name, {"instances": 0, "passed": False, **known})


class Trials:
    """Tries policies of a run in the same env instances, whoever is asked about and however often.

    checks: those that the robot's env can tell; instances: of it per policy; steps: control steps taken so far.
    """

    def __init__(self, job: Job, simulated: Mapping[str, Any]) -> None:
        config = job.config
        self.job, self.judged, self.steps = job, simulated["trials"], 0
        self.checks, self.set_points = told_by(job.robot), config.simulation_test.speeds
        self.instances = config.gate.num_envs * len(self.set_points)
        self.seed = job.seed("gate")  # the same dynamics in every iteration
        straight = test_config(config.finetune.env, self.set_points, config.gate.seconds, self.seed)
        self.env_config = varied(straight, config.gate, self.instances)

    def of(self, names: Sequence[str]) -> dict[str, dict[str, Any]]:
        """Policy -> its row of `gate.json`."""
        job, settings = self.job, self.job.config.gate
        policies = [job.policy(name) for name in names]
        channels = channels_of(self.checks)
        env = job.robot.make_env(
            job.config.engine,
            len(names),
            self.instances,
            self.env_config,
            channels=channels,
            seeds=[self.seed] * len(names),
        )
        lost = LostPackets(settings.lost_packets, self.instances, self.seed)
        tensors = [policy.tensors for policy in policies]
        population = Population.from_candidates(policies[0].card.sizes(), tensors, env.device)
        sent = commands_of(self.judged, names, self.set_points) if job.config.simulation_test.hold_speed else None
        spec = job.robot.spec
        try:
            found = rollout(env, population, spec, self.checks, settings, self.set_points, lost, sent)
        finally:
            env.close()
        self.steps += round(settings.seconds * spec.control_rate_hz) * self.instances * len(names)
        return {
            name: {"policy_hash": policy.card.policy_hash, **self._row(name, worst, lost)}
            for name, policy, worst in zip(names, policies, found, strict=True)
        }

    def _row(self, name: str, worst: Mapping[str, Worst], lost: LostPackets) -> dict[str, Any]:
        job, settings = self.job, self.job.config.gate
        known = {
            check: one
            if one.passed
            else replace(one, dynamics=dynamics(job.robot, self.env_config, lost, one.instance))
            for check, one in worst.items()
        }
        failed = [check for check in known if not known[check].passed]
        refused = None
        if failed:
            said = sentence(name, known[failed[0]], settings, job.robot)
            refused = said + (f"; and by {', '.join(failed[1:])}" if failed[1:] else "")
        return {
            "passed": not failed,
            "failed": failed,
            "refused": refused,
            "worst": {check: one.entry() for check, one in known.items()},
        }


def _able(
    simulated: Mapping[str, Any], candidates: Sequence[Mapping[str, Any]]
) -> tuple[list[SimulatedCandidate], dict[str, str]]:
    """Candidates that may be asked about, as they were judged; and why the others may not."""
    able, kept_out, alike = [], {}, same_policies(candidates)
    for row in candidates:
        name, falls = row["id"], simulated["falls"][row["id"]]
        if row["stopped"] is not None:
            kept_out[name] = f"training stopped: {row['stopped']}"
        elif falls:
            kept_out[name] = f"fell while being judged, in {falls} env instance{'' if falls == 1 else 's'}"
        elif name in alike:
            kept_out[name] = "ended as the same policy as an earlier candidate"
        else:
            able.append(as_judged(row, simulated))
    return able, kept_out


def as_judged(row: Mapping[str, Any], simulated: Mapping[str, Any]) -> SimulatedCandidate:
    """A candidate as a selector sees it. row: its part of finetune.json; simulated: as simulate.json."""
    name = row["id"]
    return SimulatedCandidate(
        name,
        number(simulated["scores"][name]),
        simulated["falls"][name],
        simulated["tracked"][name],
        {key: number(value) for key, value in simulated["objective_scores"][name].items()},
        fine_tuning(row, simulated["task_rewards"]),
        mean_gain(simulated["predicted"].get(name, {})),
        speeds_predicted(simulated["predicted"].get(name, {})),
    )


def _closing(
    rows: Mapping[str, Mapping[str, Any]], elites: Sequence[str], pretrained: Mapping[str, Any] | None, again: bool
) -> list[str]:
    """What else is to be said about an iteration in which somebody was refused."""
    lines = []
    if rows and not elites:
        end = "" if again else ", so nobody is"
        lines.append(f"the gate refused all {len(rows)} candidates that could be tried{end}")
    if pretrained is not None and not pretrained["passed"]:
        lines.append(
            f"the pretrained policy itself would not pass the gate ({', '.join(pretrained['failed'])}): the gate tries "
            "dynamics or asks limits that this robot's policy was never trained for; see the settings of gate"
        )
    return lines
