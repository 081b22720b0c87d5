"""How cost grows: with candidates P, worlds per candidate N, network size, recorded samples. JSON, and plots as SVG.

    python benchmarks/growth.py --engine mujoco --seconds 4 --figures docs/figures        two cores
    python benchmarks/growth.py --engine warp --figures docs/figures                      a GPU
    python benchmarks/growth.py --from FILE --figures docs/figures                        draw again what was measured

Training is collection and update as in `hts bench train`, in control steps per second of all worlds; fitting is a whole
fit as `hts fit` does it, in seconds an epoch. One thing is varied at a time, everything else stays at `base`.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from pathlib import Path
from typing import Any

from output import give

from hts.bench import Sizes, bench_fit, bench_train

BASE: dict[str, dict[str, Any]] = {
    "mujoco": {"candidates": 6, "envs": 64, "hidden": "256-128"},
    "warp": {"candidates": 18, "envs": 1024, "hidden": "512-256-128"},
}
VARIED: dict[str, dict[str, tuple[Any, ...]]] = {
    "mujoco": {
        "candidates": (1, 2, 4, 8),
        "envs": (16, 32, 64, 128),
        "hidden": ("256-128", "512-256-128"),
    },
    "warp": {
        "candidates": (1, 2, 4, 8, 18, 32),
        "envs": (64, 128, 256, 512, 1024, 2048),
        "hidden": ("256-128", "512-256-128", "1024-512-256", "2048-1024-512"),
    },
}
RECORDED = (24_000, 96_000, 384_000)  # samples
LABELS = {
    "candidates": "candidates P",
    "envs": "worlds per candidate N",
    "hidden": "hidden layers of actor and critic",
    "recorded": "recorded samples",
}


def measure(robot: str, engine: str, device: str, seconds: float, what: list[str]) -> dict[str, Any]:
    """Everything that is varied, one thing at a time."""
    base, found = BASE[engine], {}
    for name in what:
        if name == "recorded":
            found[name] = [_fit(robot, samples, seconds) for samples in RECORDED]
            continue
        rows = []
        for value in VARIED[engine][name]:
            given = base | {name: value}
            hidden = tuple(int(width) for width in given["hidden"].split("-"))
            sizes = Sizes(device=device, hidden=hidden)
            made = bench_train(robot, None, engine, given["candidates"], given["envs"], seconds, sizes)
            rows.append(
                {name: value} | {key: made[key] for key in ("steps_per_s", "bare_steps_per_s", "ratio", "rounds")}
            )
            print(f"{name} {value}: {made['steps_per_s']:,.0f} steps/s", file=sys.stderr)
            about = made["device"]
        found[name] = rows
        found["device"] = about
    return found


def _fit(robot: str, samples: int, seconds: float) -> dict[str, Any]:
    made = bench_fit(robot, None, seconds=seconds, samples=samples)
    print(f"recorded {samples}: {made['samples_per_s']:,.0f} samples/s", file=sys.stderr)
    return {"recorded": made["samples"], "seconds_per_epoch": made["seconds"] / made["epochs"]}


def draw(result: dict[str, Any], folder: Path) -> list[Path]:
    """One SVG with a panel for each thing that was varied."""
    import matplotlib

    matplotlib.use("svg")
    from matplotlib import pyplot as plt
    from matplotlib.ticker import FuncFormatter, NullFormatter

    # The same numbers give the same file; text stays text.
    plt.rcParams.update({"svg.hashsalt": "hts", "svg.fonttype": "none"})
    panels = [name for name in LABELS if name in result["found"]]
    figure, axes = plt.subplots(1, len(panels), figsize=(3.1 * len(panels), 2.7), layout="constrained", squeeze=False)
    for axis, name in zip(axes[0], panels, strict=True):
        rows = result["found"][name]
        fits = name == "recorded"
        values = [row["seconds_per_epoch"] if fits else row["steps_per_s"] for row in rows]
        if name == "hidden":
            axis.bar(range(len(rows)), values, width=0.6, color="#3b6ea5")
            axis.set_xticks(range(len(rows)), [row[name].replace("-", "\n") for row in rows])
        else:
            axis.plot([row[name] for row in rows], values, "o-", color="#3b6ea5", label="training")
            if not fits:
                axis.plot(
                    [row[name] for row in rows],
                    [row["bare_steps_per_s"] for row in rows],
                    "s--",
                    color="#999999",
                    label="bare physics",
                )
            axis.set_xscale("log", base=2)
            axis.set_xticks([row[name] for row in rows])
            axis.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:,.0f}"))
            axis.xaxis.set_minor_formatter(NullFormatter())
            axis.tick_params(axis="x", labelrotation=45 if max(row[name] for row in rows) > 999 else 0)
        if fits:
            axis.set_yscale("log", base=2)
        else:
            axis.set_ylim(bottom=0)
        axis.set_xlabel(LABELS[name])
        axis.set_ylabel("s per epoch" if fits else "control steps / s")
        axis.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:,.3g}" if y < 100 else f"{y:,.0f}"))
        axis.spines[["top", "right"]].set_visible(False)
    lines = [axis for axis in axes[0] if axis.get_legend_handles_labels()[0]]
    if lines:
        lines[0].legend(frameon=False, fontsize="small")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"growth-{result['engine']}.svg"
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)
    return [path]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="go1")
    parser.add_argument("--engine", choices=sorted(BASE), default="mujoco")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--seconds", type=float, default=4.0, help="of each measurement, at least")
    parser.add_argument("--what", action="append", choices=list(LABELS), help="repeat for several; default: all")
    parser.add_argument("--from", dest="source", type=Path, help="an earlier run's JSON, drawn again")
    parser.add_argument("--figures", type=Path, help="folder for the SVG")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    if given.source:
        result = json.loads(given.source.read_text())
    else:
        start = time.perf_counter()
        found = measure(given.robot, given.engine, given.device, given.seconds, given.what or list(LABELS))
        result = {
            "benchmark": "growth",
            "engine": given.engine,
            "base": BASE[given.engine],
            "found": found,
            "processor": platform.processor() or platform.machine(),
            "seconds": round(time.perf_counter() - start, 1),
        }
    if given.figures:
        for path in draw(result, given.figures):
            print(path, file=sys.stderr)
    give(result, given.out)


if __name__ == "__main__":
    main()
