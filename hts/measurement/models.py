"""The measurement model f: sim channels → real channel, a small recurrent network.

One network, two ways to run it: `sequence` over recordings while fitting (torch's fused LSTM), and `step`
inside the env loop, where 384 worlds every 20 ms leave no room for overhead. `step` therefore folds the
z-scoring into the first layer's weights and keeps the worlds in columns, so that each gate is one
contiguous block: 0.5 ms a step for 384 worlds × 24 inputs × 64 units on one 2.5 GHz core,
where `torch.nn.LSTM` took 0.8 ms.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn

from hts.config import Config
from hts.errors import RecordingError


class MeasurementModelConfig(Config):
    """Which network is fitted, on which channels, and how."""

    inputs: tuple[str, ...] = Field(min_length=1, description="sim channels the model reads, in this order")
    target: str = Field(description="real channel it predicts")
    kind: Literal["lstm"] = Field("lstm", description="family of networks")
    products: bool = Field(
        False, description="also feed the squares of the inputs and the products of inputs of one size, place by place"
    )
    hidden: int = Field(64, ge=1, description="units per layer")
    layers: int = Field(1, ge=1, le=4, description="recurrent layers")
    learning_rate: float = Field(4e-3, gt=0, description="peak step size of Adam")
    sequence: int = Field(50, ge=2, description="samples of truncated back-propagation through time")
    stream: int = Field(1000, ge=2, description="samples from one empty memory to the next; about an episode")
    batch: int = Field(32, ge=1, description="streams side by side, at most")


class MeasurementModel(nn.Module):
    """An LSTM with a linear head between z-scored inputs and a z-scored target.

    input_sizes: numbers per sample of each input channel, in the config's order (F is their sum); rate_hz: of samples.
    Features, (G,), are the inputs and, with `config.products`, the products of channels of one size, place by place:
    for τ and q̇ of 12 joints τ², τq̇ and q̇², so G = 24 + 36. A network that is given them need not learn to multiply
    from a few gaits, which it does badly outside them.
    Buffers, from the data it was fitted on, in channel units: feature_mean, feature_std (G,), target_mean, target_std,
    input_low, input_high (F,).

    The memory, "state" below, is one tensor (layers, 2, hidden, W): outputs h, then cells c, worlds last.
    """

    def __init__(
        self, config: MeasurementModelConfig, input_sizes: Sequence[int], rate_hz: float, seed: int = 0
    ) -> None:
        super().__init__()
        if len(input_sizes) != len(config.inputs):
            raise ValueError(f"{len(config.inputs)} input channels but {len(input_sizes)} sizes")
        self.config = config
        self.input_sizes = tuple(int(size) for size in input_sizes)
        self.rate_hz = float(rate_hz)
        self._pairs = _pairs(self.input_sizes) if config.products else ()
        features = self.num_features
        # Made on "meta": torch's own initialisation would draw from the global generator, and so tie the
        # model to whatever ran before it.
        lstm = nn.LSTM(features, config.hidden, config.layers, batch_first=True, device="meta")
        self.lstm = lstm.to_empty(device="cpu")
        self.head = nn.Linear(config.hidden, 1, device="meta").to_empty(device="cpu")
        self._initialise(seed)
        self.register_buffer("feature_mean", torch.zeros(features))
        self.register_buffer("feature_std", torch.ones(features))
        self.register_buffer("input_low", torch.full((self.num_inputs,), -torch.inf))
        self.register_buffer("input_high", torch.full((self.num_inputs,), torch.inf))
        self.register_buffer("target_mean", torch.tensor(0.0))
        self.register_buffer("target_std", torch.tensor(1.0))
        self._folded: list[tuple[Tensor, Tensor]] | None = None

    @property
    def num_inputs(self) -> int:
        """F: numbers per sample over all input channels."""
        return sum(self.input_sizes)

    @property
    def num_features(self) -> int:
        """G: inputs and their products."""
        return self.num_inputs + sum(first.stop - first.start for first, _ in self._pairs)

    def features(self, inputs: Tensor) -> Tensor:
        """Inputs (..., F) in channel units -> features (..., G), not z-scored."""
        if not self._pairs:
            return inputs
        return torch.cat((inputs, *(inputs[..., a] * inputs[..., b] for a, b in self._pairs)), -1)

    @torch.no_grad()
    def _initialise(self, seed: int) -> None:
        """Uniform ±1/√hidden as in torch; forget biases 1, so that memory lasts from the start (Gers et al. 2000)."""
        generator = torch.Generator().manual_seed(seed)
        bound = self.config.hidden**-0.5
        for parameter in self.parameters():
            parameter.uniform_(-bound, bound, generator=generator)
        hidden = self.config.hidden
        for layer in range(self.config.layers):
            getattr(self.lstm, f"bias_ih_l{layer}")[hidden : 2 * hidden] = 1.0
            getattr(self.lstm, f"bias_hh_l{layer}")[hidden : 2 * hidden] = 0.0

    # ------------------------------------------------------------------------------------- normalisation

    @torch.no_grad()
    def set_normaliser(self, inputs: Tensor, target: Tensor) -> None:
        """Take means, standard deviations and ranges from data. A model fitted before stays the same function.

        inputs (T, F), target (T,), channel units. Raises RecordingError if the target does not vary.
        """
        features = self.features(inputs.double())
        mean, std = features.mean(0), features.std(0)
        std = torch.where(std > 1e-6 * (1e-6 + mean.abs()), std, 1.0)  # a constant input must not blow up
        target_mean, target_std = target.double().mean(), target.double().std()
        if not target_std > 1e-6 * (1e-6 + target_mean.abs()):
            raise RecordingError(
                f"'{self.config.target}' is {target_mean:g} in all {len(target)} samples. A model cannot be fitted "
                "to a constant: check that the sensor was read, and record again."
            )
        if torch.isfinite(self.input_low).all():  # it was fitted before, to data with other statistics
            self._renormalise(mean, std, target_mean, target_std)
        self.feature_mean.copy_(mean)
        self.feature_std.copy_(std)
        self.input_low.copy_(inputs.amin(0))
        self.input_high.copy_(inputs.amax(0))
        self.target_mean.copy_(target_mean)
        self.target_std.copy_(target_std)
        self._folded = None

    def _renormalise(self, mean: Tensor, std: Tensor, target_mean: Tensor, target_std: Tensor) -> None:
        """Change the weights so that with the new statistics the model predicts what it predicted with the old ones."""
        weight, bias = self.lstm.weight_ih_l0, self.lstm.bias_ih_l0
        old_mean, old_std = self.feature_mean.double(), self.feature_std.double()
        # z_old = (x - m)/s and z_new = (x - m')/s', so z_old = z_new s'/s + (m' - m)/s
        bias += (weight.double() @ ((mean - old_mean) / old_std)).to(bias.dtype)
        weight *= (std / old_std).to(weight.dtype)
        scale, shift = self.target_std / target_std, (self.target_mean - target_mean) / target_std
        self.head.weight *= scale
        self.head.bias.mul_(scale).add_(shift)

    def denormalise(self, prediction: Tensor) -> Tensor:
        """From z-scores to the target's unit, any shape."""
        return prediction * self.target_std + self.target_mean

    def normalise_target(self, target: Tensor) -> Tensor:
        """From the target's unit to z-scores, any shape."""
        return (target - self.target_mean) / self.target_std

    # --------------------------------------------------------------------------------------------- running

    def initial_state(self, num_worlds: int, device: torch.device | str | None = None) -> Tensor:
        """An empty memory for W worlds, (layers, 2, hidden, W)."""
        return torch.zeros(
            self.config.layers, 2, self.config.hidden, num_worlds, device=device or self.feature_mean.device
        )

    def sequence(self, inputs: Tensor, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Predictions over time: inputs (B, T, F) in channel units -> z-scored (B, T), state (layers, 2, hidden, B)."""
        past = None
        if state is not None:
            past = tuple(part.transpose(1, 2).contiguous() for part in state.unbind(1))
        output, (h, c) = self.lstm((self.features(inputs) - self.feature_mean) / self.feature_std, past)
        return self.head(output).squeeze(-1), torch.stack((h, c), 1).transpose(2, 3)

    @torch.no_grad()
    def step(self, inputs: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """One sample of W worlds: inputs (W, F) in channel units -> z-scored (W,) and the new state.

        A NaN or infinite input makes that world's prediction NaN, never a plausible number.
        """
        first, states = inputs.t(), []
        below = (first, *(first[a] * first[b] for a, b in self._pairs))
        for layer, (h, c) in zip(self._weights(), state, strict=True):
            h, cell = self._cell(layer, (*below, h), c)
            below = (h,)
            states.append(torch.stack((h, cell)))
        return self._read(below[0], inputs), torch.stack(states)

    @torch.no_grad()
    def steps(self, inputs: Tensor, state: Tensor, ended: Tensor) -> tuple[Tensor, Tensor]:
        """`step` T times, with the memory of a world emptied after the steps of ended (T, W): inputs (T, W, F) -> (T, W) and
        the new state. To the bit the same, with less done per step."""
        each = inputs.transpose(1, 2)
        features = torch.cat((each, *(each[:, a] * each[:, b] for a, b in self._pairs)), 1)
        empty, memory = ended.any(1).tolist(), [list(pair) for pair in state]
        outputs = torch.empty(len(inputs), self.config.hidden, inputs.shape[1], device=inputs.device)
        for time, below in enumerate(features):
            for layer, pair in zip(self._weights(), memory, strict=True):
                pair[:] = self._cell(layer, (below, pair[0]), pair[1])
                below = pair[0]
            outputs[time] = below
            if empty[time]:
                memory = [[part.masked_fill(ended[time], 0.0) for part in pair] for pair in memory]
        predictions = [self._read(output, input) for output, input in zip(outputs, inputs, strict=True)]
        return torch.stack(predictions), torch.stack([torch.stack(pair) for pair in memory])

    def _cell(self, layer: tuple[Tensor, Tensor], below: tuple[Tensor, ...], cell: Tensor) -> tuple[Tensor, Tensor]:
        """One layer, one sample: output and cell (hidden, W)."""
        (weight, bias), hidden = layer, self.config.hidden
        gates = torch.addmm(bias, weight, torch.cat(below))
        write, forget, show = gates[: 3 * hidden].sigmoid_().view(3, hidden, -1)
        cell = torch.addcmul(forget * cell, write, gates[3 * hidden :].tanh_())
        return torch.tanh(cell).mul_(show), cell

    def _read(self, output: Tensor, inputs: Tensor) -> Tensor:
        """Predictions (W,) from the last layer's output (hidden, W) and the inputs (W, F)."""
        prediction = torch.addmm(self.head.bias, output.t(), self.head.weight.t()).squeeze(1)
        # Saturating gates turn an infinite input into a finite prediction; 0·inf = NaN puts the truth back.
        return prediction.add_(inputs.sum(1).mul_(0.0))

    def outside(self, inputs: Tensor) -> Tensor:
        """Share of the inputs (..., F) outside the range of the data it was fitted on, (...,); NaN is outside."""
        outside = inputs.clamp(self.input_low, self.input_high) != inputs
        return outside.mean(-1, dtype=torch.float32)

    def _weights(self) -> list[tuple[Tensor, Tensor]]:
        """Per layer: one matrix (4·hidden, inputs + hidden) over [x; h], one bias (4·hidden, 1).

        The gates come in the order input, forget, output, candidate, so that the three sigmoids are
        neighbours. While training nothing is kept, since the weights move.
        """
        if self._folded is not None:
            return self._folded
        folded = []
        for layer in range(self.config.layers):
            from_x = getattr(self.lstm, f"weight_ih_l{layer}").double()
            from_h = getattr(self.lstm, f"weight_hh_l{layer}").double()
            bias = (getattr(self.lstm, f"bias_ih_l{layer}") + getattr(self.lstm, f"bias_hh_l{layer}")).double()
            if layer == 0:  # W (x − mean)/std + b = (W/std) x + (b − (W/std) mean)
                from_x = from_x / self.feature_std
                bias = bias - from_x @ self.feature_mean.double()
            i, f, g, o = torch.cat((from_x, from_h), 1).float().chunk(4)
            bi, bf, bg, bo = bias.float().chunk(4)
            folded.append((torch.cat((i, f, o, g)).contiguous(), torch.cat((bi, bf, bo, bg))[:, None].contiguous()))
        if not self.training:
            self._folded = folded
        return folded

    def train(self, mode: bool = True) -> MeasurementModel:
        self._folded = None
        return super().train(mode)

    def _apply(self, fn, recurse: bool = True):  # .to(device), .double(), ...
        self._folded = None
        return super()._apply(fn, recurse)

    def _load_from_state_dict(self, *args, **kwargs) -> None:
        self._folded = None
        super()._load_from_state_dict(*args, **kwargs)


def _pairs(sizes: Sequence[int]) -> tuple[tuple[slice, slice], ...]:
    """Places of every two input channels (also one with itself) that have the same size."""
    edges = np.cumsum([0, *sizes])
    parts = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    pairs = itertools.combinations_with_replacement(parts, 2)
    return tuple((a, b) for a, b in pairs if a.stop - a.start == b.stop - b.start)


def gather(channels: Mapping[str, Tensor], names: Sequence[str], num_worlds: int) -> Tensor:
    """Input channels side by side, (W, F): each entry (..., size) or (...,) with W leading elements."""
    return torch.cat([channels[name].reshape(num_worlds, -1) for name in names], 1)


def stack_channels(channels: Mapping[str, np.ndarray], names: Sequence[str]) -> np.ndarray:
    """The same for recordings: each entry (T, *shape) -> (T, F) float32."""
    return np.concatenate(
        [np.asarray(channels[name], dtype=np.float32).reshape(len(channels[name]), -1) for name in names], 1
    )
