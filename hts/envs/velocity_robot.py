"""`VelocityRobot`: a machine that is trained to follow commanded velocities. Imports no torch before an env is made."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

from hts.channels import SPEED_ERROR, SPEED_ERROR_TREND, SPEED_MISSED_FAST, SPEED_MISSED_SLOW
from hts.contracts import Robot
from hts.errors import ConfigError
from hts.guarded import guarded

if TYPE_CHECKING:
    from torchrl.envs import EnvBase

    from hts.config import EnvConfig


class VelocityRobot(Robot):
    """A robot whose training env is the velocity task of `hts.envs.velocity`.

    It needs a model: `mjcf` names floor, trunk, joints, feet and sensors as the documentation of robots lists them.
    A robot that wants the task slightly different overrides `make_env` and hands a changed `config` to `super()`.
    """

    keeps_physics_steps = True
    held_at_zero = MappingProxyType({SPEED_ERROR.name: 0.02, SPEED_ERROR_TREND.name: 0.02})
    held_below = MappingProxyType({SPEED_MISSED_SLOW.name: 0.08, SPEED_MISSED_FAST.name: 0.04})
    """About twice what a policy has that walks well: 0.034 and 0.016 under pushes and on varied machines
    (docs/decisions.md says what was tried)."""

    def make_env(
        self,
        engine: str,
        num_candidates: int,
        num_envs: int,
        config: EnvConfig,
        channels: Sequence[str] = (),
        seeds: Sequence[int] | None = None,
    ) -> EnvBase:
        """The velocity task, see `Robot.make_env`. Raises ConfigError for a robot without a model or a wrong engine."""
        from hts.envs.make_velocity import make_velocity_env

        if guarded(f"Robot '{self.spec.name}': mjcf()", self.mjcf) is None:
            raise ConfigError(
                f"Robot '{self.spec.name}' is log-only: it has no model, so there is nothing to train in. `hts import` "
                "and `hts fit` are for it."
            )
        return make_velocity_env(self, engine, num_candidates, num_envs, config, channels, seeds)
