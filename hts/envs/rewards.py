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
- how far joints are beyond soft limits costs nothing by default: who walks by the task's reward alone stays far from
  them, and who is paid for something else may not (docs/decisions.md);
- termination costs a fixed amount, because without the clip falling would otherwise save penalties.
Collisions have no term: touching the floor with the trunk ends the episode; a knee may touch it, and the trunk's least
height and largest tilt keep that rare.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

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
    "joint_range": 0.0,  # -10 as released; presets that pay for a measurement may need more
    "termination": -50.0,  # x dt = -1 once
}


@dataclass
class RewardInputs:
    """What the reward terms look at; leading dimensions [P, N], or [T, P, N] of several steps (`stacked`).

    velocity, angular_velocity, gravity: trunk frame (.., 3); command (.., 3): vx, vy, yaw rate;
    torque, joint_velocity, last_joint_velocity, pose_error (.., J); action, last_action (.., J);
    air_time s, landed, contact bool (.., F); foot_speed_squared: horizontal, m^2/s^2 (.., F); fell bool (..);
    pose_range: pose errors at the joints' soft limits, lower and upper, rad (J) each (`soft_range`); None: no limits;
    dt: control step, s; tracking_sigma (m/s)^2: 0.25 in Rudin et al. 2022; broken bool (..): instances whose physics
    broke, whose numbers mean nothing and whose only reward is that of a fall; None where there is none.
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
    broken: torch.Tensor | None = None
    pose_range: tuple[torch.Tensor, torch.Tensor] | None = None


def stacked(steps: Sequence[RewardInputs]) -> RewardInputs:
    """Several steps as one, with a leading dimension: [T, P, N, ...]."""
    parts = {field.name: [getattr(one, field.name) for one in steps] for field in fields(RewardInputs)}
    broken = parts.pop("broken")
    tensors = {name: _stack(part) for name, part in parts.items() if isinstance(part[0], torch.Tensor)}
    if any(one is not None for one in broken):
        tensors["broken"] = _stack([torch.zeros_like(one.fell) if one.broken is None else one.broken for one in steps])
    return replace(steps[0], **tensors)


def _stack(parts: Sequence[torch.Tensor]) -> torch.Tensor:
    """One of several is itself, with a dimension more."""
    return parts[0].unsqueeze(0) if len(parts) == 1 else torch.stack(list(parts))


def resolve_weights(overrides: Mapping[str, float]) -> dict[str, float]:
    """The default weights with a user's changes. Raises ConfigError for a term that does not exist."""
    for name in overrides:
        if name not in DEFAULT_WEIGHTS:
            raise ConfigError(unknown_name("reward term", name, DEFAULT_WEIGHTS))
    return {**DEFAULT_WEIGHTS, **overrides}


def total(inputs: RewardInputs, weights: Mapping[str, float]) -> torch.Tensor:
    """r_sim of each control step: sum of weight x term x dt, of the leading dimensions.

    The squares are summed as one long vector, x_1^2 w_1 + x_2^2 w_2 + ...: on small tensors each operation costs
    more than its arithmetic.
    """
    vectors = _vectors(inputs)
    scale = _scale(
        tuple(weights.get(name, 0.0) for name in vectors),
        tuple(vector.shape[-1] for vector in vectors.values()),
        inputs.torque.device,
    )
    result = torch.cat(list(vectors.values()), -1).square_().mul_(scale).sum(-1)
    for name, value in _others(inputs).items():
        if weights.get(name):
            result.add_(value, alpha=weights[name])
    if weights.get("joint_range"):
        result.add_(_beyond(inputs), alpha=weights["joint_range"])
    result.mul_(inputs.dt)
    if inputs.broken is not None:
        result = torch.where(inputs.broken, weights.get("termination", 0.0) * inputs.dt, result)
    return result


def _vectors(m: RewardInputs) -> dict[str, torch.Tensor]:
    """Terms that are the squared length of a vector [P, N, ...]: the vectors."""
    return {
        "vertical_velocity": m.velocity[..., 2:3],
        "roll_pitch_rate": m.angular_velocity[..., :2],
        "orientation": m.gravity[..., :2],
        "torque": m.torque,
        "joint_acceleration": (m.joint_velocity - m.last_joint_velocity) / m.dt,
        "action_rate": m.action - m.last_action,
        "pose": m.pose_error,
    }


def _others(m: RewardInputs) -> dict[str, torch.Tensor]:
    """All other terms, [P, N]."""
    moving = (m.command.square().sum(-1) > 0.01).float()
    error = (m.command[..., :2] - m.velocity[..., :2]).square().sum(-1)
    yaw_error = (m.command[..., 2] - m.angular_velocity[..., 2]).square()
    return {
        "track_velocity": torch.exp(error / -m.tracking_sigma),
        "track_yaw_rate": torch.exp(yaw_error / -m.tracking_sigma),
        # Every landing pays; `air_time` is that of the flight that just ended.
        "air_time": ((m.air_time - 0.1).clamp(max=0.25) * m.landed).sum(-1) * moving,
        "slip": (m.foot_speed_squared * m.contact).sum(-1),
        "stand_still": m.pose_error.abs().sum(-1) * (1.0 - moving),
        "termination": m.fell.float(),
    }


def _beyond(m: RewardInputs) -> torch.Tensor:
    """By how much joints are beyond their soft limits, summed, rad [P, N]; as `dof_pos_limits` in the release."""
    if m.pose_range is None:
        return torch.zeros_like(m.pose_error[..., 0])
    low, high = m.pose_range
    return (m.pose_error - m.pose_error.clamp(low, high)).abs().sum(-1)


def soft_range(
    limits: Sequence[tuple[float, float]], pose: Sequence[float], share: float, device: torch.device
) -> tuple[torch.Tensor, torch.Tensor]:
    """(lower, upper) soft limits (J) as errors of the default pose, rad: the middle `share` of each joint's range, none
    where a range is not finite or empty."""
    ends = []
    for (low, high), rest in zip(limits, pose, strict=True):
        known = low < high and math.isfinite(low) and math.isfinite(high)
        middle, half = ((low + high) / 2, share * (high - low) / 2) if known else (0.0, math.inf)
        ends.append((middle - half - rest, middle + half - rest))
    lower, upper = torch.tensor(ends, device=device).unbind(-1)
    return lower, upper


@functools.lru_cache(maxsize=8)
def _scale(weights: tuple[float, ...], sizes: tuple[int, ...], device: torch.device) -> torch.Tensor:
    """Each vector's weight, as often as it has entries."""
    return torch.cat([torch.full((size,), weight) for weight, size in zip(weights, sizes, strict=True)]).to(device)
