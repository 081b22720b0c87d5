"""A measurement model that is a `torch.nn.Module`: its parameters and buffers are what is saved and moved.

What is left to write: `settings`, `learn` (or `fit`), `sequence`, `step` and `initial_state`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor, nn

from hts.contracts import Signals
from hts.measurement.data import pairs_of, with_products
from hts.measurement.fit_settings import Learner


class TorchModel(nn.Module, Learner):
    """Buffers from the data it was fitted to, in channel units: target_mean, target_std, input_low, input_high (F,),
    and of the features (G,): feature_mean, feature_std.

    Features are the inputs and, with products, the products of channels of one size, place by place: of τ and q̇ of 12
    joints τ², τq̇ and q̇², so G = 24 + 36. A model that is given them need not learn to multiply from a few gaits,
    which it does badly outside them.
    """

    def __init__(self, signals: Signals, products: bool = False) -> None:
        super().__init__()
        self.signals = signals
        self._pairs = pairs_of(signals.sizes) if products else ()
        self.register_buffer("feature_mean", torch.zeros(self.num_features))
        self.register_buffer("feature_std", torch.ones(self.num_features))
        self.register_buffer("input_low", torch.full((self.num_inputs,), -torch.inf))
        self.register_buffer("input_high", torch.full((self.num_inputs,), torch.inf))
        self.register_buffer("target_mean", torch.tensor(0.0))
        self.register_buffer("target_std", torch.tensor(1.0))
        self._folded: Any = None  # what `step` makes of the weights, once; None while they may move

    @property
    def num_inputs(self) -> int:
        """F: numbers per sample over all input channels."""
        return self.signals.num_inputs

    @property
    def num_features(self) -> int:
        """G: inputs and their products."""
        return self.num_inputs + sum(first.stop - first.start for first, _ in self._pairs)

    def features(self, inputs: Tensor) -> Tensor:
        """Inputs (..., F) in channel units -> features (..., G), not z-scored. Raises ValueError for another F, which
        the statistics of the data would otherwise stretch to theirs."""
        if inputs.shape[-1] != self.num_inputs:
            named = ", ".join(f"{one.name} {one.shape}" for one in self.signals.inputs)
            raise ValueError(
                f"The inputs have the shape {tuple(inputs.shape)}; expected {self.num_inputs} numbers in the last "
                f"dimension, side by side: {named}."
            )
        return with_products(inputs, self._pairs)

    def scaled_features(self, inputs: Tensor) -> Tensor:
        """Inputs (..., F) in channel units -> z-scored features (..., G)."""
        return (self.features(inputs) - self.feature_mean) / self.feature_std

    @torch.no_grad()
    def set_statistics(self, inputs: Tensor, target: Tensor) -> None:
        """Take means, standard deviations and ranges from data: inputs (T, F), target (T,), channel units."""
        features = self.features(inputs.double())
        mean, std = features.mean(0), features.std(0)
        std = torch.where(std > 1e-6 * (1e-6 + mean.abs()), std, 1.0)  # a constant input must not blow up
        target_mean, target_std = target.double().mean(), target.double().std()
        self._before_statistics(mean, std, target_mean, target_std)
        self.feature_mean.copy_(mean)
        self.feature_std.copy_(std)
        self.input_low.copy_(inputs.amin(0))
        self.input_high.copy_(inputs.amax(0))
        self.target_mean.copy_(target_mean)
        self.target_std.copy_(target_std)
        self._folded = None

    def _before_statistics(self, mean: Tensor, std: Tensor, target_mean: Tensor, target_std: Tensor) -> None:
        """Called with the new statistics while the old ones are still there."""

    def normalise_target(self, target: Tensor) -> Tensor:
        """From the target's unit to z-scores, any shape."""
        return (target - self.target_mean) / self.target_std

    def outside(self, inputs: Tensor) -> Tensor:
        outside = inputs.clamp(self.input_low, self.input_high) != inputs
        return outside.mean(-1, dtype=torch.float32)

    def tensors(self) -> Mapping[str, Tensor]:
        return self.state_dict()

    def load_tensors(self, tensors: Mapping[str, Tensor]) -> None:
        self.load_state_dict(dict(tensors))

    def train(self, mode: bool = True) -> TorchModel:
        self._folded = None
        return super().train(mode)

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> TorchModel:
        # What .to(device), .double(), ... call.
        self._folded = None
        return super()._apply(fn, recurse)

    def _load_from_state_dict(self, *args: Any, **kwargs: Any) -> None:
        self._folded = None
        super()._load_from_state_dict(*args, **kwargs)
