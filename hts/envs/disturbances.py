"""What pushes and pulls an env instance about: jumps of its velocity, and a force that changes slowly."""

from __future__ import annotations

import torch

from hts.config import RandomisationConfig
from hts.rl.tracing import any_or_tracing
from hts.sim.engine import Engine

DRAWS = 3  # uniform numbers an env instance needs in each step: whether, and two components


class Disturbances:
    """Pushes and pulls of all instances [P, N].

    A push is a jump of the trunk's horizontal velocity, now and then. A pull is a horizontal acceleration of the trunk
    that stays for a while, as of a slope or of a cable: a floor that falls by 2 degrees pulls with 0.34 m/s².

    shape: (P, N); dt: of a control step, s; engine: of P N worlds, in that order.
    """

    STATE = ("pull",)

    def __init__(self, config: RandomisationConfig, shape: tuple[int, int], dt: float, engine: Engine) -> None:
        self.config, self.dt, self.engine = config, dt, engine
        self.pull = torch.zeros(*shape, 2, device=engine.device)  # m/s², in the world frame
        self._pulled = any(one > 0 for one in config.pull)
        turns = torch.tensor(config.pull, device=engine.device)
        self._most = turns[torch.arange(shape[1], device=engine.device) % len(turns)][:, None]  # (N, 1)

    def act(self, draws: torch.Tensor) -> None:
        """One control step passes. draws: [P, N, `DRAWS`], uniform in [0, 1). Low ones push, high ones pull anew."""
        c = self.config
        if not c.enabled:
            return
        direction = 2 * draws[..., 1:3] - 1
        if c.push_speed > 0:
            pushed = (draws[..., 0] < self.dt / c.push_interval).reshape(-1)
            mask = pushed & ~self.engine.diverged  # a reset would hide that
            if any_or_tracing(mask):
                self.engine.push(mask, direction.reshape(-1, 2) * c.push_speed)
        if self._pulled:
            anew = draws[..., :1] >= 1.0 - self.dt / c.pull_seconds
            self.pull = torch.where(anew, direction * self._most, self.pull)
            self.engine.nudge((self.pull * self.dt).reshape(-1, 2))
