"""End-to-end PPO on a GPU: `hts` against bare physics, and against mjlab + rsl_rl on their own Go1 task.

    python benchmarks/compare_gpu.py [--worlds 4096 --worlds 18432 --worlds 36864] [--out FILE]
    python benchmarks/compare_gpu.py --rival-path DIR     mjlab's wheels unpacked in DIR, for a machine without network

Ours trains `--candidates` together, as fine-tuning does, with anchor, bound and a measurement model of 128 units in the
loop; both have networks 512-256-128, 24 steps of 20 ms a world and batch (4 physics steps of 5 ms each), 5 epochs of 4
minibatches. mjlab needs mujoco ~=3.11, so it gets an environment of its own and a process of its own, after ours has
ended: a GPU is timed with one program on it. Prints JSON: control steps per second of collection and update.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from environment import python_with
from output import give

REQUIREMENTS = (
    "mjlab==1.6.0",
    "mujoco==3.11.0",
    "mujoco-warp==3.11.0",
    "rsl-rl-lib==5.4.2",
    "tyro",
    "docstring_parser",
    "typeguard",
    "prettytable",
    "wcwidth",
)
HERE = Path(__file__).parent


def answer(command: list[str], environment: dict[str, str]) -> dict[str, Any]:
    """The JSON that a command prints; what goes wrong is a result too ("error"), and the next size goes on."""
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    if done.returncode:
        printed = (done.stderr.strip() or done.stdout.strip() or "nothing").splitlines()
        print("\n".join(printed[-30:]), file=sys.stderr)
        return {"error": f"status {done.returncode}: {printed[-1]}"}
    return json.loads(done.stdout[done.stdout.index("{") :])


def ours(given: argparse.Namespace, worlds: int, bench: str) -> dict[str, Any]:
    """`hts bench train` or `env`: against bare physics of the same steps in the same process."""
    command = [
        sys.executable, "-m", "hts.cli.main", "bench", bench,
        "--robot", given.robot, "--engine", "warp", "--device", given.device,
        "--candidates", str(given.candidates), "--envs", str(max(1, worlds // given.candidates)),
        "--hidden", given.hidden, "--memory", str(given.memory), "--seconds", str(given.seconds), "--json",
    ]  # fmt: skip
    return answer(command, dict(os.environ))


def mjlab(given: argparse.Namespace, worlds: int) -> dict[str, Any]:
    """mjlab_rival.py in mjlab's environment."""
    environment, python = dict(os.environ), Path(sys.executable)
    if given.rival_path:
        environment["PYTHONPATH"] = str(given.rival_path)  # ours left out: two versions of mujoco
    else:
        python = given.rival_python or python_with("mjlab", REQUIREMENTS)
        environment.pop("PYTHONPATH", None)
    device = "cuda:0" if given.device in ("auto", "cuda") else given.device
    command = [
        str(python), str(HERE / "mjlab_rival.py"), "--worlds", str(worlds), "--rounds", str(given.rounds),
        "--iterations", str(given.iterations), "--device", device,
    ]  # fmt: skip
    return answer(command, environment)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="go1")
    parser.add_argument("--worlds", type=int, action="append", help="in all; repeat for several")
    parser.add_argument("--candidates", type=int, default=18)
    parser.add_argument("--hidden", default="512-256-128")
    parser.add_argument("--memory", type=int, default=128)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rounds", type=int, default=5, help="of mjlab")
    parser.add_argument("--iterations", type=int, default=5, help="of mjlab in each round")
    parser.add_argument("--device", default="auto", help="cuda:0, auto, or cpu for a trial of the script")
    parser.add_argument("--without-rival", action="store_true", help="ours and bare physics only")
    parser.add_argument("--rival-path", type=Path, help="folder with mjlab and what it needs, for this Python")
    parser.add_argument("--rival-python", type=Path, help="a Python that has mjlab")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    sizes = []
    for worlds in given.worlds or (4096, 8192, 18432, 36864):
        row: dict[str, Any] = {
            "worlds": worlds,
            "train": ours(given, worlds, "train"),
            "env": ours(given, worlds, "env"),
        }
        if not given.without_rival:
            row["mjlab"] = mjlab(given, worlds)
            if "error" not in row["mjlab"] and "error" not in row["train"]:
                row["ratio"] = row["train"]["steps_per_s"] / row["mjlab"]["steps_per_s"]
        rates = {name: round(row[name].get("steps_per_s", 0)) for name in ("train", "env", "mjlab") if name in row}
        print(f"{worlds} worlds: {rates}", file=sys.stderr)
        sizes.append(row)
    result = {
        "benchmark": "compare_gpu",
        "sizes": sizes,
        "different": "each its own Go1 model, reward and randomisation; "
        "ours also runs the measurement model and the anchor",
    }
    give(result, given.out)


if __name__ == "__main__":
    main()
