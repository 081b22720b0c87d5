"""summary.json: what others read of a run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from hts.evaluation.final import task_entry
from hts.measurement.scoring import spearman
from hts.policy_ids import PRETRAINED
from hts.run import iteration
from hts.run.front import front_entry
from hts.run.job import Job
from hts.run.passed_over import passed_over
from hts.run.task_watch import scale_lines

OF_THE_GATE = (
    *("strict", "checks", "untold", "accepted_untold", "limits"),
    *("proposed", "elites", "kept_out", "first_run", "lines"),
)


def summarise(job: Job) -> dict[str, Any]:
    """The whole run as one JSON object; everything but `wall_seconds` depends on configuration and seed alone."""
    config = job.config
    iterations, steps = [], 0
    learned = config.fits_models
    first = job.read("collect") if config.records_first else {}
    done = job.done_iterations
    for index in range(done):
        fit = job.read("fit", index) if learned else {}
        tuned, simulated = iteration.tuned(job, index), iteration.simulated(job, index)
        tested, gated = job.read("test", index), iteration.gated(job, index)
        steps += tuned["steps"] + simulated["steps"] + (gated["steps"] if gated else 0)
        steps += (tuned.get("pull") or {}).get("steps", 0)  # not in runs from before it was written
        iterations.append(
            {
                "index": index,
                "best": tested["best"],
                "best_so_far": tested["best_so_far"],
                "measurement_models": {
                    key: _model(report, tested["model_checks"].get(key)) for key, report in fit.items()
                },
                **({"trust_region": tested["trust_region"]} if "trust_region" in tested else {}),
                "pretrained_sim_scores": (simulated.get("objective_scores") or {}).get(PRETRAINED, {}),
                **({"measured_best": job.read("best", index)} if config.evaluation.each_iteration else {}),
                **_with_gate(_task(tuned, simulated), gated),
                **({} if (over := passed_over(job, index)) is None else {"passed_over": over}),
                "candidates": [_candidate(row, simulated, tested, gated) for row in tuned["candidates"]],
            }
        )
    again = job.read("confirm") if config.selection.confirm else None
    samples = job.spent(done) + (again["samples"] if again else 0)
    final = job.read("final")
    checks = [job.read("test", index)["model_checks"] for index in range(done)]
    ranks = (
        {name: pooled_ranks([check[name] for check in checks if name in check]) for name in job.objectives}
        if learned
        else {}
    )
    return {
        "objectives": list(config.objectives),
        "robot": config.robot.name,
        "task": task_entry(job.robot.task()),
        "world": config.world.name,
        "world_simulated": job.world.simulated,
        "world_identity": dict(job.world.identity()),
        "preset": config.preset,
        "engine": config.engine,
        "seed": config.seed,
        "reward_source": config.reward_source,
        **({"note": job.note} if job.note else {}),
        "wall_seconds": round(sum(job.stages.seconds().values()), 1),
        "sim_steps": steps,
        "real_samples": samples + final["samples"],
        "real_samples_before_final": samples,
        "first_data_falls": first.get("falls"),
        "max_real_samples": config.max_real_samples,
        "iterations_asked": config.iterations,
        "iterations": iterations,
        "measurement_models": ranks,
        "front": front_entry(job, fell_later(again, final)),
        **({"confirmation": {key: again[key] for key in ("tried", "results", "best")}} if again else {}),
        "final": {
            "policy": final["policy"],
            "objectives": final["objectives"],
            **({"given_up": final["given_up"]} if final.get("given_up") else {}),
        },
    }


def fell_later(again: Mapping[str, Any] | None, final: Mapping[str, Any]) -> set[str]:
    """Policies that fell after the trials of their iteration: in the stage `confirm` (None: there was none) or in a
    final."""
    rows = again["results"] if again else {}
    second = {name for name, row in rows.items() if (row.get("tested") or {}).get("fell") or row.get("refused_falls")}
    given_up = {one["policy"] for one in final.get("given_up") or () if one["falls"]}
    ways = [way for entry in final["objectives"].values() for way in (entry, entry.get("open_loop") or {})]
    fell = any(way.get("refused_falls") or any(row["falls"] for row in way.get("speeds", {}).values()) for way in ways)
    return second | given_up | ({final["policy"]} if fell else set())


def pooled_ranks(checks: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Rank correlation of predicted and measured cost over everything tried in all iterations, elites and reference.

    checks: one `measurement.checks.check` per iteration, of that iteration's own model; the analytic stand-ins in it
    were fitted to the same data. So predictions of different fits stand side by side, as in the paper's comparison of
    proxies: a model whose level moves from fit to fit is worth less. None where there is only one policy. An iteration
    whose costs are of another speed than most (there more policies kept it, or it was walked longer) is left out: that
    walking faster costs more is no news.
    """
    usual = _usual_speed(checks)

    def rank(found: Sequence[Mapping[str, Any]]) -> float | None:
        rows = [row for check in found for row in check["policies"] if row["speed"] == usual]
        return spearman([row["measured"] for row in rows], [row["predicted"] for row in rows])

    proxies = [check.get("proxy") or {} for check in checks]
    names = dict.fromkeys(name for proxy in proxies for name in proxy)
    return {
        "policies": sum(row["speed"] == usual for check in checks for row in check["policies"]),
        "rank_correlation": rank(checks),
        "proxy_rank_correlation": {name: rank([proxy[name] for proxy in proxies if name in proxy]) for name in names},
    }


def _usual_speed(checks: Sequence[Mapping[str, Any]]) -> float | None:
    """The commanded speed (or set-point) that most rows of these checks are of; of equals the slowest."""
    counts = Counter(row["speed"] for check in checks for row in check["policies"])
    return min(counts, key=lambda speed: (-counts[speed], speed), default=None)


def _model(report: dict[str, Any], checked: dict[str, Any] | None) -> dict[str, Any]:
    """held_out_r2: on recordings kept from the fit; same_session, where any of these are of a session that was fitted
    to as well: how many, of how many; elites_r2 and rank_correlation: over all recordings of the trials,
    of elites, which the model had not seen, and of the reference beside them, which it had."""
    checked = checked or {}
    return {
        "dataset": report["dataset"],
        "held_out_r2": report["held_out_r2"],
        **({"same_session": shared} if (shared := report.get("same_session", {})).get("held_out") else {}),
        "rank_correlation": checked.get("rank_correlation", report["rank_correlation"]),
        "elites_r2": checked.get("r2"),
        "proxy_held_out_r2": report["held_out"].get("proxy"),
        "proxy_elites": checked.get("proxy"),
    }


def _task(tuned: Mapping[str, Any], simulated: Mapping[str, Any]) -> dict[str, Any]:
    """What became of the task in an iteration; nothing of runs from before it was written down."""
    if "task_rewards" not in simulated:
        return {}
    scale, left = tuned.get("reward_scale") or {}, simulated.get("gave_up") or {}
    lines = [*([] if tuned.get("held") else scale_lines(scale, tuned["candidates"])), left.get("line")]
    return {
        "pretrained_task_reward": simulated["task_rewards"].get(PRETRAINED),
        "reward_scale": scale,
        "gave_up": left.get("elites") or [],
        "warnings": [line for line in lines if line],
    }


def _with_gate(task: Mapping[str, Any], gated: Mapping[str, Any] | None) -> dict[str, Any]:
    """What became of the task, and of the candidates at the gate; nothing of a run without one."""
    if gated is None:
        return dict(task)
    told = {key: gated[key] for key in OF_THE_GATE}
    refused = [name for name, row in gated["policies"].items() if not row["passed"]]
    return {**task, "warnings": [*task.get("warnings", ()), *gated["lines"]], "gate": {**told, "refused": refused}}


def _candidate(
    row: dict[str, Any], simulated: dict[str, Any], tested: dict[str, Any], gated: Mapping[str, Any] | None
) -> dict[str, Any]:
    name = row["id"]
    result = tested["results"].get(name, {})
    entry = {
        "id": name,
        "anchor": row["anchor"],
        "weights": row["weights"],
        "kl_bound": row["kl_bound"],
        "kl": row["kl"],
        "std": row["std"],
        "anchor_std": row["anchor_std"],
        "sim_score": simulated["scores"][name],
        "sim_scores": (simulated.get("objective_scores") or {}).get(name, {}),
        "tracked": simulated["tracked"][name],
        "elite": name in tested["elites"],
        "falls": simulated["falls"][name],
        **({"way": row["way"]} if "way" in row else {}),
        "real": result.get("real"),
    }
    if result.get("tested"):
        entry["selection_scores"], entry["fell"] = result["tested"]["selection_score"], result["tested"]["fell"]
    if result.get("refused"):
        entry["refused"] = result["refused"]
        entry["refusal"] = result.get("refusal")  # none where the reference is why, and in runs from before it
        if result.get("refused_falls"):
            entry["refused_falls"] = result["refused_falls"]
    if "task_rewards" in simulated:
        entry["task_reward"] = simulated["task_rewards"].get(name)
    if "predicted" in simulated:  # not in runs from before it was written
        entry["predicted"] = simulated["predicted"].get(name, {})
    if gated is not None:
        found = gated["policies"].get(name)  # who was not asked for was not tried
        entry["gate"] = found and {key: found[key] for key in ("passed", "failed", "refused", "worst")}
    if row["stopped"]:
        entry["stopped"] = row["stopped"]
    return entry
