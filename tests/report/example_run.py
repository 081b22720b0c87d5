"""A run folder as a finished run leaves it, made in a moment from worlds with known answers: for tests of reports."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hts.config import EvaluationConfig
from hts.config_loading import dump_config, load_config
from hts.contracts import Objective
from hts.evaluation.final import candidate_result, entry_of, head_to_heads, segment_scores
from hts.recordings.recording import Recording
from hts.testing.made_up_recordings import CostObjective, known_head_to_head

SAVINGS = {"0.5": 0.20, "0.8": 0.17, "1.1": 0.13}
"""True saving of the final policy at each commanded speed, m/s."""


def write_example_run(
    folder: Path,
    *,
    world: str = "twin",
    iterations: int = 2,
    objective: Objective | None = None,
    weights: Sequence[float] = (0.5, 1.0, 5.0),
    bounds: Sequence[float] = (0.2, 0.5, 1.0),
    elites: int = 6,
    block_seconds: int = 80,
    seed: int = 0,
) -> dict[str, Any]:
    """Write config.yaml, summary.json, segments.json, provenance.json and iterations/NN/fit.json; returns the summary.

    Head-to-heads are computed from recordings of known worlds by the code that a run uses; the rest is made up to look
    like one. The first iteration has the pretrained policy as its only anchor, later ones the best policy too.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    objective = objective or CostObjective()
    objectives = {objective.name: objective}
    evaluation = EvaluationConfig(bootstrap=500)
    config = load_config(
        preset="quick",
        objectives=[objective.name],
        robot="example",
        world=world,
        seed=seed,
        overrides=[f"iterations={iterations}"],
    )
    rounds = []
    for index in range(1, iterations + 1):
        rounds.append(
            _iteration(folder, index, iterations, objectives, weights, bounds, elites, block_seconds, evaluation, rng)
        )
    recordings = [
        recording
        for speed, saving in SAVINGS.items()
        for recording in _recordings(saving, float(speed), block_seconds, int(rng.integers(1 << 30)))
    ]
    results = head_to_heads(objective, recordings, evaluation, seed)
    summary = {
        "objectives": list(objectives),
        "robot": "example",
        "world": world,
        "preset": "quick",
        "engine": "mujoco",
        "seed": seed,
        "wall_seconds": 554.2,
        "sim_steps": 5_400_000,
        "real_samples": 127_000,
        "iterations": rounds,
        "final": {"policy": rounds[-1]["best"], "objectives": {objective.name: entry_of(objective, results)}},
    }
    (folder / "config.yaml").write_text(dump_config(config), encoding="utf-8")
    _dump(folder / "summary.json", summary)
    _dump(folder / "segments.json", {objective.name: segment_scores(results)})
    _dump(folder / "provenance.json", _provenance(seed))
    return summary


def _iteration(
    folder: Path,
    index: int,
    count: int,
    objectives: dict[str, Objective],
    weights: Sequence[float],
    bounds: Sequence[float],
    elites: int,
    block_seconds: int,
    evaluation: EvaluationConfig,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """One iteration: more weight and a wider bound save more, later iterations too, and some of it is chance."""
    name = next(iter(objectives))
    candidates: list[dict[str, Any]] = []
    savings: dict[str, float] = {}
    for anchor in ("pretrained",) if index == 1 else ("best", "pretrained"):
        for weight in weights:
            for bound in bounds:
                finite = bound if math.isfinite(bound) else 2.4
                saving = 0.16 * (finite / 1.0) ** 0.4 * (weight / 5.0) ** 0.12 * (0.75 + 0.25 * index / count)
                saving += 0.015 * rng.standard_normal() + (0.03 if anchor == "best" else 0.0)
                candidate = f"{index}-{len(candidates):02d}"
                savings[candidate] = saving
                candidates.append(
                    {
                        "id": candidate,
                        "anchor": anchor,
                        "weights": {name: weight},
                        "kl_bound": bound if math.isfinite(bound) else None,
                        "kl": finite * (1 + 0.04 * rng.standard_normal()),
                        "sim_score": -1.0 + 1.5 * saving + 0.02 * rng.standard_normal(),
                        "elite": False,
                        "falls": int(weight == max(weights) and not math.isfinite(bound)),
                        "real": None,
                    }
                )
    ranked = sorted(candidates, key=lambda c: (c["falls"], -c["sim_score"]))[:elites]
    measured = {}
    for elite in ranked:
        elite["elite"] = True
        recordings = _recordings(savings[elite["id"]], 0.8, block_seconds // 2, int(rng.integers(1 << 30)))
        result = candidate_result(elite["id"], objectives, recordings, evaluation)
        elite["real"] = result.entry
        if result.tested is not None:
            measured[elite["id"]] = result.tested.comparisons[name].selection_score
    place = folder / "iterations" / f"{index:02d}"
    place.mkdir(parents=True, exist_ok=True)
    truth = [110.0 * (1 - savings[elite["id"]]) for elite in ranked] if index > 1 else [110.0]
    policies = [
        {"policy": f"policy-{i}", "measured": m, "predicted": m + rng.normal(0, 1.2)} for i, m in enumerate(truth)
    ]
    quality = {"held_out_r2": 0.93 + 0.02 * index, "rank_correlation": None if index == 1 else 0.89}
    held_out = {"policies": policies, "unit": "1", "proxy": {"smoothed": {"r2": 0.71 + 0.02 * index}}}
    _dump(place / "fit.json", {name: {**quality, "target": objectives[name].target.name, "held_out": held_out}})
    return {
        "index": index,
        "best": max(measured, key=lambda key: measured[key]) if measured else None,
        "measurement_models": {name: {"dataset": f"{index:02d}5f0e2c9a7b41d3", **quality}},
        "candidates": candidates,
    }


def _recordings(saving: float, speed: float, block_seconds: int, seed: int) -> list[Recording]:
    reference = 60.0 + 60.0 * speed
    return known_head_to_head(
        reference * (1 - saving),
        reference,
        block_seconds=block_seconds,
        scatter=0.06,
        correlation=0.5,
        drift=3.0,
        idle=30.0,
        seed=seed,
        vx=speed,
    )


def _provenance(seed: int) -> dict[str, Any]:
    return {
        "versions": {"hard-to-sim": "0.1.0", "python": "3.11.9", "torch": "2.13.0", "mujoco": "3.17.1"},
        "commit": "4b1c0de4b1c0de4b1c0de4b1c0de4b1c0de4b1c0",
        "diff": "--- a/hts/run.py\n+++ b/hts/run.py\n@@ -1 +1 @@\n-one\n+two",
        "seeds": {"run": seed},
        "hardware": {"cpu": "2 cores", "memory_gb": 8, "gpu": None},
        "datasets": ["015f0e2c9a7b41d3", "025f0e2c9a7b41d3"],
    }


def _dump(path: Path, value: dict[str, Any]) -> None:
    path.write_text(json.dumps(value, indent=1, allow_nan=False) + "\n", encoding="utf-8")
