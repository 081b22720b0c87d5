"""A loss whose multiplier is never updated says so, once; no other does."""

from __future__ import annotations

import math
import warnings

import pytest
import torch
from tensordict import TensorDict

from hts.rl import KLConstrainedPPOLoss, LagrangeMultiplier, Population, PopulationActor, PopulationCritic, Sizes
from hts.rl import loss as home

SIZES = Sizes(3, 3, 1, (4,))


@pytest.fixture(autouse=True)
def soon(monkeypatch) -> None:
    monkeypatch.setattr(home, "FORGOTTEN", 4)


def made(**how) -> tuple[KLConstrainedPPOLoss, TensorDict]:
    population = Population(SIZES, 2)
    loss = KLConstrainedPPOLoss(PopulationActor(population), PopulationCritic(population), **how)
    states = {name: torch.randn(2, 5, 3) for name in ("observation", "critic_observation")}
    numbers = {name: torch.zeros(2, 5, 1) for name in ("advantage", "value_target", "state_value", "action")}
    return loss, TensorDict({**states, **numbers, "action_log_prob": torch.zeros(2, 5)}, [2, 5])


def told(loss: KLConstrainedPPOLoss, data: TensorDict, times: int) -> int:
    """How many warnings so many losses give."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        for _ in range(times):
            loss(data)
    assert all("update_multiplier(loss.kl_to_reference(data)) once a batch" in str(one.message) for one in found)
    return len(found)


def test_a_multiplier_that_is_never_updated_is_told_once():
    loss, data = made(kl_bound=torch.tensor([0.1, math.inf]))
    with torch.no_grad():
        assert told(loss, data, 9) == 0  # looked at, not learned from
    assert [told(loss, data, times) for times in (3, 1, 9)] == [0, 1, 0]


@pytest.mark.parametrize("update", ["update_multiplier", "multiplier.update", "multiplier.step"])
def test_one_that_is_updated_is_not(update):
    loss, data = made()
    assert told(loss, data, 3) == 0
    owner = loss.multiplier if "." in update else loss
    getattr(owner, update.rpartition(".")[2])(loss.kl_to_reference(data))
    assert told(loss, data, 9) == 0


@pytest.mark.parametrize("how", [{"kl_bound": math.inf}, {"multiplier_rate": 0.0}], ids=["no bound", "no rate"])
def test_one_that_has_nothing_to_do_is_not(how):
    loss, data = made(**how)
    assert told(loss, data, 9) == 0


def test_a_compiled_loss_is_compiled_once_and_gives_the_same(monkeypatch):
    monkeypatch.setattr(home, "FORGOTTEN", 1000)
    loss, data = made()
    graphs = []

    def counted(graph, inputs):
        graphs.append(graph)
        return graph.forward

    compiled = torch.compile(loss, backend=counted)
    expected, seen = loss(data)["loss_objective"], []
    for _ in range(4):
        assert torch.equal(compiled(data)["loss_objective"], expected)
        seen.append(len(graphs))
    assert seen[0] > 0 and set(seen) == {seen[0]}


def test_warnings_have_the_line_of_whoever_called():
    loss, data = made(kl_bound=0.1)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        for _ in range(4):
            loss(data)
        for _ in range(60):
            loss.update_multiplier(torch.tensor([0.9, 0.9]))
        multiplier = LagrangeMultiplier(0.1)
        for _ in range(60):
            multiplier.update(torch.tensor(0.9))
        loss.actor_network.requires_grad_(False)
        loss(data)
    assert [one.filename for one in found] == [__file__] * 4
