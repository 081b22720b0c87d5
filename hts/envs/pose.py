"""How the trunk lies and moves, from the engine's state."""

from __future__ import annotations

import torch


def trunk_frame(qpos: torch.Tensor, qvel: torch.Tensor, down: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Linear velocity and direction of gravity in the trunk frame, each [..., 3].

    qpos [..., nq], qvel [..., nv] as in `Engine`; down [..., 3]: gravity's direction in the world frame. With the
    orientation (w, q), v' = v - 2 w (q x v) + 2 q x (q x v).
    """
    w, axis = qpos[..., 3:4], qpos[..., 4:7]
    world = torch.stack((qvel[..., :3], down), -2)
    axes = axis.unsqueeze(-2).expand_as(world)
    across = torch.linalg.cross(axes, world)
    turned = torch.linalg.cross(axes, across).addcmul_(w.unsqueeze(-1), across, value=-1.0)
    velocity, gravity = turned.mul_(2.0).add_(world).unbind(-2)
    return velocity, gravity


def yaw_of(qpos: torch.Tensor) -> torch.Tensor:
    """Heading [...], rad. In double precision: torch's single one differs in the last bit between the bulk of a tensor
    and its end."""
    w, x, y, z = qpos[..., 3:7].unbind(-1)
    return torch.atan2((w * z + x * y).double(), (0.5 - (y * y + z * z)).double()).float()
