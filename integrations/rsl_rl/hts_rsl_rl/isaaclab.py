"""`MeasuredReward` for Isaac Lab's reward manager (2.x: `isaaclab.managers`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from isaaclab.managers import ManagerTermBase
from torch import Tensor

from hts_rsl_rl.reward import CENTRING, Channel, term_of

IN_JOINTS = {
    "joint_torque": "applied_torque",  # N m, after the actuator model's clipping
    "joint_velocity": "joint_vel",  # rad/s
    "joint_position": "joint_pos",  # rad
}
"""Channels that an articulation has: name -> field of `asset.data`, one number a joint."""


class MeasuredReward(ManagerTermBase):
    """A reward term:

        RewTerm(func=MeasuredReward, weight=6.0, params={"model": "cost.safetensors", "entity": "robot"})

    The params are those of `hts_rsl_rl.mjlab.MeasuredReward`.
    """

    def __init__(self, cfg: Any, env: Any) -> None:
        super().__init__(cfg, env)
        self.term = term_of(cfg.params, env, IN_JOINTS)

    def reset(self, env_ids: Sequence[int] | None = None) -> None:
        self.term.reset(env_ids)

    def __call__(
        self,
        env: Any,
        model: str = "",
        entity: str = "robot",
        joint_names: Sequence[str] | None = None,
        channels: Mapping[str, Channel] | None = None,
        centring: float | None = CENTRING,
    ) -> Tensor:
        """The params were read when the term was made; Isaac Lab wants them named here."""
        return self.term(env)
