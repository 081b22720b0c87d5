"""Fitting an LSTM to recordings, by truncated back-propagation through time.

Recordings are cut into streams as long as an episode. A stream starts with an empty memory, as a world does
after a reset, and keeps it from one stretch of `sequence` samples to the next; only gradients stop there.
So the model is trained in the regime in which the env runs it: a start from nothing, then a long run.
"""

from __future__ import annotations

import copy
import itertools
import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from hts.errors import RecordingError
from hts.measurement.data import Piece, split_ends, training_data
from hts.measurement.scoring import explained
from hts.rl.threads import one_thread

if TYPE_CHECKING:
    from hts.contracts.measurement_model import Progress
    from hts.measurement.fit_settings import FitSettings
    from hts.measurement.lstm import LSTM, LSTMSettings
    from hts.recordings.recording import Recording

GRADIENT_NORM = 1.0
WARM_UP = 0.05  # share of the updates in which the step size rises to its peak
Memory = tuple[Tensor, Tensor]  # h and c, each (layers, B, hidden)


def fit_lstm(model: LSTM, recordings: Sequence[Recording], how: FitSettings) -> dict[str, Any]:
    """Fit the model in place; see `MeasurementModel.fit` for what is given and kept.

    Adam with clipped gradients and a cosine step size; the epoch with the least error on the last 10 % of each
    recording is kept. Stops early after `patience` epochs without a better one, or after the epoch in which
    `max_seconds` have passed. The report: samples, epochs, best_epoch, stopped, warm_started, validation_r2 (None if
    nothing varies there), and the error of each epoch in z-scores as `curve`.
    """
    began = time.monotonic()
    pieces = training_data(model.signals, recordings)
    before = how.warm_start if how.warm_start is not None and model.same_shape(how.warm_start) else None
    if before is not None:
        model.load_tensors({name: value.clone() for name, value in before.tensors().items()})
    else:
        model.initialise(how.seed)
    with one_thread(), trainable(model):
        model.set_statistics(torch.cat([piece.inputs for piece in pieces]), torch.cat([p.target for p in pieces]))
        pieces = [_normalise(model, piece) for piece in pieces]
        training, validation = split_ends(pieces, model.config.sequence)
        updates = how.epochs * _updates(training, model.config)
        passes = _Passes(model, training, validation, updates, 0.3 if before is not None else 1.0, how.seed)
        patience = model.config.patience or max(3, how.epochs // 3)
        search = _search(passes, how.epochs, patience, began + how.max_seconds, how.progress)
        model.load_tensors(search.best)
    return {
        "samples": sum(len(piece.target) for piece in pieces),
        "epochs": len(search.curve),
        "best_epoch": search.best_epoch,
        "stopped": search.stopped,
        "warm_started": before is not None,
        "validation_r2": explained(search.best_error, *_spread(validation or training)),
        "curve": search.curve,
    }


@contextmanager
def trainable(model: LSTM) -> Iterator[None]:
    """Its parameters take gradients; afterwards no longer, whatever happened."""
    model.requires_grad_(True)
    try:
        yield
    finally:
        model.requires_grad_(False).eval()


@dataclass
class _Search:
    """Where the best epoch so far was; best: its tensors."""

    best: dict[str, Tensor]
    best_error: float = math.inf
    best_epoch: int = 0
    stopped: str = "epochs"
    curve: list[dict[str, float]] = field(default_factory=list)


def _search(passes: _Passes, epochs: int, patience: int, until: float, progress: Progress | None) -> _Search:
    """Pass after pass, until there are enough, none gets better any more, or the time is up."""
    model = passes.model
    found = _Search(copy.deepcopy(model.state_dict()))
    for epoch in range(1, epochs + 1):
        error = passes.epoch()
        checked = _error(model, passes.validation) if passes.validation else error
        if not math.isfinite(checked):
            raise RecordingError(
                f"Fitting '{model.signals.target.name}': the error became {checked} in epoch {epoch}. Look for extreme "
                f"values in the recordings, or lower learning_rate (now {model.config.learning_rate:g})."
            )
        found.curve.append({"epoch": epoch, "training": error, "validation": checked})
        if checked < found.best_error:
            found.best, found.best_error, found.best_epoch = copy.deepcopy(model.state_dict()), checked, epoch
        if progress is not None:
            progress(epoch, epochs, checked)
        if time.monotonic() > until:
            found.stopped = "time"
            break
        if epoch - found.best_epoch >= patience:
            found.stopped = "patience"
            break
    return found


def _normalise(model: LSTM, piece: Piece) -> Piece:
    """Z-scored features (T, G) and target, once for all epochs."""
    return Piece(model.scaled_features(piece.inputs), model.normalise_target(piece.target))


# ---------------------------------------------------------------------------------------------- training


def _batch_size(training: Sequence[Piece], config: LSTMSettings) -> int:
    """Streams side by side: fewer with little data, so that an epoch still has some tens of updates.

    Not below 8 where there are as many: the time of an update hardly depends on its width there.
    """
    streams = math.ceil(sum(len(piece.target) for piece in training) / config.stream)
    return min(config.batch, streams, max(8, math.ceil(streams / 4)))


def _updates(training: Sequence[Piece], config: LSTMSettings) -> int:
    """About how many optimiser steps an epoch has."""
    streams = sum(math.ceil(len(piece.target) / config.stream) for piece in training)
    return math.ceil(streams / _batch_size(training, config)) * math.ceil(config.stream / config.sequence)


def _rate(update: int, updates: int, peak: float) -> float:
    """Factor on the step size: a linear rise to `peak`, then half a cosine to a hundredth."""
    warm_up = max(1, round(WARM_UP * updates))
    if update < warm_up:
        return peak * (update + 1) / warm_up
    done = min(1.0, (update - warm_up) / max(1, updates - warm_up))
    return peak * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * done)))


def _streams(training: Sequence[Piece], length: int, generator: torch.Generator) -> list[tuple[int, int, int]]:
    """(piece, start, stop) of this epoch's streams in random order; the cuts lie elsewhere in every epoch."""
    streams = []
    for index, piece in enumerate(training):
        total = len(piece.target)
        offset = int(torch.randint(length, (), generator=generator)) if total > length else 0
        edges = sorted({0, *range(offset, total, length), total})
        streams += [(index, start, stop) for start, stop in itertools.pairwise(edges)]
    order = torch.randperm(len(streams), generator=generator)
    return [streams[i] for i in order]


class _Passes:
    """Passes over the training data: model, optimiser, step sizes, and the generator that cuts and orders streams."""

    def __init__(
        self, model: LSTM, training: Sequence[Piece], validation: Sequence[Piece], updates: int, peak: float, seed: int
    ) -> None:
        self.model, self.training, self.validation = model, training, validation
        self.generator = torch.Generator().manual_seed(seed)
        self.optimiser = torch.optim.Adam(model.parameters(), lr=model.config.learning_rate)
        self.rates = torch.optim.lr_scheduler.LambdaLR(self.optimiser, lambda update: _rate(update, updates, peak))

    def epoch(self) -> float:
        """One pass; mean squared error in z-scores."""
        self.model.train()
        config, training = self.model.config, self.training
        streams, batch = _streams(training, config.stream, self.generator), _batch_size(training, config)
        squared, count = 0.0, 0.0
        for first in range(0, len(streams), batch):
            group = [
                Piece(training[i].inputs[a:b], training[i].target[a:b]) for i, a, b in streams[first : first + batch]
            ]
            inputs, target, weight = _pad(group)
            state = None
            for start in range(0, inputs.shape[1], config.sequence):
                part = slice(start, start + config.sequence)
                scored = weight[:, part].sum()
                predicted, state = _run(self.model, inputs[:, part], state)
                loss = (weight[:, part] * (predicted - target[:, part]) ** 2).sum()
                self._update(loss / scored)
                state = (state[0].detach(), state[1].detach())
                squared, count = squared + float(loss.detach()), count + float(scored)
        return squared / count

    def _update(self, loss: Tensor) -> None:
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), GRADIENT_NORM)
        self.optimiser.step()
        self.rates.step()


@torch.no_grad()
def _error(model: LSTM, pieces: Sequence[Piece]) -> float:
    """Mean squared error in z-scores over the scored samples."""
    model.eval()
    inputs, target, weight = _pad(pieces)
    predicted, _ = _run(model, inputs, None)
    return float((weight * (predicted - target) ** 2).sum() / weight.sum())


def _run(model: LSTM, features: Tensor, state: Memory | None) -> tuple[Tensor, Memory]:
    """The network on features that were z-scored once beforehand; the memory stays in torch's own layout."""
    output, state = model.lstm(features, state)
    return model.head(output).squeeze(-1), state


def _pad(pieces: Sequence[Piece]) -> tuple[Tensor, Tensor, Tensor]:
    """Inputs (B, T, F), target (B, T) and weight (B, T), which is 0 on padding and skipped samples."""
    inputs = pad_sequence([piece.inputs for piece in pieces], batch_first=True)
    target = pad_sequence([piece.target for piece in pieces], batch_first=True)
    counts = [(torch.arange(len(piece.target)) >= piece.skip).float() for piece in pieces]
    return inputs, target, pad_sequence(counts, batch_first=True)


def _spread(pieces: Sequence[Piece]) -> tuple[float, float]:
    """Variance and mean square of the scored samples; 0 where they are all one number."""
    target = torch.cat([piece.target[piece.skip :] for piece in pieces])
    if bool((target == target[0]).all()):  # single precision leaves more of a constant than double
        return 0.0, 0.0
    return float(target.var(correction=0)), float(target.square().mean())
