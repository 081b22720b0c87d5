"""Advantages against a plain loop and against TorchRL's own."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives.value import GAE

from hts.rl.actor import PopulationCritic
from hts.rl.advantage import advantages, sparse_next_values
from hts.rl.backend import CpuBackend, GpuBackend
from hts.rl.population import Population, Sizes


def by_hand(reward, value, following, terminated, done, gamma, lam):
    """Generalised advantage estimation of one env instance, backwards; following: value of where a step ended."""
    steps = len(reward)
    advantage, running = [0.0] * steps, 0.0
    for t in reversed(range(steps)):
        hope = 0.0 if terminated[t] else following[t]
        delta = reward[t] + gamma * hope - value[t]
        running = delta + (0.0 if done[t] else gamma * lam * running)
        advantage[t] = running
    return advantage


def rollout(shape=(3, 4, 24), seed=0):
    generator = torch.Generator().manual_seed(seed)
    reward, value, following = torch.randn(3, *shape, generator=generator)
    ends = torch.rand(*shape, generator=generator)
    return reward, value, following, ends < 0.08, (ends < 0.08) | (ends > 0.92)


def test_advantages_agree_with_a_plain_loop_over_falls_and_time_outs():
    rows = rollout()
    terminated, done = rows[3:]
    assert terminated.any() and (done & ~terminated).any()
    advantage, target = advantages(*rows, 0.97, 0.9)
    for p in range(3):
        for n in range(4):
            expected = by_hand(*(x[p, n].tolist() for x in rows), 0.97, 0.9)
            torch.testing.assert_close(advantage[p, n], torch.tensor(expected), atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(target, advantage + rows[1])


def test_a_fall_ends_all_hope_and_a_time_out_does_not():
    one = torch.ones(1, 1, 1)
    no, yes = torch.zeros(1, 1, 1, dtype=torch.bool), torch.ones(1, 1, 1, dtype=torch.bool)
    for terminated, done, expected in (
        (yes, yes, 1.0 - 5.0),
        (no, yes, 1.0 + 0.9 * 7.0 - 5.0),  # of the state that the old episode ended in
        (no, no, 1.0 + 0.9 * 7.0 - 5.0),
    ):
        advantage, _ = advantages(one, 5 * one, 7 * one, terminated, done, 0.9, 0.95)
        assert float(advantage) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_after_a_fall_the_next_value_is_not_used_even_if_it_is_no_number(bad):
    reward, value, following, terminated, done = rollout()
    expected = advantages(reward, value, following, terminated, done, 0.97, 0.9)
    found = advantages(reward, value, following.masked_fill(terminated, bad), terminated, done, 0.97, 0.9)
    assert all(torch.equal(one, other) for one, other in zip(found, expected, strict=True))
    elsewhere = (~terminated).nonzero()[0]
    following[tuple(elsewhere)] = bad
    assert not torch.isfinite(advantages(reward, value, following, terminated, done, 0.97, 0.9)[0]).all()


def test_advantages_of_a_candidate_do_not_depend_on_when_others_fall():
    rows = rollout()
    crowd, _ = advantages(*rows, 0.99, 0.95)
    for p in range(3):
        alone, _ = advantages(*(x[p : p + 1] for x in rows), 0.99, 0.95)
        assert torch.equal(crowd[p : p + 1], alone)


def test_one_candidates_bad_number_stays_its_own():
    rows = rollout()
    rows[0][1, 2, 3] = float("nan")
    bad, _ = advantages(*rows, 0.99, 0.95)
    rows[0][1, 2, 3] = 0.0
    good, _ = advantages(*rows, 0.99, 0.95)
    assert torch.equal(bad[[0, 2]], good[[0, 2]])


# ------------------------------------------------------------------------------------------- values of what comes next


def batch(shape=(3, 4, 24), seed=1) -> TensorDict:
    """Steps that end where the next ones begin, but where an episode ended."""
    generator = torch.Generator().manual_seed(seed)
    seen = torch.randn(*shape, 5, generator=generator)
    reward, _, _, terminated, done = rollout(shape, seed)
    following = torch.cat((seen[:, :, 1:], torch.randn(*shape[:2], 1, 5, generator=generator)), 2)
    following[done] = torch.randn(int(done.sum()), 5, generator=generator)
    flags = {"terminated": terminated, "truncated": done & ~terminated, "done": done}
    after = {"critic_observation": following, "reward": reward.unsqueeze(-1)}
    after |= {name: flag.unsqueeze(-1) for name, flag in flags.items()}
    return TensorDict({"critic_observation": seen, "next": TensorDict(after, shape)}, shape)


def test_few_evaluations_give_the_values_of_all():
    population, data = Population(Sizes(3, 5, 2, (8,)), 3, seed=2), batch()
    value = population.value(data["critic_observation"].flatten(1, 2)).view(data.shape)
    found = sparse_next_values(population, data, value)
    everything = population.value(data["next", "critic_observation"].flatten(1, 2)).view(data.shape)
    fell = data["next", "terminated"].squeeze(-1)
    torch.testing.assert_close(found[~fell], everything[~fell])
    assert not found[fell].any()
    alone = Population.from_candidates(population.sizes, [population.candidate(1)])
    assert torch.equal(sparse_next_values(alone, data[1:2], value[1:2]), found[1:2])


def test_a_fall_whose_last_observation_is_no_number_harms_nobody_on_either_kind_of_device():
    population, data = Population(Sizes(3, 5, 2, (8,)), 3, seed=2), batch()
    terminated, done = (data["next", name].squeeze(-1) for name in ("terminated", "done"))
    data["next", "critic_observation"][terminated] = float("nan")
    value = population.value(data["critic_observation"].flatten(1, 2)).view(data.shape)
    reward = data["next", "reward"].squeeze(-1)
    on_gpu = GpuBackend(torch.device("cpu"), capture=False, tf32=False, fuse=False)
    each = [backend.next_values(population, data, value) for backend in (CpuBackend(), on_gpu)]
    one, other = (advantages(reward, value, following, terminated, done, 0.99, 0.95)[0] for following in each)
    assert torch.isfinite(one).all()
    torch.testing.assert_close(other, one)


def test_stock_gae_gives_our_advantages():
    population, data = Population(Sizes(3, 5, 2, (8,)), 3, seed=2), batch()
    value = population.value(data["critic_observation"].flatten(1, 2)).view(data.shape)
    terminated, done = (data["next", name].squeeze(-1) for name in ("terminated", "done"))
    following = sparse_next_values(population, data, value)
    ours, target = advantages(data["next", "reward"].squeeze(-1), value, following, terminated, done, 0.99, 0.95)
    gae = GAE(gamma=0.99, lmbda=0.95, value_network=PopulationCritic(population), vectorized=False)
    gae(data)
    torch.testing.assert_close(data["advantage"].squeeze(-1), ours, atol=1e-6, rtol=0)
    torch.testing.assert_close(data["value_target"].squeeze(-1), target, atol=1e-6, rtol=0)
