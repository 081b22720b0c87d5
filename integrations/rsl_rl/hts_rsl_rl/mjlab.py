"""`MeasuredReward` and the settings of `AnchoredPPO` for mjlab."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mjlab.rl import RslRlPpoAlgorithmCfg
from torch import Tensor

from hts_rsl_rl.reward import CENTRING, Channel, term_of

IN_JOINTS = {
    "joint_torque": "qfrc_actuator",  # N m at the joint, of all actuators together
    "joint_velocity": "joint_vel",  # rad/s
    "joint_position": "joint_pos",  # rad
}
"""Channels that an entity of mjlab has: name -> field of `entity.data`, one number a joint."""


class MeasuredReward:
    """A reward term:

        RewardTermCfg(func=MeasuredReward, weight=6.0, params={"model": "cost.safetensors", "entity": "robot"})

    weight: lambda, reward per second and unit of the measured reward. params: model, the exported file; entity, whose
    joints; joint_names, theirs in the order of the recordings, None: as the file says; channels, name -> function of
    the env, for inputs that are not torque, velocity and position of joints, or that are to be read in another way;
    centring, beta per control step, None for none.
    """

    def __init__(self, cfg: Any, env: Any) -> None:
        self.term = term_of(cfg.params, env, IN_JOINTS)

    def reset(self, env_ids: Tensor | slice | None = None) -> None:
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
        """The params were read when the term was made."""
        return self.term(env)


@dataclass
class AnchoredPpoCfg(RslRlPpoAlgorithmCfg):
    """`algorithm` of an mjlab runner's settings; fields as `AnchoredPPO` describes them."""

    class_name: str = "hts_rsl_rl:AnchoredPPO"
    anchor_checkpoint: str = ""
    kl_bound: float = 0.5
    multiplier_rate: float = 0.05
    start_from_anchor: bool = True
    freeze_normalization: bool = True
    centring_rate: float | None = None
