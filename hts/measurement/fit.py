"""Fitting a measurement model to recordings, by truncated back-propagation through time.

Recordings are cut into streams as long as an episode. A stream starts with an empty memory, as a world does
after a reset, and keeps it from one stretch of `sequence` samples to the next; only gradients stop there.
So the model is trained in the regime in which the env runs it: a start from nothing, then a long run.
"""

from __future__ import annotations

import copy
import itertools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from hts.errors import RecordingError
from hts.measurement.models import MeasurementModel, MeasurementModelConfig, stack_channels

if TYPE_CHECKING:
    from hts.recordings.recording import Recording

VALIDATION_SHARE = 0.1  # end of each training recording: chooses the epoch, is not trained on, not reported as held out
GRADIENT_NORM = 1.0
WARM_UP = 0.05  # share of the updates in which the step size rises to its peak
Progress = Callable[[int, int, float], None]
Memory = tuple[Tensor, Tensor]  # h and c, each (layers, B, hidden)


@dataclass
class FitResult:
    """A fitted model in evaluation mode, and a report of plain JSON values."""

    model: MeasurementModel
    report: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class _Piece:
    """Part of a recording: inputs (T, F), later features (T, G), and target (T,); the first `skip` are not scored."""

    inputs: Tensor
    target: Tensor
    skip: int = 0


def fit(
    config: MeasurementModelConfig,
    recordings: Sequence[Recording],
    *,
    seed: int = 0,
    epochs: int = 20,
    max_seconds: float = math.inf,
    patience: int | None = None,
    warm_start: MeasurementModel | None = None,
    progress: Progress | None = None,
) -> FitResult:
    """Fit a model to all the given recordings (what is held out stays with the caller, see `checks.split`).

    Adam with clipped gradients and a cosine step size; the epoch with the least error on the last 10 % of each
    recording is kept. Stops early after `patience` epochs without a better one (default: a third of `epochs`),
    or after the epoch in which `max_seconds` have passed. warm_start: a model to go on from, used if it has the
    same shape. progress(epoch, epochs, validation_mse) is called after each epoch; the error is in z-scores.
    The same recordings, seed and epochs give the same model, unless time ran out.
    Raises RecordingError for recordings that cannot be learned from.
    """
    threads = torch.get_num_threads()
    # One thread: on two cores a second one gains nothing on matrices this small (it loses tenfold when the machine
    # is busy), and sums then do not depend on how many cores there are.
    torch.set_num_threads(1)
    try:
        return _fit(config, recordings, seed, epochs, max_seconds, patience, warm_start, progress)
    finally:
        torch.set_num_threads(threads)


def _fit(
    config: MeasurementModelConfig,
    recordings: Sequence[Recording],
    seed: int,
    epochs: int,
    max_seconds: float,
    patience: int | None,
    warm_start: MeasurementModel | None,
    progress: Progress | None,
) -> FitResult:
    began = time.monotonic()
    pieces, sizes, rate = _load(config, recordings)
    model = _start(config, sizes, rate, seed, warm_start)
    warm = model is not None
    if model is None:
        model = MeasurementModel(config, sizes, rate, seed)
    model.set_normaliser(torch.cat([piece.inputs for piece in pieces]), torch.cat([piece.target for piece in pieces]))
    pieces = [_normalise(model, piece) for piece in pieces]
    training, validation = _split_ends(pieces, config.sequence)

    generator = torch.Generator().manual_seed(seed)
    optimiser = torch.optim.Adam(model.parameters(), lr=config.learning_rate)
    updates = epochs * _updates(training, config)
    rates = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda update: _rate(update, updates, 0.3 if warm else 1.0))
    patience = patience or max(3, epochs // 3)
    curve: list[dict[str, float]] = []
    best, best_error, best_epoch, stopped = copy.deepcopy(model.state_dict()), math.inf, 0, "epochs"
    for epoch in range(1, epochs + 1):
        error = _epoch(model, training, config, optimiser, rates, generator)
        checked = _error(model, validation) if validation else error
        if not math.isfinite(checked):
            raise RecordingError(
                f"Fitting '{config.target}': the error became {checked} in epoch {epoch}. "
                f"Look for extreme values in the recordings, or lower learning_rate (now {config.learning_rate:g})."
            )
        curve.append({"epoch": epoch, "training": error, "validation": checked})
        if checked < best_error:
            best, best_error, best_epoch = copy.deepcopy(model.state_dict()), checked, epoch
        if progress is not None:
            progress(epoch, epochs, checked)
        if time.monotonic() - began > max_seconds:
            stopped = "time"
            break
        if epoch - best_epoch >= patience:
            stopped = "patience"
            break
    model.load_state_dict(best)
    model.requires_grad_(False).eval()
    report = {
        "samples": sum(len(piece.target) for piece in pieces),
        "recordings": len(recordings),
        "seed": seed,
        "epochs": len(curve),
        "best_epoch": best_epoch,
        "stopped": stopped,
        "warm_started": warm,
        "validation_r2": 1.0 - best_error / _variance(validation or training),
        "seconds": time.monotonic() - began,
        "curve": curve,
    }
    return FitResult(model, report)


# ------------------------------------------------------------------------------------------------- data


def _load(
    config: MeasurementModelConfig, recordings: Sequence[Recording]
) -> tuple[list[_Piece], tuple[int, ...], float]:
    """Pieces in channel units, the size of each input channel, and the common rate."""
    if not recordings:
        raise RecordingError(f"No recordings to fit '{config.target}' to. Record or import some first.")
    first = recordings[0]
    sizes = tuple(int(first.values(name)[0].size) for name in config.inputs)
    pieces = []
    for recording in recordings:
        where = f"Recording {recording.id or '(not stored)'}"
        if recording.rate_hz != first.rate_hz:
            raise RecordingError(
                f"{where} has {recording.rate_hz:g} Hz, the first one {first.rate_hz:g} Hz. "
                "A model counts in samples: resample to one rate when importing."
            )
        if tuple(recording.joint_names) != tuple(first.joint_names):
            raise RecordingError(
                f"{where} has other joints, or another joint order, than the first one. "
                "Fit each robot's recordings by themselves."
            )
        values = {name: recording.values(name) for name in (*config.inputs, config.target)}
        for name, series in values.items():
            finite = torch.isfinite(torch.from_numpy(series)).flatten(1 if series.ndim > 1 else 0)
            if not finite.all():
                raise RecordingError(f"{where}: '{name}' holds values that are not finite. Import it again.")
        if values[config.target].size != recording.num_samples:
            shape = values[config.target].shape
            raise RecordingError(f"{where}: '{config.target}' has shape {shape}, expected one number a sample.")
        inputs = torch.from_numpy(stack_channels(values, config.inputs))
        if inputs.shape[1] != sum(sizes):
            raise RecordingError(f"{where}: {inputs.shape[1]} input numbers a sample, the first one has {sum(sizes)}.")
        pieces.append(_Piece(inputs, torch.from_numpy(values[config.target].reshape(-1).copy())))
    return pieces, sizes, float(first.rate_hz)


def _normalise(model: MeasurementModel, piece: _Piece) -> _Piece:
    """Z-scored features (T, G) and target, once for all epochs."""
    features = (model.features(piece.inputs) - model.feature_mean) / model.feature_std
    return _Piece(features, model.normalise_target(piece.target))


def _split_ends(pieces: Sequence[_Piece], run_in: int) -> tuple[list[_Piece], list[_Piece]]:
    """Training parts, and the ends for validation, each after a run-in that fills the model's memory."""
    training, validation = [], []
    for piece in pieces:
        count = round(VALIDATION_SHARE * len(piece.target))
        if count < run_in // 2:  # too short to say anything
            training.append(piece)
            continue
        cut = len(piece.target) - count
        training.append(_Piece(piece.inputs[:cut], piece.target[:cut]))
        start = max(0, cut - run_in)
        validation.append(_Piece(piece.inputs[start:], piece.target[start:], cut - start))
    return training, validation


def _start(
    config: MeasurementModelConfig,
    sizes: tuple[int, ...],
    rate: float,
    seed: int,
    warm_start: MeasurementModel | None,
) -> MeasurementModel | None:
    """A copy of the model to go on from, with this config; None if there is none or its shape differs."""
    if warm_start is None:
        return None
    how = {"learning_rate", "sequence", "stream", "batch"}  # may differ; everything else is the shape
    if config.model_dump(exclude=how) != warm_start.config.model_dump(exclude=how):
        return None
    if (sizes, rate) != (warm_start.input_sizes, warm_start.rate_hz):
        return None
    model = MeasurementModel(config, sizes, rate, seed)
    model.load_state_dict(warm_start.state_dict())
    return model


# ---------------------------------------------------------------------------------------------- training


def _batch_size(training: Sequence[_Piece], config: MeasurementModelConfig) -> int:
    """Streams side by side: fewer with little data, so that an epoch still has some tens of updates.

    Not below 8 where there are as many: the time of an update hardly depends on its width there.
    """
    streams = math.ceil(sum(len(piece.target) for piece in training) / config.stream)
    return min(config.batch, streams, max(8, math.ceil(streams / 4)))


def _updates(training: Sequence[_Piece], config: MeasurementModelConfig) -> int:
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


def _streams(training: Sequence[_Piece], length: int, generator: torch.Generator) -> list[tuple[int, int, int]]:
    """(piece, start, stop) of this epoch's streams in random order; the cuts lie elsewhere in every epoch."""
    streams = []
    for index, piece in enumerate(training):
        total = len(piece.target)
        offset = int(torch.randint(length, (), generator=generator)) if total > length else 0
        edges = sorted({0, *range(offset, total, length), total})
        streams += [(index, start, stop) for start, stop in itertools.pairwise(edges)]
    order = torch.randperm(len(streams), generator=generator)
    return [streams[i] for i in order]


def _epoch(
    model: MeasurementModel,
    training: Sequence[_Piece],
    config: MeasurementModelConfig,
    optimiser: torch.optim.Optimizer,
    rates: torch.optim.lr_scheduler.LRScheduler,
    generator: torch.Generator,
) -> float:
    """One pass over the data; mean squared error in z-scores."""
    model.train()
    streams, batch = _streams(training, config.stream, generator), _batch_size(training, config)
    squared, count = 0.0, 0.0
    for first in range(0, len(streams), batch):
        group = [_Piece(training[i].inputs[a:b], training[i].target[a:b]) for i, a, b in streams[first : first + batch]]
        inputs, target, weight = _pad(group)
        state = None
        for start in range(0, inputs.shape[1], config.sequence):
            part = slice(start, start + config.sequence)
            scored = weight[:, part].sum()
            predicted, state = _run(model, inputs[:, part], state)
            loss = (weight[:, part] * (predicted - target[:, part]) ** 2).sum()
            optimiser.zero_grad(set_to_none=True)
            (loss / scored).backward()
            torch.nn.utils.clip_grad_norm_(model.parameters(), GRADIENT_NORM)
            optimiser.step()
            rates.step()
            state = (state[0].detach(), state[1].detach())
            squared, count = squared + float(loss.detach()), count + float(scored)
    return squared / count


@torch.no_grad()
def _error(model: MeasurementModel, pieces: Sequence[_Piece]) -> float:
    """Mean squared error in z-scores over the scored samples."""
    model.eval()
    inputs, target, weight = _pad(pieces)
    predicted, _ = _run(model, inputs, None)
    return float((weight * (predicted - target) ** 2).sum() / weight.sum())


def _run(model: MeasurementModel, features: Tensor, state: Memory | None) -> tuple[Tensor, Memory]:
    """The network on features that were z-scored once beforehand; the memory stays in torch's own layout."""
    output, state = model.lstm(features, state)
    return model.head(output).squeeze(-1), state


def _pad(pieces: Sequence[_Piece]) -> tuple[Tensor, Tensor, Tensor]:
    """Inputs (B, T, F), target (B, T) and weight (B, T), which is 0 on padding and skipped samples."""
    longest = max(len(piece.target) for piece in pieces)
    inputs = torch.zeros(len(pieces), longest, pieces[0].inputs.shape[1])
    target, weight = torch.zeros(len(pieces), longest), torch.zeros(len(pieces), longest)
    for row, piece in enumerate(pieces):
        length = len(piece.target)
        inputs[row, :length], target[row, :length] = piece.inputs, piece.target
        weight[row, piece.skip : length] = 1.0
    return inputs, target, weight


def _variance(pieces: Sequence[_Piece]) -> float:
    return float(torch.cat([piece.target[piece.skip :] for piece in pieces]).var(correction=0))
