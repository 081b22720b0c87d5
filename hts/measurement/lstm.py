"""`lstm`: a small recurrent network, the measurement model for what has a memory.

One network, two ways to run it: `sequence` over recordings while fitting (torch's fused LSTM), and `step`
inside the env loop, where 384 worlds every 20 ms leave no room for overhead. `step` therefore folds the
z-scoring into the first layer's weights and keeps the worlds in columns, so that each gate is one
contiguous block: 0.5 ms a step for 384 worlds × 24 inputs × 64 units on one 2.5 GHz core,
where `torch.nn.LSTM` took 0.8 ms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import torch
from pydantic import Field
from torch import Tensor, nn

from hts.config import Config
from hts.contracts import MeasurementModel, ModelContext, Prediction, Signals
from hts.measurement.torch_model import TorchModel

if TYPE_CHECKING:
    from hts.measurement.fit_settings import FitSettings
    from hts.recordings.recording import Recording


class LSTMSettings(Config):
    """Settings of measurement model `lstm`: the network, and how it is fitted."""

    products: bool = Field(
        False, description="also feed the squares of the inputs and the products of inputs of one size, place by place"
    )
    hidden: int = Field(64, ge=1, description="units per layer")
    layers: int = Field(1, ge=1, le=4, description="recurrent layers")
    learning_rate: float = Field(4e-3, gt=0, description="peak step size of Adam")
    sequence: int = Field(50, ge=2, description="samples of truncated back-propagation through time")
    stream: int = Field(1000, ge=2, description="samples from one empty memory to the next; about an episode")
    batch: int = Field(32, ge=1, description="streams side by side, at most")
    patience: int | None = Field(
        None, ge=1, description="stop after so many epochs without a better one; null: a third of all"
    )


def make(settings: Mapping[str, Any], context: ModelContext) -> MeasurementModel:
    """From plain settings."""
    return LSTM(LSTMSettings.model_validate(dict(settings)), context.signals)


class LSTM(TorchModel):
    """An LSTM with a linear head between z-scored features and a z-scored target.

    The memory of W worlds is (W, layers, 2, hidden): outputs h, then cells c. It is a view of (layers, 2, hidden, W),
    worlds last, in which the gates are computed; a state that is laid out in another way is taken too, and copied.
    """

    def __init__(self, config: LSTMSettings, signals: Signals, seed: int = 0) -> None:
        super().__init__(signals, config.products)
        self.config = config
        # Made on "meta": torch's own initialisation would draw from the global generator, and so tie the
        # model to whatever ran before it.
        lstm = nn.LSTM(self.num_features, config.hidden, config.layers, batch_first=True, device="meta")
        self.lstm = lstm.to_empty(device="cpu")
        self.head = nn.Linear(config.hidden, 1, device="meta").to_empty(device="cpu")
        self.initialise(seed)
        self.requires_grad_(False).eval()

    @property
    def settings(self) -> Mapping[str, Any]:
        return self.config.model_dump(mode="json")

    @torch.no_grad()
    def initialise(self, seed: int) -> None:
        """As if never fitted. Uniform ±1/√hidden as in torch; forget biases 1, so that memory lasts from the start
        (Gers et al. 2000)."""
        generator = torch.Generator().manual_seed(seed)
        bound = self.config.hidden**-0.5
        for parameter in self.parameters():
            parameter.uniform_(-bound, bound, generator=generator)
        hidden = self.config.hidden
        for layer in range(self.config.layers):
            getattr(self.lstm, f"bias_ih_l{layer}")[hidden : 2 * hidden] = 1.0
            getattr(self.lstm, f"bias_hh_l{layer}")[hidden : 2 * hidden] = 0.0
        self.input_low.fill_(-torch.inf)
        self.input_high.fill_(torch.inf)
        self._folded = None

    def learn(self, recordings: Sequence[Recording], how: FitSettings) -> dict[str, Any]:
        """See `hts.measurement.lstm_fit`."""
        from hts.measurement.lstm_fit import fit_lstm

        return fit_lstm(self, recordings, how)

    def same_shape(self, other: MeasurementModel) -> bool:
        """Whether the other model's numbers fit into this one."""
        return (
            isinstance(other, LSTM)
            and (other.signals.names, other.signals.sizes) == (self.signals.names, self.signals.sizes)
            and (other.signals.target.name, other.signals.rate_hz) == (self.signals.target.name, self.signals.rate_hz)
            and (other.config.products, other.config.hidden, other.config.layers)
            == (self.config.products, self.config.hidden, self.config.layers)
        )

    @torch.no_grad()
    def _before_statistics(self, mean: Tensor, std: Tensor, target_mean: Tensor, target_std: Tensor) -> None:
        """A model that was fitted before stays the same function: change the weights so that with the new statistics it
        predicts what it predicted with the old ones."""
        if not torch.isfinite(self.input_low).all():  # never fitted
            return
        weight, bias = self.lstm.weight_ih_l0, self.lstm.bias_ih_l0
        old_mean, old_std = self.feature_mean.double(), self.feature_std.double()
        # z_old = (x - m)/s and z_new = (x - m')/s', so z_old = z_new s'/s + (m' - m)/s
        bias += (weight.double() @ ((mean - old_mean) / old_std)).to(bias.dtype)
        weight *= (std / old_std).to(weight.dtype)
        scale, shift = self.target_std / target_std, (self.target_mean - target_mean) / target_std
        self.head.weight *= scale
        self.head.bias.mul_(scale).add_(shift)

    # --------------------------------------------------------------------------------------------- running

    def initial_state(self, num_worlds: int) -> Tensor:
        shape = (self.config.layers, 2, self.config.hidden, num_worlds)
        return worlds_first(torch.zeros(shape, device=self.device))

    def reset(self, state: Tensor, begun: Tensor) -> Tensor:
        # Not a product: a world that ended in NaN must start clean.
        return worlds_first(worlds_last(state).masked_fill(begun, 0.0))

    def sequence(self, inputs: Tensor, state: Tensor | None = None) -> tuple[Prediction, Tensor]:
        past = None
        if state is not None:
            past = tuple(part.transpose(0, 1).contiguous() for part in state.unbind(2))
        output, (h, c) = self.lstm(self.scaled_features(inputs), past)
        return Prediction(self.head(output).squeeze(-1)), torch.stack((h, c), 1).permute(2, 0, 1, 3)

    @torch.no_grad()
    def step(self, inputs: Tensor, state: Tensor) -> tuple[Prediction, Tensor]:
        first, states = inputs.t(), []
        below = (first, *(first[a] * first[b] for a, b in self._pairs))
        for layer, (h, c) in zip(self._weights(), worlds_last(state), strict=True):
            h, cell = self._cell(layer, (*below, h), c)
            below = (h,)
            states.append(torch.stack((h, cell)))
        return Prediction(self._read(below[0], inputs)), worlds_first(torch.stack(states))

    @torch.no_grad()
    def steps(self, inputs: Tensor, state: Tensor, ended: Tensor) -> tuple[Prediction, Tensor]:
        """To the bit the same as step by step, with less done per step. For a CPU: it looks where episodes ended."""
        each = inputs.transpose(1, 2)
        features = torch.cat((each, *(each[:, a] * each[:, b] for a, b in self._pairs)), 1)
        empty, memory = ended.any(1).tolist(), [list(pair) for pair in worlds_last(state)]
        outputs = torch.empty(len(inputs), self.config.hidden, inputs.shape[1], device=inputs.device)
        for time, below in enumerate(features):
            for layer, pair in zip(self._weights(), memory, strict=True):
                pair[:] = self._cell(layer, (below, pair[0]), pair[1])
                below = pair[0]
            outputs[time] = below
            if empty[time]:
                memory = [[part.masked_fill(ended[time], 0.0) for part in pair] for pair in memory]
        predictions = [self._read(output, input) for output, input in zip(outputs, inputs, strict=True)]
        after = torch.stack([torch.stack(pair) for pair in memory])
        return Prediction(torch.stack(predictions)), worlds_first(after)

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


def worlds_first(memory: Tensor) -> Tensor:
    """(layers, 2, hidden, W) -> (W, layers, 2, hidden), the same memory."""
    return memory.permute(3, 0, 1, 2)


def worlds_last(state: Tensor) -> Tensor:
    """(W, layers, 2, hidden) -> (layers, 2, hidden, W), contiguous: without a copy where `worlds_first` made it."""
    return state.permute(1, 2, 3, 0).contiguous()
