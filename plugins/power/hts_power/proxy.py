"""The analytic stand-in for battery power, which the measured reward is compared with."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch

# W/(N·m)², r/k² of a motor: the only published value found, one for all joints. Yang et al. 2022,
# "Fast and Efficient Locomotion via Learned Gait Transitions", in their code (github.com/yxyang/fast_and_efficient).
JOULE_COEFFICIENT = 0.3


def analytic_power(
    torque: torch.Tensor, velocity: torch.Tensor, joule_coefficient: float = JOULE_COEFFICIENT
) -> torch.Tensor:
    """Σ_i max(τ_i q̇_i + (r/k²) τ_i², 0), W: mechanical power plus copper loss, no joint giving anything back.

    torque N·m, velocity rad/s: (..., J) -> (...,). The sum starts at the first of the J joints and ends at the
    last: the paper prints it from 0 to 12 over twelve motors.
    """
    return (torque * velocity + joule_coefficient * torque.square()).clamp_min(0.0).sum(-1)
