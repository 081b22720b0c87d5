"""From a finished run folder to its line: all that tables need, since folders are deleted."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from batch.lines import CONFIRM, Doubt, Figures, GivenUp, Model, Outcome, Pair, Point, Result, Tried
from hts.config_loading import read_config
from hts.errors import RunError

KEPT = ("hard-to-sim", "torch", "torchrl", "tensordict", "mujoco", "mujoco-warp", "warp-lang", "numpy", "scipy")

Json = dict[str, Any]


def finished(folder: Path) -> bool:
    """Whether nothing of the run is left to be done."""
    return (folder / "summary.json").exists() and (folder / "report.html").exists()


def result_of(folder: Path) -> Result:
    """What the finished run in `folder` came to. Raises RunError for a folder that is not one."""
    summary, config = _json(folder / "summary.json"), read_config(folder / "config.yaml")
    tests = [_json(folder / f"iterations/{row['index']:02d}/test.json") for row in summary["iterations"]]
    rows = {row["id"]: (entry["index"], row) for entry in summary["iterations"] for row in entry["candidates"]}
    gates = _gates(folder, len(tests))
    again = (summary.get("confirmation") or {}).get("results") or {}
    tried = [
        _tried(index, row, gates.get(name), again.get(name)) for name, (index, row) in rows.items() if row["elite"]
    ]
    samples = _samples(folder, len(tests), summary["real_samples"])
    final = summary["final"]
    return Result(
        final_policy=final["policy"],
        asked_speeds=list(config.evaluation.speeds),
        objectives={name: _outcome(entry) for name, entry in final["objectives"].items()},
        given_up=[GivenUp(**one) for one in final.get("given_up", ())],
        best=_tried(*rows[final["policy"]], gates.get(final["policy"]), again.get(final["policy"]))
        if final["policy"] in rows
        else None,
        tried=tried,
        candidates=len(rows),
        stopped_candidates=sum("stopped" in row for _, row in rows.values()),
        models=[
            _model(entry["index"], name, found, test["model_checks"].get(name) or {})
            for entry, test in zip(summary["iterations"], tests, strict=True)
            for name, found in entry["measurement_models"].items()
        ],
        pooled_rank={name: found["rank_correlation"] for name, found in summary["measurement_models"].items()},
        curve=_curve(summary, rows, samples),
        max_real_samples=summary.get("max_real_samples"),
        first_data_falls=summary.get("first_data_falls"),
        real_samples=samples,
        sim_steps=summary["sim_steps"],
        seconds={**_json(folder / "log/stages.json"), "total": summary["wall_seconds"]},
        note=summary.get("note"),
    )


def provenance_of(folder: Path) -> tuple[dict[str, str], Json]:
    """Versions of what matters, and the hardware; empty where the run did not come so far."""
    path = folder / "provenance.json"
    if not path.exists():
        return {}, {}
    found = _json(path)
    versions = {name: version for name, version in found["packages"].items() if name.startswith(KEPT)}
    return {"python": found["python"], **versions}, found["hardware"]


def _outcome(entry: Json) -> Outcome:
    """Speeds that stand beside `open_loop` were held; without it, nothing was."""
    beside = entry.get("open_loop")
    speeds, refused, refused_falls = _figures(entry["speeds"]), _refused(entry), entry.get("refused_falls") or {}
    if beside is None:
        return Outcome(unit=entry["unit"], open_loop=speeds, refused=refused, refused_falls=refused_falls)
    opened = _figures(beside["speeds"])
    return Outcome(
        unit=entry["unit"],
        held=speeds,
        open_loop=opened,
        refused=refused,
        refused_falls=refused_falls,
        refused_open_loop=_refused(beside),
        refused_falls_open_loop=beside.get("refused_falls") or {},
    )


def _figures(speeds: Json) -> dict[str, Figures]:
    known = set(Figures.model_fields)
    return {
        speed: Figures(
            **{key: value for key, value in row.items() if key in known},
            reference_falls=row.get("reference", {}).get("falls"),
            reference_speed=row.get("reference", {}).get("mean_speed"),
        )
        for speed, row in speeds.items()
    }


def _refused(entry: Json) -> dict[str, str]:
    return {speed: str(why) for speed, why in (entry.get("refused") or {}).items()}


def _gates(folder: Path, iterations: int) -> dict[str, bool]:
    """Candidate -> whether it passed the gate, of those that were asked."""
    found = []
    for index in range(iterations):
        gate, nearer = (folder / f"iterations/{index:02d}/{stage}.json" for stage in ("gate", "nearer"))
        found += [_json(gate)["policies"]] if gate.exists() else []
        found += [_json(nearer)["gate"]["policies"]] if nearer.exists() else []
    return {name: row["passed"] for policies in found for name, row in policies.items()}


def _falls(row: Json) -> int:
    """Of a trial, at refused speeds too; objectives look at the same recordings."""
    found = [sum(one["falls"] for one in speeds.values()) for speeds in (row["real"] or {}).values()]
    return max(found, default=0) + sum((row.get("refused_falls") or {}).values())


def _tried(iteration: int, row: Json, gate: bool | None = None, again: Json | None = None) -> Tried:
    real, falls = row["real"] or {}, _falls(row)
    predicted, spread = _predicted(row.get("predicted"))
    return Tried(
        id=row["id"],
        iteration=iteration,
        anchor=row["anchor"],
        weights=row["weights"],
        kl_bound=row["kl_bound"],
        kl=row["kl"],
        std_ratio=row["std"] / row["anchor_std"] if row.get("anchor_std") else None,
        sim_score=row["sim_score"],
        sim_falls=row["falls"],
        predicted=predicted,
        predicted_sd=spread,
        measured={name: {key: one["improvement"] for key, one in found.items()} for name, found in real.items()},
        falls=falls,
        falls_again=None if again is None else _falls(again),
        fell=bool(row.get("fell") or falls),
        refused=bool(row.get("refused")),
        why=row.get("refused") or None,
        gate=gate,
    )


def _predicted(found: Any) -> tuple[dict[str, dict[str, float]] | None, dict[str, dict[str, float]] | None]:
    """Predicted improvement and its standard deviation, objective -> speed; an entry is a number or has both."""
    if not isinstance(found, Mapping):
        return None, None
    values: dict[str, dict[str, float]] = {}
    spread: dict[str, dict[str, float]] = {}
    for name, speeds in found.items():
        for speed, one in (speeds or {}).items():
            number = one.get("improvement") if isinstance(one, Mapping) else one
            if number is not None:
                values.setdefault(name, {})[speed] = float(number)
            if isinstance(one, Mapping) and one.get("sd") is not None:
                spread.setdefault(name, {})[speed] = float(one["sd"])
    return values or None, spread or None


def _model(iteration: int, name: str, found: Json, check: Json) -> Model:
    return Model(
        iteration=iteration,
        objective=name,
        held_out_r2=found["held_out_r2"],
        elites_r2=found.get("elites_r2"),
        rank_correlation=found["rank_correlation"],
        proxy_rank_correlation={
            kind: one.get("rank_correlation") for kind, one in (found.get("proxy_elites") or {}).items()
        },
        pairs=[
            Pair(
                policy=row["policy"][:12],
                speed=row.get("speed"),
                measured=row["measured"],
                predicted=row["predicted"],
            )
            for row in check.get("policies", [])
        ],
        doubts=[
            Doubt(policy=row["policy"][:12], error=row["error"], spread=row["spread"])
            for row in (check.get("spread") or {}).get("policies", [])
        ],
    )


def _samples(folder: Path, iterations: int, total: int) -> dict[str, int]:
    """Real samples of each stage: its `samples`, and what else it counts under a name that ends in `_samples`."""
    found: dict[str, int] = {}
    for stage in ("collect", *(f"iterations/{index:02d}/test" for index in range(iterations)), CONFIRM, "final"):
        path = folder / f"{stage}.json"
        entry = _json(path) if path.exists() else {}  # a baseline collects nothing, not every run confirms its best
        if "samples" in entry:
            found[stage] = entry["samples"]
        found |= {f"{stage}:{key[:-8]}": value for key, value in entry.items() if key.endswith("_samples")}
    return {**found, "total": total}


def _curve(summary: Json, rows: Mapping[str, tuple[int, Json]], samples: Mapping[str, int]) -> list[Point]:
    """The best so far after each iteration, as it was measured when it was tried (flattering, since it was chosen), and
    like the final where the run did that."""
    points, spent = [], samples.get("collect", 0)
    for entry in summary["iterations"]:
        spent += samples.get(f"iterations/{entry['index']:02d}/test", 0)
        best = entry["best_so_far"]
        measured = _tried(*rows[best]).measured if best in rows else {}
        final = _measured_like_the_final(entry.get("measured_best"))
        points.append(Point(iteration=entry["index"], samples=spent, best=best, improvement=measured, final=final))
    return points


def _measured_like_the_final(found: Json | None) -> dict[str, dict[str, float]] | None:
    """Objective -> speed -> improvement, a refused speed 0; None where it was not measured so."""
    if found is None:
        return None
    return {
        name: {
            **{speed: one["improvement"] for speed, one in entry["speeds"].items()},
            **dict.fromkeys(entry["refused"], 0.0),
        }
        for name, entry in found["objectives"].items()
    }


def _json(path: Path) -> Json:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RunError(f"{path}: {error}. Expected a finished run's file. Delete its folder and run again.") from error
