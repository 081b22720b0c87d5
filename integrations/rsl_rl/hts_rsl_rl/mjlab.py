"""`MeasuredReward` and the settings of `AnchoredPPO` for mjlab."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mjlab.rl import RslRlPpoAlgorithmCfg

from hts_rsl_rl.reward import ManagedTerm

IN_JOINTS = {
    "joint_torque": "qfrc_actuator",  # N m at the joint, of all actuators together
    "joint_velocity": "joint_vel",  # rad/s
    "joint_position": "joint_pos",  # rad
}
"""Channels that an entity of mjlab has: name -> field of `entity.data`, one number a joint."""


class MeasuredReward(ManagedTerm):
    """A reward term:

        RewardTermCfg(func=MeasuredReward, weight=6.0, params={"model": "cost.safetensors", "entity": "robot"})

    weight: lambda, reward per second and unit of the measured reward. params: those of `ManagedTerm`.
    """

    def __init__(self, cfg: Any, env: Any) -> None:
        super().__init__(cfg, env, IN_JOINTS)


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
