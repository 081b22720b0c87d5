"""Recordings as what a measurement model learns from: checked, and as tensors."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from hts.contracts import Signals
from hts.errors import RecordingError
from hts.units import same_unit

if TYPE_CHECKING:
    from hts.contracts import Objective
    from hts.recordings.recording import Recording

VALIDATION_SHARE = (
    0.1  # end of each training recording: chooses among fits, is not trained on, not reported as held out
)


@dataclass(frozen=True)
class Piece:
    """Part of a recording: inputs (T, F) or features (T, G), and target (T,); the first `skip` are not scored."""

    inputs: Tensor
    target: Tensor
    skip: int = 0


def recorded_signals(objective: Objective, recording: Recording) -> Signals:
    """What a model of the objective reads and predicts, with the shapes and units of a recording.
    Raises RecordingError."""
    for name in (*objective.inputs, objective.target.name):
        recording.values(name)  # says which channel is missing, and which are there
    target = objective.target
    shape = recording.channels[target.name].channel.shape
    if math.prod(target.shape) == 1 != math.prod(shape):
        raise RecordingError(
            f"Recording {recording.id or '(not stored)'}: '{target.name}' has shape {shape}, {math.prod(shape)} "
            f"numbers a sample; objective '{objective.name}' predicts one. Import the log again with one number as "
            f"'{target.name}', the sum of its columns (`sum: true`) or the largest (`max: true`)."
        )
    inputs = tuple(recording.channels[name].channel for name in objective.inputs)
    return Signals(inputs, target, float(recording.rate_hz))


def training_data(signals: Signals, recordings: Sequence[Recording]) -> list[Piece]:
    """Every recording as float32 tensors in channel units: inputs (T, F), target (T,).

    Raises RecordingError for recordings that are none, of other rates, joints, units or shapes, or not finite, and for
    a target, or inputs, that do not vary.
    """
    if not recordings:
        raise RecordingError(f"No recordings to fit '{signals.target.name}' to. Record or import some first.")
    pieces = [_piece(signals, recording, recordings[0]) for recording in recordings]
    target = torch.cat([piece.target for piece in pieces]).double()
    if not target.std() > 1e-6 * (1e-6 + target.mean().abs()):
        raise RecordingError(
            f"'{signals.target.name}' is {target.mean():g} in all {len(target)} samples. A model cannot be fitted "
            "to a constant: check that the sensor was read, and record again."
        )
    inputs = torch.cat([piece.inputs for piece in pieces])
    if bool((inputs == inputs[0]).all()):
        names = ", ".join(signals.names)
        raise RecordingError(
            f"The {inputs.shape[1]} numbers of {names} are the same in all {len(inputs)} samples, so they explain "
            f"nothing of '{signals.target.name}'. Record again while the robot moves, and check that they were read."
        )
    return pieces


def _piece(signals: Signals, recording: Recording, first: Recording) -> Piece:
    where = f"Recording {recording.id or '(not stored)'}"
    if recording.rate_hz != signals.rate_hz:
        raise RecordingError(
            f"{where} has {recording.rate_hz:g} Hz, the model is for {signals.rate_hz:g} Hz. "
            "A model counts in samples: resample to one rate when importing."
        )
    if tuple(recording.joint_names) != tuple(first.joint_names):
        raise RecordingError(
            f"{where} has other joints, or another joint order, than the first one. "
            "Fit each robot's recordings by themselves."
        )
    target = signals.target.name
    for channel in (*signals.inputs, signals.target):
        series = recording.values(channel.name)
        if not np.isfinite(series).all():
            raise RecordingError(f"{where}: '{channel.name}' holds values that are not finite. Import it again.")
    check_units(signals, recording)
    values = recording.values(target)
    if values.size != recording.num_samples:
        raise RecordingError(f"{where}: '{target}' has shape {values.shape}, expected one number a sample.")
    return Piece(input_tensor(signals, recording), torch.from_numpy(values.reshape(-1).copy()))


def check_units(signals: Signals, recording: Recording) -> None:
    """Raises RecordingError where a channel of the recording has another unit than the model was made for."""
    if not signals.units_known:
        return
    for channel in (*signals.inputs, signals.target):
        found = recording.channels.get(channel.name)
        if found is not None and not same_unit(found.channel.unit, channel.unit):
            does = "predicts" if channel is signals.target else "reads"
            raise RecordingError(
                f"Recording {recording.id or '(not stored)'}: '{channel.name}' is in {found.channel.unit}, the model "
                f"{does} {channel.unit}. Import the log again with that channel in {channel.unit}: correct its `unit` "
                "and `scale` in the mapping, or name the objective with --objective, which converts."
            )


def input_tensor(signals: Signals, recording: Recording) -> Tensor:
    """The inputs along a recording, (T, F) float32. Raises RecordingError for another count of numbers than the
    model's."""
    values = {name: recording.values(name) for name in signals.names}
    inputs = torch.from_numpy(stack_channels(values, signals.names))
    if inputs.shape[1] != signals.num_inputs:
        raise RecordingError(
            f"Recording {recording.id or '(not stored)'} gives {inputs.shape[1]} input numbers a sample, the model of "
            f"'{signals.target.name}' reads {signals.num_inputs}. It was made for another robot."
        )
    return inputs


def split_ends(pieces: Sequence[Piece], run_in: int) -> tuple[list[Piece], list[Piece]]:
    """Training parts, and the ends for validation, each after a run-in that fills the model's memory."""
    training, validation = [], []
    for piece in pieces:
        count = round(VALIDATION_SHARE * len(piece.target))
        if count < run_in // 2:  # too short to say anything
            training.append(piece)
            continue
        cut = len(piece.target) - count
        training.append(Piece(piece.inputs[:cut], piece.target[:cut]))
        start = max(0, cut - run_in)
        validation.append(Piece(piece.inputs[start:], piece.target[start:], cut - start))
    return training, validation


def pairs_of(sizes: Sequence[int]) -> tuple[tuple[slice, slice], ...]:
    """Places of every two input channels (also one with itself) that have the same size."""
    edges = np.cumsum([0, *sizes])
    parts = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    pairs = itertools.combinations_with_replacement(parts, 2)
    return tuple((a, b) for a, b in pairs if a.stop - a.start == b.stop - b.start)


def with_products(inputs: Tensor, pairs: Sequence[tuple[slice, slice]]) -> Tensor:
    """Inputs (..., F) and the products of those pairs, place by place, (..., G)."""
    if not pairs:
        return inputs
    return torch.cat((inputs, *(inputs[..., a] * inputs[..., b] for a, b in pairs)), -1)


def gather(channels: Mapping[str, Tensor], names: Sequence[str], num_worlds: int) -> Tensor:
    """Input channels side by side, (W, F): each entry (..., size) or (...,) with W leading elements."""
    return torch.cat([channels[name].reshape(num_worlds, -1) for name in names], 1)


def stack_channels(channels: Mapping[str, np.ndarray], names: Sequence[str]) -> np.ndarray:
    """The same for recordings: each entry (T, *shape) -> (T, F) float32."""
    return np.concatenate(
        [np.asarray(channels[name], dtype=np.float32).reshape(len(channels[name]), -1) for name in names], 1
    )
