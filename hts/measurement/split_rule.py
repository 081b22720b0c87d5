"""Who says what is held out: `hts fit --split KIND[=VALUE]`, or a test store of its own.

A number between 0 and 1 is the share that is fitted to; anything else names what is held out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hts.errors import ConfigError, RecordingError, unknown_name
from hts.measurement.split import named_part, split

if TYPE_CHECKING:
    from hts.recordings.recording import Recording

SHORT = 3
"""A number of more digits that is no share is a name: ids of sessions and hashes of policies may be digits alone."""
CHRONOLOGICAL, AUTOMATIC, TEST_STORE = "chronological", "automatic", "test store"


@dataclass(frozen=True)
class Split:
    """Recordings, or parts of them, to fit to and held out; how: in words."""

    training: list[Recording]
    held_out: list[Recording]
    how: str


@dataclass(frozen=True)
class SplitRule:
    """kind: one of `KINDS`; share: that is fitted to; names: held out, where they are given in place of a share."""

    kind: str
    share: float | None = None
    names: tuple[str, ...] = ()

    @classmethod
    def parsed(cls, text: str) -> SplitRule:
        """From `chronological=0.7`, `session`, `session=monday,tuesday`, ... Raises ConfigError."""
        kind, _, value = text.partition("=")
        if kind not in (CHRONOLOGICAL, *KEYS):
            raise ConfigError(f"--split {text}: " + unknown_name("split", kind, (CHRONOLOGICAL, *KEYS)))
        if not value:
            return cls(kind)
        try:
            share = float(value)
        except ValueError:
            share = math.nan
        if 0 < share < 1:
            return cls(kind, share)
        if kind == CHRONOLOGICAL:
            raise ConfigError(
                f"--split {text}: expected the share of each recording to fit to, between 0 and 1, e.g. "
                "chronological=0.7"
            )
        if not math.isnan(share) and not (value.isalnum() and len(value) > SHORT):
            raise ConfigError(f"--split {text}: expected a share between 0 and 1 that is fitted to, e.g. {kind}=0.7")
        return cls(kind, None, tuple(name.strip() for name in value.split(",") if name.strip()))


KEYS: dict[str, Callable[[Recording], str]] = {
    "recording": lambda recording: recording.id,
    "file": lambda recording: recording.notes.get("source", recording.id),
    "session": lambda recording: recording.session,
    "policy": lambda recording: recording.policy_hash,
}
"""Kind of split -> what is held out together."""


def split_by(rule: SplitRule | None, recordings: Sequence[Recording], held_out: float, seed: int = 0) -> Split:
    """rule: None, as `split.split` does it; held_out: share where the rule says none. Raises RecordingError where
    there is too little to split so."""
    if rule is None:
        return Split(*split(recordings, held_out, seed), AUTOMATIC)
    share = rule.share if rule.share is not None else 1.0 - held_out
    if rule.kind == CHRONOLOGICAL:
        return _chronological(recordings, share)
    groups: dict[str, list[Recording]] = {}
    for recording in recordings:
        groups.setdefault(KEYS[rule.kind](recording), []).append(recording)
    if rule.names:
        for name in rule.names:
            if name not in groups:
                raise RecordingError(f"--split {rule.kind}: " + unknown_name(rule.kind, name, groups))
        chosen = set(rule.names)
    else:
        names = list(groups)
        order = np.random.default_rng(seed).permutation(len(names))
        chosen = {names[index] for index in order[: max(1, round((1.0 - share) * len(names)))]}
    if len(chosen) == len(groups):
        if len(groups) > 1:
            listed = ", ".join(name or "(none)" for name in groups)
            raise RecordingError(
                f"--split {rule.kind}: nothing is left to fit to: all {len(groups)} are held out ({listed}). Name "
                f"fewer, or give a larger share to fit to, e.g. {rule.kind}=0.7."
            )
        found = "all recordings have none" if set(groups) == {""} else f"there is one, {next(iter(groups))}"
        raise RecordingError(
            f"--split {rule.kind}: nothing is left to fit to: {found}. "
            "Split in another way (chronological=0.7, file), or give --test STORE."
        )
    training = [one for name, group in groups.items() if name not in chosen for one in group]
    held = [one for name, group in groups.items() if name in chosen for one in group]
    return Split(training, held, f"{rule.kind}: {', '.join(name or '(none)' for name in groups if name in chosen)}")


def _chronological(recordings: Sequence[Recording], share: float) -> Split:
    training, held = [], []
    for recording in recordings:
        cut = round(share * recording.num_samples)
        if not 2 <= cut <= recording.num_samples - 2:
            raise RecordingError(
                f"--split chronological: {recording.id} has {recording.num_samples} samples, too few to cut in two. "
                "Leave it out of the store, or split by file."
            )
        training.append(named_part(recording, 0, cut))
        held.append(named_part(recording, cut, recording.num_samples))
    each = "the recording" if len(recordings) == 1 else "each recording"
    return Split(training, held, f"chronological: the first {100 * share:g} % of {each} against the rest")
