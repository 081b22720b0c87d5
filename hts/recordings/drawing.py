"""A picture of recordings before they are stored: one row a channel, all its components."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

from hts.atomic import atomic_write
from hts.errors import ConfigError, RecordingError
from hts.recordings.recording import Recording

SUFFIXES = (".png", ".svg", ".pdf")
MOST_SHOWN = 6
"""Recordings in one picture."""


def check_picture(path: Path, store: Path | None = None) -> None:
    """Raises ConfigError for a file name whose ending is no picture's, and for one inside of a store, such as the one
    that is imported to."""
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"--figure {path}: expected a name that ends in {', '.join(SUFFIXES)}.")
    above = path.resolve().parents
    inside = [place for place in above if (place / "zarr.json").exists() or (store and place == store.resolve())]
    if inside:
        raise ConfigError(f"--figure {path}: is inside of the store {inside[0]}. Choose a place outside of it.")


def draw(recordings: Sequence[Recording], path: Path) -> None:
    """Write a picture of the first recordings: every channel against time, a dashed line at its idle level.

    Raises RecordingError if it cannot be written.
    """
    check_picture(path)
    from matplotlib.figure import Figure

    shown = list(recordings[:MOST_SHOWN])
    names = list(dict.fromkeys(name for one in shown for name in one.channels))
    size = (max(5.0, 3.6 * len(shown)), 1.2 + 1.5 * len(names))
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(names), len(shown), squeeze=False, sharex="col")
    for across, one in enumerate(shown):
        for down, name in enumerate(names):
            axes = grid[down, across]
            if name not in one.channels:
                axes.set_axis_off()
                continue
            series = one.channels[name]
            axes.plot(one.time, series.values.reshape(one.num_samples, -1), linewidth=0.7)
            if name in one.idle:
                axes.axhline(one.idle[name], color="black", linestyle="--", linewidth=0.7)
            if across == 0:
                axes.set_ylabel(f"{name}\n{series.channel.unit}", fontsize=7)
            axes.tick_params(labelsize=6)
        source = str(one.notes.get("source", "")).encode("ascii", "backslashreplace").decode().replace("$", r"\$")
        grid[0, across].set_title(f"{source:.60}\n{one.seconds:.2f} s at {one.rate_hz:g} Hz", fontsize=7)
        grid[-1, across].set_xlabel("s", fontsize=7)
    try:
        content = io.BytesIO()
        figure.savefig(content, format=path.suffix[1:].lower(), dpi=120)
        atomic_write(path, content.getvalue())
    except OSError as error:
        raise RecordingError(
            f"{path}: the picture cannot be written ({error.strerror or error}). Free some space or choose another "
            "place."
        ) from error
