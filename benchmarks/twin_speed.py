"""How fast the twin is: simulated seconds per second of one core, by the number of robots side by side.

    python benchmarks/twin_speed.py [--robots 1 --robots 2 ...] [--reality dev-03] [--objective noise] [--plain]

The shipped policy walks at 0.8 m/s. Sizes take turns, and the best of the rounds counts, in seconds of the processor
that the process got, so that a busy machine matters little. --plain: the steps with numpy, without compiled ones.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from hts import plugins
from hts.policies.export import to_onnx
from hts.policies.files import load_policy
from hts.worlds.base import seed_sequence, walking
from hts.worlds.twin import compiled
from hts.worlds.twin.instruments import maker
from hts.worlds.twin.parameters import TwinSettings, resolved_settings
from hts.worlds.twin.programme import collection
from hts.worlds.twin.session import Batch


def speeds(robots: list[int], seconds: float, rounds: int, robot_name: str, objective: str, reality: str | None):
    """Number of robots -> simulated robot seconds per second."""
    registry = plugins.load()
    robot = registry.make_robot(robot_name)
    settings = resolved_settings(TwinSettings.model_validate({"reality": reality} if reality else {}), robot_name)
    make = maker(registry, robot, {objective: {}}, settings)
    shipped = robot.pretrained_policy()
    assert shipped is not None
    with tempfile.TemporaryDirectory() as folder:
        policy = str(to_onnx(load_policy(shipped), Path(folder) / "policy.onnx"))

        def measure(number: int, length: float) -> float:
            batch = Batch(robot, settings, make(), number, seed_sequence(0, "aa", 0))
            sessions = collection([policy] * number, walking(0.8, length), "x")
            begin = time.process_time()
            batch.run(sessions, "twin")
            spent = time.process_time() - begin
            batch.close()
            return number * sessions[0].seconds / spent

        measure(1, 0.1)  # whatever is done once
        best = dict.fromkeys(robots, 0.0)
        for _ in range(rounds):
            for number in robots:
                best[number] = max(best[number], measure(number, seconds))
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, action="append", help="side by side; default 1, 2, 6 and 24")
    parser.add_argument("--seconds", type=float, default=4.0, help="of walking in each round")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--robot", default="go1")
    parser.add_argument("--objective", default="power")
    parser.add_argument("--reality")
    parser.add_argument("--plain", action="store_true", help="without compiled steps")
    given = parser.parse_args()
    if given.plain:
        setattr(compiled, "load", lambda: None)  # noqa: B010 - for the type checker
    robots = given.robots or [1, 2, 6, 24]
    found = speeds(robots, given.seconds, given.rounds, given.robot, given.objective, given.reality)
    for number, speed in found.items():
        print(f"{number:3d} side by side: {speed:6.1f} simulated seconds per second, {1000 / speed:6.2f} ms each")


if __name__ == "__main__":
    main()
