"""The velocity task on a reality: the reward of the task from its true state, observations from its own sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from tensordict import TensorDict

from hts.channels import Channel
from hts.config import EnvConfig
from hts.contracts import RobotSpec
from hts.envs.commands import Commands
from hts.envs.rewards import RewardInputs
from hts.envs.velocity import VelocityEnv
from hts.worlds.oracle.engine import RealityEngine

TRUE = "true_"
"""What the name of a channel that holds the truth begins with; the rest is the real channel's."""


class OracleEnv(VelocityEnv):
    """As `VelocityEnv`, on a `RealityEngine`; nothing is drawn but what differs between the reality's own sessions.

    The policy observes what the robot's sensors show, the critic the true state. Beside the robot's sim channels
    (without sensor noise) it writes ("channels", "true_NAME") for whatever the instruments tell. An episode ends with
    a session.
    """

    engine: RealityEngine

    def __init__(
        self,
        engine: RealityEngine,
        spec: RobotSpec,
        num_candidates: int,
        num_envs: int,
        config: EnvConfig,
        channels: Mapping[str, Channel],
        seeds: Sequence[int],
    ) -> None:
        still = config.randomisation.model_copy(update={"enabled": False})
        config = config.model_copy(update={"randomisation": still, "observation_noise": 0.0})
        what = "what only a simulator knows; unit of the instrument's own"
        told = {TRUE + name: Channel(TRUE + name, "1", (), what) for name in engine.truth}
        super().__init__(engine, spec, num_candidates, num_envs, config, {**channels, **told}, seeds)
        self.dt = 1 / spec.control_rate_hz
        self.commands = SessionCommands(self.commands, engine)

    def full_state(self) -> TensorDict | None:  # type: ignore[override]
        """A reality cannot be saved in mid-session: a fine-tuning that is stopped starts again."""
        return None

    def _read_engine(self) -> None:
        self._down = self.engine.down.view(*self.shape2, 3)  # a floor may slope, another way in each session
        super()._read_engine()

    def _prepare_next(self, seen: RewardInputs) -> dict[str, torch.Tensor]:
        flags = super()._prepare_next(seen)
        ends = self.engine.over.view(*self.shape2, 1)
        truncated = flags["truncated"] | (ends & ~flags["terminated"])
        return {**flags, "truncated": truncated, "done": flags["terminated"] | truncated}

    def _observe(self, draws: torch.Tensor) -> None:
        super()._observe(draws)
        shown = {name: values.view(*self.shape2, -1) for name, values in self.engine.readings.items()}
        body = (shown["angular_velocity"], shown["projected_gravity"], self.commands.value)
        offset = shown["joint_position"] - self.default_pose
        self._observation = torch.cat((*body, offset, shown["joint_velocity"], self.action), -1)

    def _channel_value(self, name: str) -> torch.Tensor:
        if name.startswith(TRUE):
            return self.engine.truth[name.removeprefix(TRUE)].view(self.shape2).clone()
        return super()._channel_value(name)


class SessionCommands(Commands):
    """Commands whose heading is kept by the operator of each session, who has a gain and an error of their own."""

    def __init__(self, plain: Commands, engine: RealityEngine) -> None:
        vars(self).update(vars(plain))
        self._engine = engine

    def steer(self, yaw: torch.Tensor) -> None:
        gain, offset = (each.view(yaw.shape) for each in (self._engine.heading_gain, self._engine.heading_offset))
        self._turn(self.heading + offset - yaw, self.config.heading_gain * gain)
