"""`linear`: ridge regression on inputs, their products and their past; every fit is compared with it.

    z(t) = b + Σ_ℓ w_ℓ · φ(t − ℓ)        φ: z-scored features, 0 (their mean) before an episode began; ℓ: lags

It is solved in one go. In the env it costs one small matrix product: the memory of a world is not its past, but what
that past will still add to each of the next predictions.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import torch
from pydantic import Field
from torch import Tensor

from hts.config import Config
from hts.contracts import MeasurementModel, ModelContext, Prediction, Signals
from hts.measurement.data import VALIDATION_SHARE, Piece, training_data
from hts.measurement.lstm_fit import one_thread
from hts.measurement.torch_model import TorchModel

if TYPE_CHECKING:
    from hts.contracts.measurement_model import Progress
    from hts.recordings.recording import Recording

RIDGES = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)  # per sample; features have variance 1


class LinearSettings(Config):
    """Settings of measurement model `linear`."""

    products: bool = Field(
        True, description="also feed the squares of the inputs and the products of inputs of one size, place by place"
    )
    lag_seconds: float = Field(0.4, ge=0, description="how far back the features reach, s")
    lags: int = Field(10, ge=0, description="how many past samples within that, evenly spread, beside the present one")
    ridge: float | None = Field(
        None, ge=0, description="penalty on squared weights, per sample; null: the best on the ends of the recordings"
    )


def make(settings: Mapping[str, Any], context: ModelContext) -> MeasurementModel:
    """From plain settings."""
    return Linear(LinearSettings.model_validate(dict(settings)), context.signals)


class Linear(TorchModel):
    """weight: (L, G), one row per lag; bias: (). The memory of W worlds is (W, M): what the past adds to the next M
    predictions, M the longest lag in samples."""

    def __init__(self, config: LinearSettings, signals: Signals) -> None:
        super().__init__(signals, config.products)
        self.config = config
        self.lags = _lags(config, signals.rate_hz)
        self.register_buffer("weight", torch.zeros(len(self.lags), self.num_features))
        self.register_buffer("bias", torch.tensor(0.0))
        self.eval()

    @property
    def settings(self) -> Mapping[str, Any]:
        return self.config.model_dump(mode="json")

    @torch.no_grad()
    def fit(
        self,
        recordings: Sequence[Recording],
        *,
        seed: int = 0,
        epochs: int = 20,
        max_seconds: float = math.inf,
        progress: Progress | None = None,
        warm_start: MeasurementModel | None = None,
    ) -> dict[str, Any]:
        """Least squares, in double precision; seed, epochs and warm start have nothing to change in it."""
        began = time.monotonic()
        pieces = training_data(self.signals, recordings)
        with one_thread():
            self.set_statistics(torch.cat([p.inputs for p in pieces]), torch.cat([p.target for p in pieces]))
            inner, ends = self._moments(pieces)
            ridges = RIDGES if self.config.ridge is None else (self.config.ridge,)
            errors = {ridge: ends.error(inner.solved(ridge)) for ridge in ridges}
            ridge = min(ridges, key=lambda one: errors[one])
            solution = inner.plus(ends).solved(ridge)
        self.weight.copy_(solution[:-1].view_as(self.weight))
        self.bias.copy_(solution[-1])
        self._folded = None
        if progress is not None:
            progress(1, 1, errors[ridge])
        return {
            "samples": sum(len(piece.target) for piece in pieces),
            "recordings": len(recordings),
            "seed": seed,
            "epochs": 1,
            "stopped": "solved",
            "warm_started": False,
            "ridge": ridge,
            "validation_r2": 1.0 - errors[ridge] / ends.variance(),
            "seconds": time.monotonic() - began,
        }

    def _moments(self, pieces: Sequence[Piece]) -> tuple[_Moments, _Moments]:
        """Of the beginnings of all recordings, and of their ends, which choose the penalty."""
        width = len(self.lags) * self.num_features + 1
        inner, ends = _Moments(width), _Moments(width)
        for piece in pieces:
            features = self.scaled_features(piece.inputs).double()
            columns = [
                torch.cat((features.new_zeros(lag, self.num_features), features))[: len(features)] for lag in self.lags
            ]
            design = torch.cat((*columns, features.new_ones(len(features), 1)), 1)
            target = self.normalise_target(piece.target).double()
            cut = len(target) - max(1, round(VALIDATION_SHARE * len(target)))
            start = min(
                self.lags[-1], cut // 2
            )  # before a recording the robot did walk: its past there is not the mean
            inner.add(design[start:cut], target[start:cut])
            ends.add(design[cut:], target[cut:])
        return inner, ends

    # --------------------------------------------------------------------------------------------- running

    def initial_state(self, num_worlds: int) -> Tensor:
        return torch.zeros(num_worlds, self.lags[-1], device=self.device)

    def reset(self, state: Tensor, begun: Tensor) -> Tensor:
        return state.masked_fill(begun[:, None], 0.0)

    def sequence(self, inputs: Tensor, state: Tensor | None = None) -> tuple[Prediction, Tensor]:
        weight, constant = self._weights()
        added = self.features(inputs) @ weight.t() + constant  # (B, T, M + 1): to the prediction now, and to the next M
        batch, length, ahead = added.shape
        total = added.new_zeros(batch, length + ahead - 1)
        if state is not None:
            total[:, : ahead - 1] += state
        for lag in range(ahead):
            total[:, lag : lag + length] += added[..., lag]
        return Prediction(total[:, :length] + self.bias), total[:, length:]

    @torch.no_grad()
    def step(self, inputs: Tensor, state: Tensor) -> tuple[Prediction, Tensor]:
        weight, constant = self._weights()
        added = torch.addmm(constant, self.features(inputs), weight.t())
        total = added + torch.cat((state, torch.zeros_like(added[:, :1])), 1)
        return Prediction(total[:, 0] + self.bias), total[:, 1:]

    def _weights(self) -> tuple[Tensor, Tensor]:
        """(M + 1, G) and (M + 1,): what features in channel units add to the predictions 0…M samples later."""
        if self._folded is None:
            scaled = self.weight.double() / self.feature_std
            weight = scaled.new_zeros(self.lags[-1] + 1, self.num_features)
            weight[list(self.lags)] = scaled
            self._folded = weight.float(), -(weight @ self.feature_mean.double()).float()
        return self._folded


def _lags(config: LinearSettings, rate_hz: float) -> tuple[int, ...]:
    """Lags in samples, increasing, 0 first."""
    longest = config.lag_seconds * rate_hz if config.lags else 0.0
    return tuple(sorted({round(longest * step / max(1, config.lags)) for step in range(config.lags + 1)}))


class _Moments:
    """XᵀX, Xᵀy and yᵀy of a regression, summed up piece by piece; the last column of X is 1 and not penalised."""

    def __init__(self, width: int) -> None:
        self.count = 0
        self.xx, self.xy = torch.zeros(width, width, dtype=torch.double), torch.zeros(width, dtype=torch.double)
        self.yy, self.y = torch.zeros((), dtype=torch.double), torch.zeros((), dtype=torch.double)

    def add(self, x: Tensor, y: Tensor) -> None:
        self.count += len(y)
        self.xx += x.t() @ x
        self.xy += x.t() @ y
        self.yy += y @ y
        self.y += y.sum()

    def plus(self, other: _Moments) -> _Moments:
        both = _Moments(len(self.xy))
        both.count = self.count + other.count
        both.xx, both.xy = self.xx + other.xx, self.xy + other.xy
        both.yy, both.y = self.yy + other.yy, self.y + other.y
        return both

    def solved(self, ridge: float) -> Tensor:
        """argmin |Xw − y|² + ridge · count · |w|², without the last of w in the penalty."""
        penalty = torch.full_like(self.xy, ridge * max(1, self.count))
        penalty[-1] = 0.0
        # A trace of it everywhere: a feature that never varied has an empty column.
        return torch.linalg.solve(self.xx + torch.diag(penalty + 1e-9 * max(1, self.count)), self.xy)

    def error(self, w: Tensor) -> float:
        """Mean squared error."""
        return float(self.yy - 2 * w @ self.xy + w @ self.xx @ w) / self.count

    def variance(self) -> float:
        return float(self.yy / self.count - (self.y / self.count) ** 2)
