"""A command line that behaves like `hts run` and `hts resume`, in a second: for tests of the queue.

`FAKE_HTS` names a folder: what was typed is noted in its typed.txt, stages take FAKE_SECONDS, and the run of a seed
does not end while there is a file hold-SEED. Seed 13 fails.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

from hts.atomic import atomic_write
from hts.config_loading import dump_config, load_config

STAGES = ("collect", "iterations/00/test", "final", "log/stages", "summary")


def files(seed: int) -> dict[str, dict]:
    """Of a run with one candidate, which saved 20 % and some."""
    real = {
        "improvement": 0.2 + seed / 100,
        "improvement_ci95": [0.19, 0.21],
        "segments": 100,
        "valid": 1.0,
        "falls": 0,
        "mean_speed": 0.79,
        "metrics": {"net_reduction": 0.2},
        "reference": {"segments": 100, "valid": 1.0, "falls": 1, "mean_speed": 0.8},
    }
    candidate = {
        "id": "00-00",
        "anchor": "pretrained",
        "weights": {"power": 1.0},
        "kl_bound": None,
        "kl": 3.0,
        "std": 0.1,
        "anchor_std": 0.2,
        "sim_score": 1.0,
        "elite": True,
        "falls": 0,
        "predicted": {"power": {"0.8": {"improvement": 0.25, "sd": 0.02}}},
        "real": {"power": {"0.8": real}},
    }
    model = {"held_out_r2": 0.9, "elites_r2": 0.8, "rank_correlation": None, "proxy_elites": None}
    check = {
        "policies": [{"policy": "a" * 64, "speed": 0.8, "measured": 5.0, "predicted": 5.1, "samples": 9}],
        "spread": {"policies": [{"policy": "a" * 64, "error": 0.1, "spread": 0.2}]},
    }
    best = {"policy": "00-00", "objectives": {"power": {"speeds": {"0.8": real}, "refused": {"1.1": "too slow"}}}}
    summary = {
        "iterations": [
            {
                "index": 0,
                "best_so_far": "00-00",
                "measured_best": best,
                "measurement_models": {"power": model},
                "candidates": [candidate],
            }
        ],
        "measurement_models": {"power": {"rank_correlation": None}},
        "final": {
            "policy": "00-00",
            "objectives": {
                "power": {"unit": "1", "speeds": {"0.8": real}, "open_loop": {"speeds": {"0.8": {**real, "falls": 2}}}}
            },
        },
        "real_samples": 600,
        "max_real_samples": 900,
        "sim_steps": 7,
        "wall_seconds": 1.5,
    }
    return {
        "collect": {"samples": 100},
        "iterations/00/test": {"samples": 200, "trim_samples": 50, "model_checks": {"power": check}},
        "final": {"samples": 300},
        "log/stages": {"collect": 1.0},
        "summary": summary,
    }


def main() -> int:
    """Stage by stage, each file once."""
    place, typed = Path(os.environ["FAKE_HTS"]), sys.argv[1:]
    with (place / "typed.txt").open("a") as file:
        file.write(
            " ".join([str(len(os.sched_getaffinity(0))), os.environ.get("CUDA_VISIBLE_DEVICES", "-"), *typed]) + "\n"
        )
    folder = Path(typed[1] if typed[0] == "resume" else typed[typed.index("--out") + 1])
    if typed[0] != "resume":
        seed = int(typed[typed.index("--seed") + 1])
        folder.mkdir(parents=True, exist_ok=True)
        config = load_config(preset="smoke", objectives=["power"], robot="go1", world="twin", seed=seed)
        atomic_write(folder / "config.yaml", dump_config(config))
    seed = int(
        next(line for line in (folder / "config.yaml").read_text().splitlines() if line.startswith("seed")).split()[1]
    )
    if seed == 13:
        print("error: thirteen")
        return 2
    for stage in STAGES:
        while stage == "final" and (place / f"hold-{seed}").exists():
            time.sleep(0.02)
        path = folder / f"{stage}.json"
        if not path.exists():
            time.sleep(float(os.environ.get("FAKE_SECONDS", "0")))
            atomic_write(path, json.dumps(files(seed)[stage]))
    (folder / "report.html").write_text("")
    return 0


if __name__ == "__main__":
    sys.exit(main())
