"""When episodes end: all after the same time, but for the first ones, which may be spread."""

from __future__ import annotations

import torch

from hts.config import EnvConfig

GOLDEN = (5**0.5 - 1) / 2  # its multiples, modulo 1, are spread evenly however many there are (Kronecker sequence)


def time_outs(config: EnvConfig, dt: float, shape: tuple[int, int], device: torch.device) -> torch.Tensor:
    """Control steps after which the first episodes end, [P, N], the same in every candidate. dt: of a step, s.

    Spread (`EnvConfig.stagger`): instances that begin together would all start again together, and every batch mean
    would jump then, as the code of Rudin et al. 2022 (legged_gym) avoids by a random length; here an even one.
    """
    most = float(round(config.episode_seconds / dt))
    if not config.stagger:
        return torch.full(shape, most, device=device)
    shares = torch.arange(1, shape[1] + 1, dtype=torch.float64) * GOLDEN % 1.0
    return (shares * most).ceil().clamp(min=1.0).float().to(device).repeat(shape[0], 1)
