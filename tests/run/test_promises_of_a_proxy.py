"""What the analytic stand-in promises: a line through what was recorded, and no further."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hts.measurement.baseline import fit_proxy
from hts.measurement.proxy import proxy_along
from hts.run.judging import _in_unit
from hts.testing.known_signals import KnownHeat
from hts.testing.known_signals import known_heat as recording


def test_a_sample_far_beyond_what_was_recorded_counts_as_far_as_the_recordings_reach():
    objective, known = KnownHeat(), [recording(1), recording(2)]
    job = SimpleNamespace(config=SimpleNamespace(fits_models=False))
    in_unit, line = _in_unit(job, 0, "heat", objective, known), fit_proxy(objective, known)
    seen = np.concatenate([proxy_along(objective, one) for one in known])
    assert in_unit(seen) == pytest.approx(line.scale * seen + line.offset)
    beyond = in_unit(np.array([seen.min() - 1000.0, seen.max() + 1000.0]))
    assert beyond == pytest.approx([line.scale * end + line.offset for end in (seen.min(), seen.max())])
