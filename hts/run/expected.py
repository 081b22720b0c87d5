"""What saving to expect on a robot that has not been fine-tuned for: whole runs on realities that agree with its logs.

Each run is an ordinary one in a folder of its own, so it goes on where it was stopped, and a finished one is not done
again. The interval is for one more run on one more such machine, noise of its own final included:

    m ± t_{n-1} s √(1 + 1/n)        m, s: mean and standard deviation over n realities

Where draws weigh differently, m and s are weighted and n is what the weights are worth, 1 / Σ w² (Kish 1965).

It supposes that the lab's robot is one of the machines that were drawn. Where their structures leave something out that
the robot has, it promises too much certainty: compare afterwards (`compared`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hts.config import RunConfig
from hts.config_loading import dump_config
from hts.errors import RunError
from hts.plugins import load
from hts.policy_ids import PRETRAINED
from hts.quantiles import student_quantile, weighted_quantiles
from hts.report import wording
from hts.run import resume_run, start_run, with_engine
from hts.run.stage_files import read_stage
from hts.run.stages import write_json
from hts.whole_paths import with_whole_paths

FORMAT = 1  # of expected.json
FILE = "expected.json"
LEVEL = 0.95
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)

Run = Callable[[RunConfig, Path], None]


def run_once(config: RunConfig, folder: Path) -> None:
    """Begin a run, or go on with it; nothing where it is finished."""
    if (folder / "summary.json").exists():
        return
    if (folder / "config.yaml").exists():
        resume_run(folder)
    else:
        start_run(config, folder)


def expect(
    configs: Mapping[str, RunConfig],
    out: Path,
    tell: Callable[[str], None],
    run: Run = run_once,
    weights: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Do the runs that are not done, one after the other, and write OUT/expected.json.

    configs: name of a reality -> the run on it, in OUT/NAME; weights: of the realities, alike if
    there are none. Raises RunError for a folder of another run.
    """
    rows = []
    for number, (name, given) in enumerate(configs.items()):
        folder, config = out / name, with_engine(given)
        _check_same(folder, config)
        done = "finished earlier" if (folder / "summary.json").exists() else "running"
        tell(f"{name} ({number + 1} of {len(configs)}): {done}, {folder}")
        run(config, folder)
        row = _row(name, read_stage(folder / "summary.json"), config)
        rows.append({**row, "weight": weights[name]} if weights else row)
    result = {"format": FORMAT, "preset": next(iter(configs.values())).preset, "runs": rows, "expected": pooled(rows)}
    write_json(out / FILE, result)
    return result


def _check_same(folder: Path, config: RunConfig) -> None:
    file = folder / "config.yaml"
    if not file.exists():
        return
    asked = (config, with_whole_paths(config, load()))  # runs of before kept relative paths as they were given
    if file.read_text(encoding="utf-8") not in map(dump_config, asked):
        raise RunError(
            f"{folder}: holds a run with other settings than are asked for now. Choose another --out, or ask for the "
            "same preset, objectives, seed and settings."
        )


def _row(name: str, summary: Mapping[str, Any], config: RunConfig) -> dict[str, Any]:
    """What a run saved: objective -> {"unit", "speeds": speed -> improvement, or null where it was refused}."""
    final, identity = summary["final"], summary.get("world_identity") or {}
    keys = [f"{speed:g}" for speed in config.evaluation.speeds]
    objectives = {}
    for objective, unit in summary["front"]["units"].items():
        if final["policy"] == PRETRAINED:  # nobody was better: nothing is saved
            speeds: dict[str, float | None] = dict.fromkeys(keys, 0.0)
        else:
            found = final["objectives"][objective]["speeds"]
            by_value = {float(key): one["improvement"] for key, one in found.items()}
            speeds = {key: by_value.get(float(key)) for key in keys}
        objectives[objective] = {"unit": unit, "speeds": speeds}
    return {
        "reality": name,
        "sha256": identity.get("reality_sha256"),
        "policy": final["policy"],
        "real_samples": summary["real_samples"],
        "objectives": objectives,
    }


def pooled(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Objective -> unit and, per speed, what to expect of one more run on one more such machine."""
    result = {}
    for objective, first in rows[0]["objectives"].items():
        speeds = {}
        for key in first["speeds"]:
            values = [row["objectives"][objective]["speeds"][key] for row in rows]
            there = [
                (value, row.get("weight", 1.0)) for value, row in zip(values, rows, strict=True) if value is not None
            ]
            speeds[key] = prediction([value for value, _ in there], [weight for _, weight in there]) | {
                "refused": len(values) - len(there)
            }
        result[objective] = {"unit": first["unit"], "speeds": speeds}
    return result


def prediction(values: Sequence[float], weights: Sequence[float] | None = None) -> dict[str, Any]:
    """Mean, interval of the next value, and quantiles.

    One value, or what is worth no more, has no interval (null), and no value has no mean.
    """
    count = len(values)
    if not count:
        return {"runs": 0, "worth": 0.0, "mean": None, "interval95": None, "quantiles": {}}
    found = np.asarray(values, dtype=float)
    share = np.ones(count) if weights is None else np.asarray(weights, dtype=float)
    share = share / share.sum()
    worth, mean = float(1 / np.square(share).sum()), float(share @ found)
    interval = None
    if worth > 1 + 1e-9:
        spread = math.sqrt(float(share @ np.square(found - mean)) * worth / (worth - 1))
        wide = student_quantile((1 + LEVEL) / 2, worth - 1) * spread * math.sqrt(1 + 1 / worth)
        interval = [mean - wide, mean + wide]
    quantiles = {f"{q:g}": _quantile(found, share, q) for q in QUANTILES}
    return {"runs": count, "worth": worth, "mean": mean, "interval95": interval, "quantiles": quantiles}


def _quantile(values: np.ndarray, share: np.ndarray, q: float) -> float:
    """Of values with equal shares numpy's own; else where the cumulated share, from the middle of each, passes q."""
    if np.allclose(share, share[0]):
        return float(np.quantile(values, q))
    return float(weighted_quantiles(values, share, [q])[0])


def compared(expected: Mapping[str, Any], summary: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Predicted against measured, one row per objective and speed. summary: of a run on the robot itself.

    Raises RunError if the two have no objective or no speed in common.
    """
    final, rows = summary["final"], []
    for objective, told in expected["expected"].items():
        found = ((final.get("objectives") or {}).get(objective) or {}).get("speeds") or {}
        measured = {float(key): one for key, one in found.items()}
        for key, one in told["speeds"].items():
            if final["policy"] == PRETRAINED and objective in summary["objectives"]:
                value, interval = 0.0, None
            elif float(key) in measured:
                value, interval = measured[float(key)]["improvement"], measured[float(key)].get("improvement_ci95")
            else:
                continue
            bounds = one["interval95"]
            rows.append(
                {
                    "objective": objective,
                    "unit": told["unit"],
                    "speed": key,
                    "predicted": one["mean"],
                    "interval95": one["interval95"],
                    "measured": value,
                    "measured_ci95": interval,
                    "error": value - one["mean"] if one["runs"] else None,
                    "inside": None if bounds is None else bounds[0] <= value <= bounds[1],
                }
            )
    if not rows:
        raise RunError(
            "Nothing to compare: the run measured no objective at a speed that was predicted "
            f"({', '.join(expected['expected'])})."
        )
    return rows


def shown(result: Mapping[str, Any]) -> list[str]:
    """What to expect, one line per objective and speed."""
    lines = [f"Expected of one more run (`{result['preset']}`) on one more such machine, simulated; 95 % interval:"]
    for objective, told in result["expected"].items():
        for speed, one in told["speeds"].items():
            mean = wording.quantity(one["mean"], told["unit"]) if one["runs"] else "unknown"
            refused = f"; refused in {one['refused']}" if one["refused"] else ""
            interval = wording.interval(one["interval95"], told["unit"])
            lines.append(f"  {objective} at {speed} m/s: {mean}, {interval}, from {one['runs']} runs{refused}")
    return lines


def shown_compared(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Predicted against measured, one line each; nothing without rows."""
    lines = ["Measured afterwards:"] if rows else []
    for row in rows:
        unit = row["unit"]
        where = {True: "inside the interval", False: "OUTSIDE the interval", None: "no interval"}[row["inside"]]
        lines.append(
            f"  {row['objective']} at {row['speed']} m/s: {wording.quantity(row['measured'], unit)} measured, "
            f"{wording.quantity(row['predicted'], unit)} predicted: {where}"
        )
    return lines
