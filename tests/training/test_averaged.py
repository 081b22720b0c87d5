"""Parameters averaged over the end of a training: over the last batches alone, over a stop, and in a run."""

from __future__ import annotations

import pytest
import torch

from hts.config import FinetuneConfig
from hts.rl.population import Population, Sizes
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run
from hts.training.averaged import Averaged


def walked(share: float, batches: int, until: int | None = None, found: Averaged | None = None, start: int = 0):
    """Candidate 0 has the number of batches done as each of its parameters, candidate 1 its negative."""
    found = found or Averaged(share, batches)
    population = Population(Sizes(3, 3, 2, (4,)), 2)
    for done in range(start + 1, (until or batches) + 1):
        with torch.no_grad():
            population.vectors[0].fill_(done)
            population.vectors[1].fill_(-done)
        found.look(done, population)
    return found, population


def test_the_last_batches_are_averaged_and_no_others():
    found, population = walked(0.25, 16)
    found.put_into(population, [0, 1])
    assert population.vectors[0].unique().tolist() == [pytest.approx(14.5)]  # of 13, 14, 15, 16
    assert population.vectors[1].unique().tolist() == [pytest.approx(-14.5)]


def test_who_was_stopped_stays_where_it_was_put():
    found, population = walked(0.5, 8)
    found.put_into(population, [1])
    assert population.vectors[0].unique().tolist() == [8.0]


def test_no_share_is_the_last_moment():
    found, population = walked(0.0, 8)
    found.put_into(population, [0, 1])
    assert found.state() == {} and population.vectors[0].unique().tolist() == [8.0]


@pytest.mark.parametrize("stop", [2, 7])
def test_it_goes_on_over_a_stop(stop):
    before, _ = walked(0.5, 8, until=stop)
    again = Averaged(0.5, 8)
    again.load(before.state(), before.notes())
    whole, _ = walked(0.5, 8)
    after, _ = walked(0.5, 8, found=again, start=stop)
    torch.testing.assert_close(after.mean, whole.mean)


@pytest.mark.parametrize("share", [-0.1, 1.0])
def test_a_share_is_less_than_all(share):
    with pytest.raises(ValueError, match="average"):
        FinetuneConfig(average=share)


def test_a_run_tries_the_average_and_not_the_last_moment(tmp_path):
    shared = {"finetune.steps": 192, "sweep.kl_bounds": [float("inf")]}
    with kit_installed():
        last = tiny_run(tmp_path / "last", settings=shared)
        mean = tiny_run(tmp_path / "mean", settings={**shared, "finetune.average": 0.5})
    ids = [[one["id"] for one in run.summary["iterations"][0]["candidates"]] for run in (last, mean)]
    assert ids[0] == ids[1]
    ends = [run.summary["iterations"][0]["candidates"][0]["kl"] for run in (last, mean)]
    assert 0 < ends[1] < ends[0]  # it goes away from its anchor, so its mean is nearer than its end
