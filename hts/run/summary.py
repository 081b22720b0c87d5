"""summary.json: what others read of a run."""

from __future__ import annotations

from typing import Any

from hts.run.job import Job


def summarise(job: Job) -> dict[str, Any]:
    """The whole run as one JSON object; everything but `wall_seconds` depends on configuration and seed alone."""
    config = job.config
    iterations, steps, samples = [], 0, 0
    learned = config.reward_source == "model"
    if learned:
        samples += job.read("collect")["samples"]
    for index in range(config.iterations):
        name = f"iterations/{index:02d}"
        fit = job.read(f"{name}/fit") if learned else {}
        tuned, simulated, tested = (job.read(f"{name}/{stage}") for stage in ("finetune", "simulate", "test"))
        steps += tuned["steps"] + simulated["steps"]
        samples += tested["samples"]
        iterations.append(
            {
                "index": index, "best": tested["best"], "best_so_far": tested["best_so_far"],
                "measurement_models": {key: _model(report, tested["model_checks"].get(key)) for key, report in fit.items()},
                "candidates": [_candidate(row, simulated, tested) for row in tuned["candidates"]],
            }
        )  # fmt: skip
    final = job.read("final")
    return {
        "objectives": list(config.objectives), "robot": config.robot.name, "world": config.world.name,
        "preset": config.preset, "engine": config.engine, "seed": config.seed, "reward_source": config.reward_source,
        "wall_seconds": round(sum(job.stages.seconds().values()), 1), "sim_steps": steps,
        "real_samples": samples + final["samples"], "iterations": iterations,
        "final": {"policy": final["policy"], "objectives": final["objectives"]},
    }  # fmt: skip


def _model(report: dict[str, Any], checked: dict[str, Any] | None) -> dict[str, Any]:
    """held_out_r2: on recordings kept from the fit; rank_correlation: over the policies tried after it (never seen)."""
    checked = checked or {}
    proxy, tried = report["held_out"].get("proxy"), checked.get("proxy")
    return {
        "dataset": report["dataset"], "held_out_r2": report["held_out_r2"],
        "rank_correlation": checked.get("rank_correlation", report["rank_correlation"]), "elites_r2": checked.get("r2"),
        "proxy_held_out_r2": proxy, "proxy_elites": tried,
    }  # fmt: skip


def _candidate(row: dict[str, Any], simulated: dict[str, Any], tested: dict[str, Any]) -> dict[str, Any]:
    name = row["id"]
    result = tested["results"].get(name, {})
    entry = {
        "id": name, "anchor": row["anchor"], "weights": row["weights"], "kl_bound": row["kl_bound"], "kl": row["kl"],
        "std": row["std"], "anchor_std": row["anchor_std"], "sim_score": simulated["scores"][name],
        "elite": name in tested["elites"], "falls": simulated["falls"][name], "real": result.get("real"),
    }  # fmt: skip
    if result.get("refused"):
        entry["refused"] = result["refused"]
    if row["stopped"]:
        entry["stopped"] = row["stopped"]
    return entry
