"""End-to-end PPO on the CPU: `hts` against Stable-Baselines3 and TorchRL's ParallelEnv, on the same task in one run.

    python benchmarks/compare_cpu.py [--rounds 5] [--seconds 5] [--out FILE]

Makes an environment for the rivals (Stable-Baselines3 and gymnasium from PyPI) in benchmarks/.environments, starts
every contestant in a process of its own and lets them work in turn, so that whatever else runs on the machine meets all
of them. Prints JSON: control steps per second, collection and update, of each; `ratio`, ours over Stable-Baselines3's
best. What they share and where they differ is in `same` and `different`; the contestants are in cpu_rivals.py.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from cpu_rivals import BATCH, CONTESTANTS, EPOCHS, MINIBATCH, OURS
from environment import python_with
from output import give

from hts.cores import available

REQUIREMENTS = (
    "stable-baselines3==2.9.2",
    "gymnasium==1.4.0",
    "farama-notifications",
    "pandas",
    "python-dateutil",
    "pytz",
    "tzdata",
    "six",
)
SAME = (
    "MJCF, variants, 4 physics steps of 5 ms per control step, delay, observation and its noise, commands, pushes, "
    "reward terms and weights, time-outs; starting policy; actor and critic 256-128 ELU; "
    f"{BATCH} samples per candidate and batch, {EPOCHS} epochs of minibatches of {MINIBATCH}"
)
DIFFERENT = (
    "the first contestant also runs a measurement model (an LSTM) in its env and the anchor's KL in its loss, and its "
    "critic sees more; rivals step one world per call (NumPy, mj_step), start the solver warm, and train one policy"
)


class Contestant:
    """A process that works when it is asked to."""

    def __init__(self, python: Path | str, name: str, robot: str) -> None:
        self.name, self.rates = name, list[float]()
        here = Path(__file__).parent
        self.process = subprocess.Popen(
            [python, here / "cpu_rivals.py", name, robot],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            stderr=subprocess.DEVNULL if not os.environ.get("SHOW") else None,
            env={**os.environ, "OMP_NUM_THREADS": "1", "MUJOCO_GL": "disable"},
        )

    def work(self, seconds: float) -> float:
        """Control steps per second of whole batches, at least `seconds` of them."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(f"{seconds}\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        if not line:
            sys.exit(f"'{self.name}' ended with status {self.process.wait()}. SHOW=1 shows what it printed.")
        done = json.loads(line)
        return done["steps"] / done["seconds"]

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()


def busy_cores(seconds: float = 1.0) -> float:
    """Cores in use right now by all processes together; while the contestants wait, by everybody else."""

    def times() -> tuple[float, float]:
        numbers = [float(x) for x in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]]
        return sum(numbers), numbers[3] + numbers[4]

    total, idle = times()
    time.sleep(seconds)
    total_after, idle_after = times()
    share = 1.0 - (idle_after - idle) / max(1e-9, total_after - total)
    return share * (os.cpu_count() or 1)


def compare(robot: str, names: list[str], rounds: int, seconds: float, python: Path) -> dict[str, Any]:
    """All contestants in turn, `rounds` times."""
    contestants = [Contestant(sys.executable if name.startswith("hts") else python, name, robot) for name in names]
    load: list[float] = []
    try:
        for contestant in contestants:
            contestant.work(0.1)  # one batch: it has started, and what is done once is done
        for turn in range(rounds):
            load.append(busy_cores())
            # The other way round in every second turn: nobody always follows the same one.
            for contestant in contestants if turn % 2 == 0 else contestants[::-1]:
                contestant.rates.append(contestant.work(seconds))
                print(f"round {turn + 1}: {contestant.name}: {contestant.rates[-1]:,.0f} steps/s", file=sys.stderr)
        load.append(busy_cores())
    finally:
        for contestant in contestants:
            contestant.close()
    rates = {contestant.name: contestant.rates for contestant in contestants}
    result: dict[str, Any] = {
        "benchmark": "compare_cpu",
        "steps_per_s": {name: round(statistics.median(of), 1) for name, of in rates.items()},
        "rounds": {name: [round(rate, 1) for rate in of] for name, of in rates.items()},
    }
    for rival in ("sb3", "torchrl"):
        theirs = {name: statistics.median(of) for name, of in rates.items() if name.startswith(rival)}
        if theirs and OURS in rates:
            best = max(theirs, key=lambda name: theirs[name])
            result[f"best of {rival}"] = best
            result["ratio" if rival == "sb3" else f"ratio to {rival}"] = round(
                statistics.median(a / b for a, b in zip(rates[OURS], rates[best], strict=True)), 3
            )
    return result | {"others_busy_cores": [round(one, 2) for one in load]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="go1")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=5.0, help="of each contestant in each round, at least")
    parser.add_argument("--only", action="append", help="contestants whose name contains this; repeat for several")
    parser.add_argument("--python", type=Path, help="a Python that has Stable-Baselines3, instead of making one")
    parser.add_argument("--out", type=Path, help="write the JSON here too")
    given = parser.parse_args()
    names = [name for name in CONTESTANTS if not given.only or any(part in name for part in given.only)]
    python = given.python or python_with("sb3", REQUIREMENTS)
    result = compare(given.robot, names, given.rounds, given.seconds, python)
    result |= {
        "robot": given.robot,
        "same": SAME,
        "different": DIFFERENT,
        "cores": available(),
        "processor": platform.processor() or platform.machine(),
        "python": platform.python_version(),
    }
    give(result, given.out)


if __name__ == "__main__":
    main()
