"""A robot whose training env is one of its realities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from hts.channels import HELD_CHANNELS, Channel
from hts.contracts import FollowVelocity, Objective, Robot, Settings, Task
from hts.envs.velocity_robot import VelocityRobot
from hts.errors import ConfigError, SimulationError, UnfitWorldError
from hts.rl.actor import PopulationActor
from hts.rl.population import Population
from hts.rl.random import PopulationRandom
from hts.rl.threads import one_thread
from hts.worlds.oracle.env import TRUE, OracleEnv
from hts.worlds.oracle.reward import Level
from hts.worlds.twin.instruments import maker
from hts.worlds.twin.parameters import TwinSettings, resolved_settings

if TYPE_CHECKING:
    from hts.config import EnvConfig
    from hts.plugins import Registry
    from hts.policies.files import Policy

SETTLE_SECONDS = 2.0  # of a walk that says what the truth is like: the start from standing


def check_walks_by_velocity(robot: Robot) -> None:
    """Raise UnfitWorldError for a robot whose env or task is another than that of `VelocityRobot`."""
    if not isinstance(robot.task(), FollowVelocity) or type(robot).make_env is not VelocityRobot.make_env:
        raise UnfitWorldError(
            f"Robot '{robot.spec.name}' brings an env or a task of its own; the oracle knows the velocity task of "
            "hts.envs.velocity_robot.VelocityRobot alone. Take another robot, or `hts run`."
        )


class OracleRobot(Robot):
    """The robot itself, but for `make_env`: that of the reality which the world's settings name.

    Raises ConfigError for settings that are wrong, UnfitWorldError for a robot or an instrument without an oracle.
    """

    def __init__(self, robot: Robot, world: Settings, objectives: Mapping[str, Settings], registry: Registry) -> None:
        self.spec, self.held_at_zero, self.held_below = robot.spec, robot.held_at_zero, robot.held_below
        self._robot = robot
        check_walks_by_velocity(robot)
        self._settings = resolved_settings(TwinSettings.model_validate(dict(world)), robot.spec.name)
        self._instruments = maker(registry, robot, objectives, self._settings)
        told = self._told()
        for name, settings in objectives.items():
            target = registry.make_objective(name, settings).target.name
            if target not in told:
                raise UnfitWorldError(
                    f"Objective '{name}': no instrument of the twin tells the truth about '{target}' (it tells of "
                    f"{', '.join(sorted(told)) or 'nothing'}), so there is no oracle for it. Give its instrument a "
                    "`truth`, or take `hts baseline`."
                )

    def _told(self) -> set[str]:
        found: set[str] = set()
        for instrument in self._instruments().values():
            instrument.reset(1, np.random.default_rng(0))
            found |= set(instrument.truth())
        return found

    def mjcf(self) -> Any | None:
        return self._robot.mjcf()

    def channels(self) -> Mapping[str, Channel]:
        return self._robot.channels()

    def pretrained_policy(self) -> Path | None:
        return self._robot.pretrained_policy()

    def task(self) -> Task:
        return self._robot.task()

    def make_env(
        self,
        engine: str,
        num_candidates: int,
        num_envs: int,
        config: EnvConfig,
        channels: Sequence[str] = (),
        seeds: Sequence[int] | None = None,
    ) -> OracleEnv:
        """See `Robot.make_env`; engine: not asked, physics is the twin's."""
        from hts.worlds.oracle.engine import RealityEngine

        known = {**self.channels(), **HELD_CHANNELS}
        own = list(seeds) if seeds is not None else [config.seed + index for index in range(num_candidates)]
        made = RealityEngine(self._robot, self._settings, self._instruments, num_envs, own, config.threads)
        asked = [name for name in channels if not name.startswith(TRUE)]  # what is true is always written
        wanted = {name: known[name] for name in (asked if channels else self.channels())}
        return OracleEnv(made, self.spec, num_candidates, num_envs, config, wanted, own)


@torch.no_grad()
@one_thread()
def levels(
    robot: OracleRobot,
    policy: Policy,
    objectives: Mapping[str, Objective],
    config: EnvConfig,
    *,
    num_envs: int,
    seconds: float,
    seed: int,
) -> tuple[dict[str, Level], int]:
    """What the truth is like while a policy walks and explores: objective -> level; and the control steps it took.

    Raises SimulationError for a truth that is not finite or never changes.
    """
    env = robot.make_env("", 1, num_envs, config, channels=tuple(robot.task().channels), seeds=[seed])
    population = Population.from_candidates(policy.card.sizes(), [policy.tensors])
    act = PopulationActor(population, PopulationRandom([seed], torch.device("cpu")))
    try:
        state, steps = env.reset(), round(seconds / env.dt)
        rows: dict[str, list[torch.Tensor]] = {name: [] for name in objectives}
        for step in range(steps):
            data, state = env.step_and_maybe_reset(act(state))
            if step * env.dt < SETTLE_SECONDS:
                continue
            for name, objective in objectives.items():
                rows[name].append(data["next", "channels", TRUE + objective.target.name])
    finally:
        env.close()
    found = {}
    for name, seen in rows.items():
        if not seen:
            raise ConfigError(f"A walk of {seconds:g} s says nothing of the truth: longer than {SETTLE_SECONDS:g} s.")
        values = torch.stack(seen).double()
        level = Level(float(values.mean()), float(values.std()))
        if not (np.isfinite(level.mean) and np.isfinite(level.std) and level.std > 0):
            raise SimulationError(
                f"Objective '{name}': what its instrument tells as the truth has mean {level.mean:g} and standard "
                f"deviation {level.std:g} while the policy walks; expected finite numbers that change."
            )
        found[name] = level
    return found, steps * num_envs
