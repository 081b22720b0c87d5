"""Reward terms of the velocity task (r_sim), as rates per second.

The list of Rudin et al. 2022 as released (legged_gym, commit 8fa29acc), changed where a small electric quadruped
needs it. Changes, each because the released A1 setting stood still or shuffled in trials:

- feet air time pays min(t_air - 0.1 s, 0.25 s) per landing instead of t_air - 0.5 s: a light robot steps at 2-3 Hz,
  and the released term punishes each of its steps;
- the total is not clipped at 0 (the clip hides every gradient until the robot already walks);
- a weak pose term keeps the legs under the body, and orientation is penalised as in the ANYmal setting;
- tracking is narrower, exp(-e^2 / 0.05) instead of exp(-e^2 / 0.25): at 0.5 m/s the paper's protocol accepts
  +-0.05 m/s, an error that costs 1 % of the released term and 5 % of this one;
- foot slip is penalised, since the floor of training cannot know the floor of the day;
- termination costs a fixed amount, because without the clip falling would otherwise save penalties.
Collisions have no term: touching the floor with the trunk ends the episode; a knee may touch it, and the trunk's least
height and largest tilt keep that rare.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch

from hts.errors import ConfigError, unknown_name

DEFAULT_WEIGHTS: dict[str, float] = {
    "track_velocity": 2.0,
    "track_yaw_rate": 0.75,
    "vertical_velocity": -2.0,
    "roll_pitch_rate": -0.05,
    "orientation": -1.0,
    "torque": -2e-4,
    "joint_acceleration": -2.5e-7,
    "action_rate": -0.02,
    "air_time": 3.0,
    "pose": -0.15,
    "slip": -0.05,
    "stand_still": -0.5,
    "termination": -50.0,  # x dt = -1 once
}


@dataclass
class Motion:
    """What the reward terms look at; leading dimensions [P, N].

    velocity, angular_velocity, gravity: trunk frame (.., 3); command (.., 3): vx, vy, yaw rate;
    torque, joint_velocity, last_joint_velocity, pose_error (.., J); action, last_action (.., J);
    air_time s, landed, contact bool (.., F); foot_speed_squared: horizontal, m^2/s^2 (.., F); fell bool (..);
    dt: control step, s; tracking_sigma (m/s)^2: 0.25 in Rudin et al. 2022.
    """

    velocity: torch.Tensor
    angular_velocity: torch.Tensor
    gravity: torch.Tensor
    command: torch.Tensor
    torque: torch.Tensor
    joint_velocity: torch.Tensor
    last_joint_velocity: torch.Tensor
    pose_error: torch.Tensor
    action: torch.Tensor
    last_action: torch.Tensor
    air_time: torch.Tensor
    landed: torch.Tensor
    contact: torch.Tensor
    foot_speed_squared: torch.Tensor
    fell: torch.Tensor
    dt: float
    tracking_sigma: float


def resolve_weights(overrides: Mapping[str, float]) -> dict[str, float]:
    """The default weights with a user's changes. Raises ConfigError for a term that does not exist."""
    for name in overrides:
        if name not in DEFAULT_WEIGHTS:
            raise ConfigError(unknown_name("reward term", name, DEFAULT_WEIGHTS))
    return {**DEFAULT_WEIGHTS, **overrides}


def terms(motion: Motion) -> dict[str, torch.Tensor]:
    """Every unweighted term, each of shape [P, N]."""
    m = motion
    planar = m.command[..., :2]
    moving = (m.command.square().sum(-1) > 0.01).float()
    error = (planar - m.velocity[..., :2]).square().sum(-1)
    yaw_error = (m.command[..., 2] - m.angular_velocity[..., 2]).square()
    # Every landing pays; `air_time` is that of the flight that just ended.
    air = ((m.air_time - 0.1).clamp(max=0.25) * m.landed).sum(-1) * moving
    pose = m.pose_error.square()
    return {
        "track_velocity": torch.exp(-error / m.tracking_sigma),
        "track_yaw_rate": torch.exp(-yaw_error / m.tracking_sigma),
        "vertical_velocity": m.velocity[..., 2].square(),
        "roll_pitch_rate": m.angular_velocity[..., :2].square().sum(-1),
        "orientation": m.gravity[..., :2].square().sum(-1),
        "torque": m.torque.square().sum(-1),
        "joint_acceleration": ((m.joint_velocity - m.last_joint_velocity) / m.dt).square().sum(-1),
        "action_rate": (m.action - m.last_action).square().sum(-1),
        "air_time": air,
        "pose": pose.sum(-1),
        "slip": (m.foot_speed_squared * m.contact).sum(-1),
        "stand_still": m.pose_error.abs().sum(-1) * (1.0 - moving),
        "termination": m.fell.float(),
    }


def total(motion: Motion, weights: Mapping[str, float]) -> torch.Tensor:
    """r_sim of one control step: sum of weight x term x dt, shape [P, N]."""
    values = terms(motion)
    result = torch.zeros_like(values["track_velocity"])
    for name, weight in weights.items():
        if weight:
            result = result.add(values[name], alpha=weight * motion.dt)
    return result
