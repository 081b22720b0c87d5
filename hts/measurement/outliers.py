"""Samples that no machine makes: one in a hundred thousand would rule a whole fit, so recordings are cut around them.

Two rules, both far outside of what a sensor does: beyond several times a joint's limit, where the robot is installed
and says its limits; or further outside the range of nearly all samples than ten times that range is wide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hts.errors import RecordingError
from hts.measurement.split import named_part
from hts.recordings.repeated import runs_of

if TYPE_CHECKING:
    from hts.contracts import RobotSpec
    from hts.recordings.recording import Recording

LIMIT_FACTOR = 4.0  # an impact, or an estimate of a speed, may read a few times a limit
TRIMMED_SHARE, TRIMMED_LEAST = 1e-3, 2  # on each side: what is left is the range of nearly all samples
RANGE_FACTOR = 10.0
LEAST_SECONDS = 1.0  # a part that is left and shorter is dropped


@dataclass
class Masked:
    """samples: left out; short: samples of parts that were left and too short; why: channel -> how many, its worst
    value and unit."""

    samples: int = 0
    short: int = 0
    why: dict[str, tuple[int, float, str]] = field(default_factory=dict)


def without_outliers(
    recordings: Sequence[Recording], channels: Sequence[str], spec: RobotSpec | None = None
) -> tuple[list[list[Recording]], Masked]:
    """Of each recording its parts, cut where a channel holds what cannot be; one without such samples as it is.

    spec: limits of the robot; None where it is not known. Ranges are those of all recordings together.
    """
    found = Masked()
    wrong = [np.zeros(recording.num_samples, bool) for recording in recordings]
    for name in channels:
        tables = [one.values(name).reshape(one.num_samples, -1) for one in recordings]
        if len({table.shape[1] for table in tables}) > 1:
            continue  # another robot's; said elsewhere
        low, high = _range(np.concatenate(tables))
        unit = recordings[0].channels[name].channel.unit
        limits = _limits(name, unit, tables[0].shape[1], spec)
        bad = [((table < low) | (table > high) | (np.abs(table) > limits)) for table in tables]
        count = int(sum(each.any(1).sum() for each in bad))
        if count:
            values = np.concatenate([table[each] for table, each in zip(tables, bad, strict=True)])
            found.why[name] = count, float(values[np.argmax(np.abs(values))]), unit
            wrong = [before | each.any(1) for before, each in zip(wrong, bad, strict=True)]
    parts: list[list[Recording]] = []
    for recording, marked in zip(recordings, wrong, strict=True):
        kept: list[Recording] = []
        found.samples += int(marked.sum())
        for a, b in runs_of(~marked):
            if not marked.any() or b - a >= LEAST_SECONDS * recording.rate_hz:
                kept.append(named_part(recording, a, b))
            else:
                found.short += b - a
        parts.append(kept)
    return parts, found


def masked_split(
    training: Sequence[Recording], held_out: Sequence[Recording], channels: Sequence[str], spec: RobotSpec | None = None
) -> tuple[list[Recording], list[Recording], Masked]:
    """Both sides of a split without such samples. Raises RecordingError if nothing is left to fit to."""
    parts, masked = without_outliers([*training, *held_out], channels, spec)
    left = [part for each in parts[: len(training)] for part in each]
    if training and not left:
        raise RecordingError(
            f"Nothing is left to fit to: {told(masked)} Import the logs again, with `limits` and the right units."
        )
    return left, [part for each in parts[len(training) :] for part in each], masked


def told(masked: Masked) -> str:
    """In words, with how many and the worst of each channel."""
    each = "; ".join(
        f"'{name}' {count} (such as {worst:.4g} {unit})" for name, (count, worst, unit) in masked.why.items()
    )
    short = f", and {masked.short} in parts shorter than {LEAST_SECONDS:g} s" if masked.short else ""
    plural = "s" if masked.samples != 1 else ""
    return f"{masked.samples} sample{plural} that no machine makes left out{short}: {each}."


def _range(table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest value that may be, of (T, n): (n,) each; infinite where nearly all samples are the same."""
    trimmed = max(TRIMMED_LEAST, int(np.ceil(TRIMMED_SHARE * len(table))))
    if len(table) < 10 * trimmed:
        return np.full(table.shape[1], -np.inf), np.full(table.shape[1], np.inf)
    ordered = np.partition(table.astype(np.float64), (trimmed, len(table) - 1 - trimmed), axis=0)
    low, high = ordered[trimmed], ordered[len(table) - 1 - trimmed]
    room = np.where(high > low, RANGE_FACTOR * (high - low), np.inf)
    return low - room, high + room


def _limits(name: str, unit: str, size: int, spec: RobotSpec | None) -> np.ndarray:
    """Largest size that a joint's torque or speed may have, (n,)."""
    by_unit = {} if spec is None else {"N*m": spec.torque_limit, "rad/s": spec.velocity_limit}
    limits = by_unit.get(unit)
    if limits is None or len(limits) != size or not name.startswith("joint_"):
        return np.full(size, np.inf)
    return LIMIT_FACTOR * np.asarray(limits, dtype=float)
