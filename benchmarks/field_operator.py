"""A whole run in the world `field` with a script as operator: bundle -> runtime -> logs -> resume, until it is done.

    python benchmarks/field_operator.py --out RUN --reality dev-03 -- --preset smoke --set world.block_seconds=6

The robot is a simulated one (`hts_go1_stand_in`), in a process of its own at the end of a UDP line that loses and
delays packets; the runtime (`hts_go1_runtime`) is another process. What learns meets the reality only through the logs.
`--kill S` kills runtime or run after a random time up to S seconds, every second time, and starts it again.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

WAITING, STOPPED = 75, 3
MOST_TRIES = 20  # of one bundle


def main() -> int:
    """Exit code of the run: 0 if it was finished."""
    parser = argparse.ArgumentParser(description="A field run with a script as operator.")
    parser.add_argument("--out", type=Path, required=True, help="the run's folder")
    parser.add_argument("--reality", default="dev-03", help="that the robot is")
    parser.add_argument("--loss", type=float, default=0.01, help="share of lost packets, each way")
    parser.add_argument("--late", type=float, default=0.02, help="share of late packets, each way")
    parser.add_argument("--warmup", type=float, default=3.0, help="s of walking before a head-to-head")
    parser.add_argument("--real-time", action="store_true", help="not in lockstep")
    parser.add_argument("--kill", type=float, default=0.0, help="kill a process within so many s, every second time")
    parser.add_argument("--seed", type=int, default=0, help="of the robot and of the killing")
    parser.add_argument("run", nargs="*", help="options of `hts run`")
    given = parser.parse_args()
    chance, tries = random.Random(given.seed), 0
    start = ["run", "--objective", "power", "--robot", "go1", "--world", "field", "--out", str(given.out), *given.run]
    command = start
    while True:
        killed_after = chance.uniform(1, given.kill) if given.kill and tries % 2 else None
        code = step([sys.executable, "-m", "hts.cli.main", *command], killed_after)
        tries += 1
        if (given.out / "config.yaml").exists():
            command = ["resume", str(given.out)]
        if code == WAITING:
            record(given, chance)
        elif code is not None:
            return code


def step(command: Sequence[str], killed_after: float | None) -> int | None:
    """Exit code of a command; None if it was killed."""
    process = subprocess.Popen(command)
    try:
        return process.wait(killed_after)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        print(f"killed after {killed_after:.1f} s", flush=True)
        return None


def record(given: argparse.Namespace, chance: random.Random) -> None:
    """Every row of the bundles that wait for logs."""
    for manifest in sorted(given.out.rglob("field/*/manifest.json"), key=lambda path: path.stat().st_mtime):
        bundle = manifest.parent
        rows = [row["log"] for row in json.loads(manifest.read_text())["rows"]]
        for attempt in range(MOST_TRIES):
            if all((bundle / "logs" / f"{row}.csv").exists() for row in rows):
                break
            visit(given, bundle, given.seed + attempt, chance)
        else:
            sys.exit(f"{bundle}: not recorded after {MOST_TRIES} visits.")


def visit(given: argparse.Namespace, bundle: Path, seed: int, chance: random.Random) -> None:
    """One visit to the robot."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    lockstep = [] if given.real_time else ["--lockstep"]
    line = ["--loss", str(given.loss), "--late", str(given.late), "--seed", str(seed)]
    robot = subprocess.Popen(
        [sys.executable, "-m", "hts_go1_stand_in", "--port", str(port), "--reality", given.reality, *lockstep, *line],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONWARNINGS": "ignore"},
    )
    assert robot.stdout is not None
    try:
        mass = robot.stdout.readline().split(", ")[1].split()[0]  # "ready on ..., 12.2 kg": as on a scale
        options = ["--idle-seconds", "2", "--warmup", str(given.warmup), "--mass", mass, "--yes", *lockstep]
        runtime = [sys.executable, "-m", "hts_go1_runtime", "run", str(bundle), "--link", f"udp://127.0.0.1:{port}"]
        began = time.monotonic()
        code = step([*runtime, *options], chance.uniform(5, 60) if given.kill and chance.random() < 0.5 else None)
        print(f"{bundle.name}: visit ended with {code} after {time.monotonic() - began:.0f} s", flush=True)
    finally:
        robot.kill()
        robot.wait()
        robot.stdout.close()


if __name__ == "__main__":
    sys.exit(main())
