"""Measurement models on the same recordings and the same split: how well they predict, what they cost.

    python benchmarks/measurement_models.py --run DIR --objective power
    python benchmarks/measurement_models.py --data walks.zarr --objective power --epochs 20 --splits 3
    python benchmarks/measurement_models.py --run DIR --objective power --model linear --model '{name: ensemble,
    members: 3}'

Without --model: `linear`, the objective's own model, and `ensemble` of it. Prints a table and then JSON, for each model
and split: held-out R², R² on policies that were not seen, rank correlation across policies, how honest the ensemble's
spread is (shares of errors within 1 and 2 standard deviations, of samples and of policies' means; of a Gaussian 0.68
and 0.95), seconds of fitting, and microseconds of a control step of `--worlds` worlds, as collection on a CPU does it
(24 steps at once) and one at a time.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path
from typing import Any

import torch
import yaml
from output import give

from hts.config import MeasurementConfig
from hts.config_loading import read_config
from hts.contracts import MODEL, Objective, chosen_model
from hts.cores import available
from hts.layers import with_named_model
from hts.measurement.data import input_tensor
from hts.measurement.fit_command import fit_and_check
from hts.measurement.transform import MeasurementTransform
from hts.plugins import Registry, load
from hts.recordings.recording import Recording
from hts.recordings.store import RecordingStore

STEPS = 24  # control steps of a batch
ROLES_KEPT = ("collection", "reference")  # of policies that a run never holds out whole


def recordings_of(store: RecordingStore, objective: Objective) -> list[Recording]:
    """All that have the objective's channels."""
    wanted = (*objective.inputs, objective.target.name)
    usable = [name for name in store.ids() if set(wanted) <= set(store.attributes(name)["arrays"])]
    return [store.read(name, wanted) for name in usable]


def step_cost(
    transform: MeasurementTransform, recordings: list[Recording], worlds: int, repeats: int
) -> dict[str, float]:
    """Microseconds of a control step of that many worlds on one core, median over repeats."""
    model = transform.model
    data = torch.cat([input_tensor(model.signals, one) for one in recordings])
    places = torch.randint(len(data), (STEPS, worlds), generator=torch.Generator().manual_seed(0))
    kept, ended = data[places], torch.zeros(STEPS, worlds, dtype=torch.bool)
    ended[STEPS // 2, :: max(1, worlds // 4)] = True
    transform.prepare(worlds, torch.device("cpu"))
    state = model.initial_state(worlds)
    together, single = [], []
    for _ in range(repeats):
        start = time.perf_counter()
        transform.forward_sequence(kept, ended)
        middle = time.perf_counter()
        for inputs in kept:
            _, state = model.step(inputs, state)
        together.append((middle - start) / STEPS)
        single.append((time.perf_counter() - middle) / STEPS)
    return {"step_us": 1e6 * statistics.median(together), "single_step_us": 1e6 * statistics.median(single)}


def measured(
    registry: Registry,
    objective: Objective,
    settings: dict[str, Any],
    recordings: list[Recording],
    config: MeasurementConfig,
    worlds: int,
    repeats: int,
) -> dict[str, Any]:
    """One model on one split."""
    keep = {one.policy_hash for one in recordings if one.role in ROLES_KEPT}
    start = time.perf_counter()
    fitted = fit_and_check(objective, recordings, config, settings=settings, registry=registry, keep=keep)
    whole, held = time.perf_counter() - start, fitted.report["held_out"]
    spread = held["spread"]
    torch.set_num_threads(1)
    return {
        "model": fitted.report["model"],
        "split_seed": config.seed,
        "r2": held["r2"],
        "r2_policies": held["r2_policies"],
        "rmse": held["rmse"],
        "unit": held["unit"],
        "rank_correlation": held["rank_correlation"],
        "policies": len(held["policies"]),
        "samples": held["samples"],
        "spread": spread and {key: value for key, value in spread.items() if key != "policies"},
        "fit_seconds": fitted.report["fit"]["seconds"],
        "fit_and_check_seconds": whole,
        "linear_r2": held["linear"]["r2"],
        "proxy_r2": (held["proxy"] or {}).get("smoothed", {}).get("r2"),
        **step_cost(MeasurementTransform.of(objective, fitted.model), recordings, worlds, repeats),
    }


def line(row: dict[str, Any]) -> str:
    """One model on one split, for a person."""

    def number(value: float | None) -> str:
        return "    –" if value is None else f"{value:5.3f}"

    spread = row["spread"] or {}
    cells = [number(row[key]) for key in ("r2", "r2_policies", "rank_correlation")]
    cells += [number(spread.get(key)) for key in ("within_1", "within_2", "policies_within_1", "policies_within_2")]
    return (
        f"{row['model']['name']:<18} {row['split_seed']:>5}  {'  '.join(cells)}"
        f"  {row['fit_seconds']:7.1f} s  {row['step_us']:7.0f} µs  {row['single_step_us']:7.0f} µs"
    )


HEAD = f"{'model':<18} split     R²  new p.   rank  in 1 s  in 2 s  pol. 1  pol. 2   fitting      a step   one alone"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--run", type=Path, help="folder of a finished run: its recordings, settings and epochs")
    source.add_argument("--data", type=Path, help="a store of recordings")
    parser.add_argument("--objective", required=True)
    parser.add_argument("--model", action="append", default=[], help="name, or YAML of name and settings; repeatable")
    parser.add_argument("--epochs", type=int, help="default: the run's, or 20")
    parser.add_argument("--splits", type=int, default=1, help="how many splits, seeds 0, 1, …")
    parser.add_argument("--worlds", type=int, default=384)
    parser.add_argument("--repeats", type=int, default=30, help="of the timing of steps")
    parser.add_argument("--out", type=Path, help="also write the JSON there")
    given = parser.parse_args()

    registry = load()
    run = read_config(given.run / "config.yaml") if given.run else None
    settings = dict(run.objectives[given.objective]) if run else {}
    objective = registry.make_objective(given.objective, settings)
    config = run.measurement if run else MeasurementConfig()
    config = config.model_copy(update={"epochs": given.epochs} if given.epochs else {})
    recordings = recordings_of(RecordingStore(given.run / "data.zarr" if given.run else given.data), objective)
    own = chosen_model(objective)
    models = [yaml.safe_load(text) for text in given.model] or [
        "linear",
        {"name": own.name, **own.settings},
        "ensemble",
    ]

    print(HEAD)
    rows = []
    for seed in range(given.splits):
        for model in models:
            chosen = with_named_model({**settings, MODEL: model})
            split = config.model_copy(update={"seed": seed})
            row = measured(registry, objective, chosen, recordings, split, given.worlds, given.repeats)
            print(line(row), flush=True)
            rows.append(row)
    give(
        {
            "benchmark": "measurement_models",
            "objective": given.objective,
            "recordings": len(recordings),
            "policies": len({one.policy_hash for one in recordings}),
            "samples": sum(one.num_samples for one in recordings),
            "epochs": config.epochs,
            "worlds": given.worlds,
            "cores": available(),
            "torch": str(torch.__version__),
            "rows": rows,
        },
        given.out,
    )


if __name__ == "__main__":
    main()
