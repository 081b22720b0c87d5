"""What an instrument's fact or reading says of recordings: a plugin's code, so one line says whose mistake it is."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from hts.contracts import Fact, Reading
from hts.errors import PluginError
from hts.guarded import guarded


def read_off(of: Fact | Reading, channels: Mapping[str, np.ndarray], idle: Mapping[str, float]) -> float:
    """Its value, in its unit. channels: (T, *shape) each; idle: level of each channel. Raises PluginError for an
    exception in `reading`, and for what is not one number."""
    what = f"{type(of).__name__} '{of.name}': reading()"
    found = guarded(what, partial(of.reading, channels, idle))
    if isinstance(found, str) or np.ndim(found) != 0:
        raise PluginError(f"{what} gives a {type(found).__name__}, expected one number, such as float(x.mean()).")
    return float(found)
