"""The analytic stand-in for stepping noise, which the measured reward is compared with."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch


def contact_motion(force: torch.Tensor, velocity: torch.Tensor) -> torch.Tensor:
    """Σ_i max(F_i, 0) Σ_{j in leg i} q̇_j², N·(rad/s)²: what moves fast under load, a blow rather than a stance.

    It stands for the two usual stand-ins, contact force and contact velocity, in channels that a robot has. force:
    normal forces of the feet, N (..., F); velocity: of the joints, rad/s (..., J); -> (...,). Joints are taken as legs
    in the order of the feet, J/F each; where J is no multiple of F, every joint counts for every foot.
    """
    feet, joints = force.shape[-1], velocity.shape[-1]
    squares = velocity.square()
    if joints % feet == 0:
        speed = squares.unflatten(-1, (feet, joints // feet)).sum(-1)
    else:
        speed = squares.sum(-1, keepdim=True)
    return (force.clamp_min(0.0) * speed).sum(-1)
