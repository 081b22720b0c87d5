"""The short trial after an import: does it stand and walk in our simulation?"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hts.contracts import Robot
    from hts.policies.files import Policy

SPEEDS = (0.0, 0.5)  # m/s: standing and a slow walk
SECONDS, WORLDS = 6.0, 8


def trial_lines(robot: Robot, policy: Policy) -> list[str]:
    """One line per set-point: falls, and what was achieved. The robot's env with its variants, without pushes. One that
    says why, where no env can be made with the settings as they come: the import is done and has none of its own."""
    from hts.config import EnvConfig, SimulationTestConfig
    from hts.errors import ConfigError
    from hts.evaluation.simulation import simulate, test_config
    from hts.rl.population import Population

    task = robot.task()
    points = SPEEDS if task.can_hold else task.defaults
    tolerance = SimulationTestConfig().speed_tolerance
    config = test_config(EnvConfig(), points, SECONDS, seed=0)
    try:
        env = robot.make_env("mujoco", 1, WORLDS * len(points), config, task.channels, seeds=[0])
    except ConfigError as error:
        return [f"not tried in our simulation: {error}"]
    try:
        population = Population.from_candidates(policy.card.sizes(), [policy.tensors])
        (trials,) = simulate(env, population, points, SECONDS, tolerance, task)
    finally:
        env.close()
    lines = []
    for point, one in zip(points, trials, strict=True):
        stands = task.can_hold and point == 0
        done = one.falls == 0 and (stands or task.does_it(one.mean_speed, one.valid, point, tolerance))
        verdict = ("stands" if stands else "does it") if done else "does not"
        unit = "" if not task.can_hold else f" {task.unit}"
        lines.append(
            f"in our simulation{task.at(point)}: {verdict} (fell in {one.falls} of {one.worlds} worlds, "
            f"{task.quantity} {one.mean_speed:.2f}{unit})"
        )
    return lines
