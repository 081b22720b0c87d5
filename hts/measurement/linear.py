"""`linear`: ridge regression on inputs, their products and their past; every fit is compared with it.

    z(t) = b + Σ_ℓ w_ℓ · φ(t − ℓ)        φ: z-scored features, 0 (their mean) before an episode began; ℓ: lags

It is solved in one go; how much is penalised, how far back it looks and how much joints share is chosen by
cross-validation inside the recordings (`hts.measurement.ridge`). In the env it costs one small matrix product: the
memory of a world is not its past, but what that past will still add to each of the next predictions.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import torch
from pydantic import Field
from torch import Tensor

from hts.config import Config
from hts.contracts import MeasurementModel, ModelContext, Prediction, Signals
from hts.measurement.data import Piece, training_data
from hts.measurement.ridge import POOLINGS, RIDGES, Moments, chosen, parts_left_out, penalty_of
from hts.measurement.scoring import explained
from hts.measurement.torch_model import TorchModel
from hts.rl.threads import one_thread

if TYPE_CHECKING:
    from hts.measurement.fit_settings import FitSettings
    from hts.recordings.recording import Recording


class LinearSettings(Config):
    """Settings of measurement model `linear`."""

    products: bool = Field(
        True, description="also feed the squares of the inputs and the products of inputs of one size, place by place"
    )
    lag_seconds: float = Field(0.4, ge=0, description="how far back the features reach, s")
    lags: int = Field(
        10,
        ge=0,
        description="how many past samples within that, evenly spread, beside the present one; where cross-validation "
        "finds the older ones of no use, they weigh nothing",
    )
    ridge: float | None = Field(
        None, ge=0, description="penalty on squared weights, per sample; null: by cross-validation"
    )
    pooling: float | None = Field(
        None,
        ge=1,
        description="κ: by how much less the coefficient that components of a channel share is penalised than what "
        "each has of its own; 1: nothing is shared; null: by cross-validation",
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
    def learn(self, recordings: Sequence[Recording], how: FitSettings) -> dict[str, Any]:
        """Least squares, in double precision; seed, epochs and warm start have nothing to change in it."""
        pieces, config = training_data(self.signals, recordings), self.config
        with one_thread():
            self.set_statistics(torch.cat([p.inputs for p in pieces]), torch.cat([p.target for p in pieces]))
            folds, rest = self._moments(pieces, recordings)
            ridges = RIDGES if config.ridge is None else (config.ridge,)
            poolings = POOLINGS if config.pooling is None else (config.pooling,)
            std, groups = self.feature_std, self.shared_features()
            found = chosen(folds, std, groups, len(self.lags), ridges, poolings if groups else (1.0,))
            tested = sum(folds[1:], start=folds[0])
            whole = sum(folds, start=rest).first(found.lags * self.num_features)
            solution = whole.solved(found.ridge * penalty_of(found.pooling, std, groups, found.lags))
        self.weight.zero_()
        self.weight[: found.lags] = solution[:-1].view(found.lags, -1)
        self.bias.copy_(solution[-1])
        self._folded = None
        if how.progress is not None:
            how.progress(1, 1, found.error)
        return {
            "samples": sum(len(piece.target) for piece in pieces),
            "epochs": 1,
            "stopped": "solved",
            "warm_started": False,
            "ridge": found.ridge,
            "pooling": found.pooling,
            "lag_seconds": self.lags[found.lags - 1] / self.signals.rate_hz,
            "validation_r2": explained(found.error, tested.variance(), float(tested.yy / tested.count)),
        }

    def shared_features(self) -> list[slice]:
        """Places of features that are the same thing of several components, such as of all joints."""
        sizes = (*self.signals.sizes, *(first.stop - first.start for first, _ in self._pairs))
        edges = list(itertools.accumulate(sizes, initial=0))
        return [slice(a, b) for a, b in itertools.pairwise(edges) if b - a > 1]

    def _moments(self, pieces: Sequence[Piece], recordings: Sequence[Recording]) -> tuple[list[Moments], Moments]:
        """Of each fold, and of the samples between two parts of a recording, which know something of both."""
        width, longest = len(self.lags) * self.num_features + 1, self.lags[-1]
        cuts = parts_left_out(recordings, [len(piece.target) for piece in pieces], self.signals.rate_hz)
        folds, between = defaultdict[int, Moments](lambda: Moments(width)), Moments(width)
        for piece, parts in zip(pieces, cuts, strict=True):
            features = self.scaled_features(piece.inputs).double()
            columns = [
                torch.cat((features.new_zeros(lag, self.num_features), features))[: len(features)] for lag in self.lags
            ]
            design = torch.cat((*columns, features.new_ones(len(features), 1)), 1)
            target = self.normalise_target(piece.target).double()
            # Before a recording the robot did move: its past there is not the mean.
            start = before = min(longest, len(target) // 2)
            for stop, fold in parts:
                if before > start:
                    known = slice(before, min(before + longest, stop))
                    between.add(design[known], target[known])
                    before = known.stop
                folds[fold].add(design[before:stop], target[before:stop])
                before = max(before, stop)
        return [folds[fold] for fold in sorted(folds) if folds[fold].count], between

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
