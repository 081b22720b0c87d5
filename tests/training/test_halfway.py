"""Candidates as they were on the way: kept at their time, inside their bound, and over a stop."""

from __future__ import annotations

import pytest
import torch

from hts.config import FinetuneConfig
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run
from hts.training.halfway import Halfway

HALFWAY = {"finetune.also_at": [0.5], "finetune.steps": 192}


class Population:
    """Two candidates of one parameter each."""

    def __init__(self) -> None:
        self.values = torch.zeros(2)

    def log_std(self) -> torch.Tensor:
        return torch.zeros(2, 1, 3)

    def candidate(self, index: int) -> dict[str, torch.Tensor]:
        return {"a": self.values[index].clone()}


def walked(batches: int, shares: tuple[float, ...], able: tuple[int, ...] = (0, 1)) -> Halfway:
    found, population = Halfway(shares, batches), Population()
    for done in range(1, batches + 1):
        population.values += 1.0
        found.look(done, population, torch.tensor([0.1 * done, 0.2]), able)
    return found


def test_each_candidate_is_kept_at_its_share_and_never_at_the_end():
    found = walked(8, (0.5, 0.75, 0.99)).moments
    assert [(one.index, one.share, float(one.tensors["a"])) for one in found] == [
        (0, 0.5, 4.0),
        (1, 0.5, 4.0),
        (0, 0.75, 6.0),
        (1, 0.75, 6.0),
    ]
    assert found[0].kl == pytest.approx(0.4) and found[0].std == 1.0


def test_who_was_stopped_is_not_kept():
    assert {one.index for one in walked(4, (0.5,), able=(1,)).moments} == {1}


def test_they_go_on_over_a_stop():
    before, after = walked(4, (0.25, 0.5)), Halfway((0.25, 0.5), 4)
    after.load(before.state(), before.notes())
    assert [(one.share, one.kl, float(one.tensors["a"])) for one in after.moments] == [
        (one.share, one.kl, float(one.tensors["a"])) for one in before.moments
    ]


@pytest.mark.parametrize("shares", [(0.0,), (1.0,), (0.5, 0.5), (0.501, 0.504), (0.997,)])
def test_a_share_lies_between_nothing_and_all(shares):
    with pytest.raises(ValueError, match="share"):
        FinetuneConfig(also_at=shares)


def test_one_beyond_its_bound_is_not_judged(tmp_path):
    with kit_installed():
        run = tiny_run(
            tmp_path / "run", settings=HALFWAY
        )  # so few steps overshoot, and the end alone is projected back
    assert [one["id"] for one in run.summary["iterations"][0]["candidates"]] == ["00-00"]


def test_a_share_of_less_than_one_batch_is_the_first_batch(tmp_path):
    with kit_installed():
        early = {"finetune.also_at": [0.1], "finetune.hold": True, "sweep.kl_bounds": [float("inf")]}
        run = tiny_run(tmp_path / "run", settings=HALFWAY | early)
    assert "00-00-10" in [one["id"] for one in run.summary["iterations"][0]["candidates"]]


def test_a_run_judges_them_beside_the_candidates(tmp_path):
    with kit_installed():
        run = tiny_run(tmp_path / "run", settings={**HALFWAY, "sweep.kl_bounds": [float("inf")]})
    rows = {one["id"]: one for one in run.summary["iterations"][0]["candidates"]}
    assert set(rows) == {"00-00", "00-00-50"}
    assert all(one["sim_score"] is not None for one in rows.values())
    assert rows["00-00-50"]["kl"] != rows["00-00"]["kl"]
    assert sum(one["elite"] for one in rows.values()) == 1  # as many are tried as without them
    assert (run.folder / "iterations/00/candidates/00-00-50.safetensors").exists()
