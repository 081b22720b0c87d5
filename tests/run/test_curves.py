"""Training curves on the disk, as TensorBoard reads them, also of a training that was stopped and goes on."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from hts.run.curves import Curves
from hts.training.trainer import BatchStats

accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
MEMBERS = [SimpleNamespace(id="00-00"), SimpleNamespace(id="00-01")]
STEPS = 100  # of each candidate in a batch


def batches(curves, first, last, value):
    for batch in range(first, last + 1):
        curves.add(BatchStats(steps=batch * STEPS * len(MEMBERS), values={"reward": [value, -value]}), MEMBERS)


def stopped_after_one(folder):
    with Curves(folder) as curves:
        batches(curves, 1, 1, 1.0)
        raise RuntimeError("stopped")


def read(folder, name):
    found = accumulator.EventAccumulator(str(folder))
    found.Reload()
    return [(point.step, point.value) for point in found.Scalars(name)]


def test_each_candidate_has_a_curve_over_its_own_steps(tmp_path):
    with Curves(tmp_path) as curves:
        batches(curves, 1, 3, 1.0)
    assert read(tmp_path / "00-00", "reward") == [(100, 1.0), (200, 1.0), (300, 1.0)]
    assert read(tmp_path / "00-01", "reward") == [(100, -1.0), (200, -1.0), (300, -1.0)]


def test_what_a_stopped_training_had_beyond_its_checkpoint_is_forgotten_when_it_comes_again(tmp_path):
    with Curves(tmp_path) as curves:
        batches(curves, 1, 4, 1.0)
    with Curves(tmp_path, goes_on=True) as curves:
        batches(curves, 3, 5, 2.0)
    for name, sign in (("00-00", 1.0), ("00-01", -1.0)):
        expected = [(STEPS * batch, sign * (1.0 if batch < 3 else 2.0)) for batch in range(1, 6)]
        assert read(tmp_path / name, "reward") == expected


def test_a_group_that_was_done_keeps_its_curves_when_the_next_one_goes_on(tmp_path):
    done, stopped = [MEMBERS[:1], MEMBERS[1:]]
    with Curves(tmp_path) as curves:
        for members, last in ((done, 4), (stopped, 2)):
            for batch in range(1, last + 1):
                curves.add(BatchStats(steps=batch * STEPS, values={"reward": [1.0]}), members)
    with Curves(tmp_path, goes_on=True) as curves:
        curves.add(BatchStats(steps=2 * STEPS, values={"reward": [2.0]}), stopped)
    assert read(tmp_path / "00-00", "reward") == [(STEPS * batch, 1.0) for batch in range(1, 5)]
    assert read(tmp_path / "00-01", "reward") == [(STEPS, 1.0), (2 * STEPS, 2.0)]


def test_a_training_that_raises_closes_its_curves_and_one_that_logs_nothing_leaves_nothing(tmp_path):
    with pytest.raises(RuntimeError, match="stopped"):
        stopped_after_one(tmp_path / "some")
    assert read(tmp_path / "some" / "00-00", "reward") == [(100, 1.0)]
    with Curves(tmp_path / "none", goes_on=True):
        pass
    assert not (tmp_path / "none").exists()
