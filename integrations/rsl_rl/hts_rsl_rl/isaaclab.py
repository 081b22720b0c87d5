"""`MeasuredReward` for Isaac Lab's reward manager (2.x: `isaaclab.managers`)."""

from __future__ import annotations

from typing import Any

from isaaclab.managers import ManagerTermBase

from hts_rsl_rl.reward import ManagedTerm

IN_JOINTS = {
    "joint_torque": "applied_torque",  # N m, after the actuator model's clipping
    "joint_velocity": "joint_vel",  # rad/s
    "joint_position": "joint_pos",  # rad
}
"""Channels that an articulation has: name -> field of `asset.data`, one number a joint."""


class MeasuredReward(ManagedTerm, ManagerTermBase):
    """A reward term:

        RewTerm(func=MeasuredReward, weight=6.0, params={"model": "cost.safetensors", "entity": "robot"})

    weight: lambda, reward per second and unit of the measured reward. params: those of `ManagedTerm`.
    """

    def __init__(self, cfg: Any, env: Any) -> None:
        ManagerTermBase.__init__(self, cfg, env)
        ManagedTerm.__init__(self, cfg, env, IN_JOINTS)
