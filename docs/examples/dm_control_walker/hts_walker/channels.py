"""From what the suite's task shows to the channels that hts names. The same lines serve simulation and the lab."""

from __future__ import annotations

from typing import Any

from hts_walker.robot import GEAR


def channel_values(observation: dict[str, Any], control: Any, stack: Any) -> dict[str, Any]:
    """Channels of one moment, each (..., size). observation: of `walker-walk`; control (..., 6) as sent.

    stack: `torch.stack` or `numpy.stack`, whichever fits the arrays.
    """
    cos, sin = observation["orientations"][..., 0], observation["orientations"][..., 1]
    velocity = observation["velocity"]  # slides up and forward, pitch, then joints
    nothing = 0.0 * cos
    gear = stack([nothing + factor for factor in GEAR], -1)
    return {
        "joint_torque": control.clip(-1.0, 1.0) * gear,
        "joint_velocity": velocity[..., 3:],
        "base_velocity": stack([velocity[..., 1], nothing, velocity[..., 0]], -1),
        # The torso's x axis is (cos, 0, sin) and its z axis (-sin, 0, cos), seen as the suite gives them: xx and xz.
        "projected_gravity": stack([sin, nothing, -cos], -1),
    }
