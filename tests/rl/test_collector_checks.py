"""A collector refuses, before its first step, what does not go together; flags of another shape with the first one."""

from __future__ import annotations

import time
from functools import partial
from threading import Barrier

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from walk_env import CPU, SHAPE, Walk

from hts.cores import available
from hts.rl import GroupedEnv, Population, PopulationActor, PopulationCollector, PopulationRandom, Sizes
from hts.rl.captured_collector import CapturedCollector


class Flagged(Walk):
    """Says `flag` of each step's end."""

    def __init__(self, flag: torch.Tensor) -> None:
        super().__init__()
        self.flag = flag

    def end_step(self, action):
        return self.last, dict.fromkeys(("terminated", "truncated", "done"), self.flag)


def actor(candidates: int = 2, generators: int | None = None) -> PopulationActor:
    """generators: given to an actor that has been made, which then looks at them no more."""
    made = PopulationActor(Population(Sizes(3, 3, 2, (8,)), candidates))
    made.random = PopulationRandom(range(candidates if generators is None else generators), CPU)
    return made


COLLECTORS = pytest.mark.parametrize(
    "kind", [PopulationCollector, partial(CapturedCollector, capture=False)], ids=["split", "captured"]
)


@COLLECTORS
def test_what_goes_together_is_collected(kind):
    collector = kind(Walk(), actor(), frames_per_batch=16)
    assert next(iter(collector)).shape == (*SHAPE, 2)
    part = kind(Walk(), actor(5).of(slice(1, 3)), frames_per_batch=16)
    part.shutdown()
    collector.shutdown()


@COLLECTORS
@pytest.mark.parametrize(
    ("policy", "found"),
    [
        (lambda: actor(3), "policy has 3 candidates, env 2"),
        (lambda: actor(2, 1), "random has 1 generators, expected one for each of the 2 candidates"),
    ],
)
def test_as_many_candidates_are_asked_for(kind, policy, found):
    with pytest.raises(ValueError, match=found):
        kind(Walk(), policy(), frames_per_batch=16)


@COLLECTORS
@pytest.mark.parametrize(
    ("sizes", "found"),
    [
        (Sizes(4, 3, 2, (8,)), r"policy's observation has 4 numbers, env's \(2, 4, 3\).*with Sizes\(observation=3"),
        (Sizes(3, 2, 2, (8,)), "policy's critic_observation has 2 numbers"),
        (Sizes(3, 3, 1, (8,)), r"policy's action has 1 numbers, env's \(2, 4, 2\)"),  # it would broadcast
    ],
)
def test_a_policy_of_other_sizes_is_refused(kind, sizes, found):
    with pytest.raises(ValueError, match=found):
        kind(Walk(), PopulationActor(Population(sizes, 2)), frames_per_batch=16)


@COLLECTORS
def test_a_policy_of_one_is_refused(kind):
    alone = TensorDictModule(nn.Linear(3, 2), in_keys=["observation"], out_keys=["action"])
    with pytest.raises(TypeError, match="policy is a TensorDictModule, expected a PopulationActor"):
        kind(Walk(), alone, frames_per_batch=16)


@COLLECTORS
@pytest.mark.parametrize("frames", [0, -8, 12])
def test_a_batch_is_whole_steps(kind, frames):
    with pytest.raises(ValueError, match=f"frames_per_batch is {frames}, expected a multiple of the 8"):
        kind(Walk(), actor(), frames_per_batch=frames)


@COLLECTORS
@pytest.mark.parametrize("how", [{"frames_per_batch": 16.0}, {"total_frames": "80"}, {"total_frames": float("nan")}])
def test_frames_are_whole_numbers(kind, how):
    (name,) = how
    with pytest.raises(TypeError, match=f"^{name} is .*; expected a whole number of frames"):
        kind(Walk(), actor(), **{"frames_per_batch": 16} | how)


@COLLECTORS
def test_weights_may_be_given_in_each_form_that_torchrl_knows(kind):
    collector, other = kind(Walk(), actor(), frames_per_batch=16), actor()
    for number, made in enumerate((lambda: other, other.state_dict, lambda: TensorDict.from_module(other))):
        for name in (None, "policy", "weights"):
            with torch.no_grad():
                other.population.vectors[1].fill_(0.1 * number + len(name or ""))
            collector.update_policy_weights_(*([made()] if name is None else []), **({name: made()} if name else {}))
            assert torch.equal(collector.policy.population.vectors[1], other.population.vectors[1])
    before = collector.policy.population.vectors[1].clone()
    for wrong, error, said in (
        (other.population, ValueError, "^The weights are observation_mean, .*expected population.observation_mean"),
        ({}, ValueError, "^The weights are none, expected population"),
        (5, TypeError, "^The weights are a int; expected a PopulationActor"),
    ):
        with pytest.raises(error, match=said):
            collector.update_policy_weights_(wrong)
    with pytest.raises(TypeError, match="model_id"):
        collector.update_policy_weights_(other, model_id="critic")
    assert torch.equal(collector.policy.population.vectors[1], before)


@COLLECTORS
@pytest.mark.parametrize("close_env", [True, False])
def test_nothing_is_collected_after_a_shutdown(kind, close_env):
    collector = kind(Walk(), actor(), frames_per_batch=16)
    collector.collect()
    collector.shutdown(close_env=close_env)
    with pytest.raises(RuntimeError, match="was shut down: make another one"):
        next(iter(collector))
    collector.shutdown()


@COLLECTORS
@pytest.mark.parametrize("flag", [torch.zeros(SHAPE, dtype=torch.bool), torch.zeros(*SHAPE, 1)])
def test_flags_of_another_shape_or_kind_are_told(kind, flag):
    collector = kind(Flagged(flag), actor(), frames_per_batch=16)
    with pytest.raises(
        ValueError, match=r"Flagged.end_step\(\) gave .* as terminated, expected \(2, 4, 1\) of torch.bool"
    ):
        next(iter(collector))
    collector.shutdown()


class Closed(Walk):
    """One candidate. `ends`: fails at its first step's end; otherwise its physics takes a while. seen: what happened,
    in order."""

    def __init__(self, ends: bool, seen: list[str], both: Barrier) -> None:
        super().__init__(torch.Size((1, 4)))
        self.ends, self.seen, self.both, self.first, self.closed = ends, seen, both, True, False

    def simulate(self, inputs):
        if self.first:  # the other group is in its physics while this one fails
            self.first = False
            self.both.wait(timeout=300)
        if not self.ends:
            time.sleep(0.01)
            self.seen.append("closed" if self.closed else "simulated")
        super().simulate(inputs)

    def end_step(self, action):
        if self.ends:
            raise ArithmeticError("it fell apart")
        return super().end_step(action)

    def close(self, **kwargs):
        self.closed = True
        super().close(**kwargs)


@pytest.mark.skipif(available() < 2, reason="groups take turns on one core")
def test_an_env_is_not_closed_while_a_group_is_in_its_physics_after_another_has_failed():
    seen, both = [], Barrier(2)
    env = GroupedEnv([Closed(True, seen, both), Closed(False, seen, both)])
    collector = PopulationCollector(env, actor(), frames_per_batch=8 * 6)
    with pytest.raises(ArithmeticError, match="it fell apart"):
        next(iter(collector))
    collector.shutdown()
    assert seen == ["simulated"] * 6 and all(group.closed for group in env.groups())


class Numbered(Walk):
    """Its states are numbers of steps; an episode begins at 0."""

    def simulate(self, inputs):
        self.last, self.state = self.state, self.state + 1.0

    def start_episodes(self, mask):
        self.state = self.state.masked_fill(mask.unsqueeze(-1), 0.0)

    def full_state(self):
        return TensorDict({"state": self.state.clone()})

    def load_full_state(self, state):
        self.state = state["state"].clone()


@COLLECTORS
@pytest.mark.parametrize("before", [0, 1])
def test_a_state_is_gone_on_from_whether_or_not_a_batch_was_collected_and_the_next_reset_is_one(kind, before):
    saved = Numbered()
    collector = kind(saved, actor(), frames_per_batch=16)
    next(iter(collector))
    state = collector.state_dict()
    other = Numbered()
    loaded = kind(other, actor(), frames_per_batch=16)
    for _ in range(before):
        next(iter(loaded))
    loaded.load_state_dict(state)
    assert loaded.collect()["observation"][0, 0, :, 0].tolist() == [2.0, 3.0]
    assert other.reset()["observation"].sum() == 0.0


def test_a_state_is_not_loaded_under_steps_that_have_been_captured(monkeypatch):
    collector = CapturedCollector(Numbered(), actor(), frames_per_batch=16, capture=False)
    state = collector.state_dict()
    monkeypatch.setattr(collector, "_graphs", ["as if"])
    with pytest.raises(
        RuntimeError, match="CapturedCollector has captured its steps.*load a state into a new collector"
    ):
        collector.load_state_dict(state)
