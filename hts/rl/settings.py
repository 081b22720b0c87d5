"""The numbers of gradient steps."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class UpdateSettings:
    """How a batch becomes gradient steps. The symbols are those of `hts.rl.surrogate`.

    epochs: passes over the batch; minibatches: parts of it per pass; clip: epsilon; value_coef: v; entropy_coef: h;
    learning_rate: Adam's, the first one if adaptive; adaptive_rate: it follows KL(old || new), target desired_kl, nats;
    max_grad_norm: of each candidate's gradient.
    """

    epochs: int = 5
    minibatches: int = 4
    clip: float = 0.2
    value_coef: float = 1.0
    entropy_coef: float = 0.0
    learning_rate: float = 3e-4
    adaptive_rate: bool = False
    desired_kl: float = 0.01
    max_grad_norm: float = 1.0
