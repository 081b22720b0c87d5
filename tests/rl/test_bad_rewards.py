"""A reward that is no number is found where it enters, and a measured one is paid once for a batch."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict
from test_loss_shapes import COUNT, loss_and_batch
from torchrl.collectors import Collector
from torchrl.data import Bounded, Composite, LazyTensorStorage, ReplayBuffer, Unbounded
from torchrl.envs import CatTensors, Compose, EnvBase, TransformedEnv
from torchrl.envs.utils import check_env_specs
from torchrl.objectives.value import GAE

from hts.rl import KLConstrainedPPOLoss, MeasuredReward, RewardCentring

BAD = [math.nan, math.inf, -math.inf]


def collected(key: str | None = None, bad: float = math.nan, **how) -> tuple[KLConstrainedPPOLoss, TensorDict]:
    """Two env instances, four steps each, as a collector gives them, what step 2 of the second one ended in bad."""
    loss, data = loss_and_batch(**how)
    data = data.exclude("advantage", "value_target", "state_value").view(2, 4)
    flags = {name: torch.zeros(2, 4, 1, dtype=torch.bool) for name in ("done", "terminated")}
    ended = TensorDict({"observation": torch.randn(2, 4, 3), "reward": torch.ones(2, 4, 1), **flags}, [2, 4])
    if key is not None:
        ended[key][1, 2] = bad
    data["next"] = ended
    return loss, data


def estimated(loss: KLConstrainedPPOLoss, data: TensorDict) -> TensorDict:
    GAE(gamma=0.9, lmbda=0.8, value_network=loss.critic_network)(data)
    return data.flatten()


# ------------------------------------------------------------------------------------------------------- in the loss


@pytest.mark.parametrize("bad", BAD)
def test_a_reward_that_is_no_number_is_told_with_its_step_before_anything_is_learned(bad):
    loss, data = collected("reward", bad)
    with pytest.raises(ValueError, match=r"^'advantage' is .* The step's reward is .* at \[6, 0\], in 1 of 8 numbers"):
        loss(estimated(loss, data))


def test_of_a_part_of_the_batch_without_that_step_it_says_where_to_look():
    loss, data = collected("reward")
    with pytest.raises(ValueError, match=r"^'advantage' is nan at \[0, 0\], .* of an earlier or later step"):
        loss(estimated(loss, data)[4:6])  # GAE goes backwards: of the same instance, before the bad one


def test_a_target_alone_may_be_no_number():
    loss, data = loss_and_batch()
    data["value_target"][3] = math.nan
    with pytest.raises(ValueError, match=r"^'value_target' is nan at \[3, 0\], in 1 of 8 numbers"):
        loss(data)


@pytest.mark.parametrize(
    ("key", "who"), [("action", "policy"), ("action_log_prob", "policy"), ("state_value", "critic")]
)
@pytest.mark.parametrize("bad", BAD)
def test_so_may_what_was_done_or_was_thought_of_it(key, who, bad):
    loss, data = loss_and_batch()
    data[key].view(COUNT, -1)[3] = bad
    with pytest.raises(ValueError, match=rf"^'{key}' is {bad:g} at \[3.*\], in . of .* The {who} that acted gave it"):
        loss(data)


def test_a_value_of_the_old_critic_that_nobody_reads_may_be_anything():
    loss, data = loss_and_batch(clip_value=None)
    data["state_value"][3] = math.nan
    assert torch.isfinite(loss(data)["loss_critic"])


def test_of_candidates_it_is_told_where_nobody_is_left_for_they_do_not_see_each_other():
    loss, data = collected("reward", kl_bound=torch.tensor([0.1, 0.2]))
    first, second = loss(estimated(loss, data).view(2, 4))["loss_objective"].isnan().tolist()
    assert (first, second) == (False, True)
    loss, data = collected("reward", kl_bound=torch.tensor([0.1, 0.2]))
    data["next", "reward"][0, 0] = math.nan
    with pytest.raises(ValueError, match=r"^'advantage' is nan at \[0, 0, 0\], .* The step's reward is nan at"):
        loss(estimated(loss, data).view(2, 4))


@pytest.mark.parametrize("rows", [slice(None), slice(0, 4)])
def test_nan_in_what_a_step_ended_in_is_told_where_gae_leaves_the_old_value_out(rows):
    loss, data = collected("observation")
    found = estimated(loss, data)[rows]
    kind, said = KeyError, "unless what a step of its batch ended in is NaN under 'next'"
    if rows == slice(None):
        kind, said = ValueError, r"'observation' under 'next' is nan at \[6, 0\]"
    with pytest.raises(kind, match=rf"has no 'state_value' of the old critic.*{said}"):
        loss(found)


def test_what_the_message_says_of_a_mark_that_a_collector_made_works():
    loss, data = collected("observation")
    found = estimated(loss, data)
    with torch.no_grad():
        loss.critic_network(found)
    assert math.isfinite(float(loss(found)["loss_critic"].detach()))
    loss, data = collected("observation", clip_value=None)
    assert math.isfinite(float(loss(estimated(loss, data))["loss_critic"].detach()))


# ----------------------------------------------------------------------------------------------- in a measured reward


def batch_of(effort: torch.Tensor, reward: torch.Tensor | None = None) -> TensorDict:
    paid = torch.zeros_like(effort) if reward is None else reward
    return TensorDict(
        {"next": TensorDict({"effort": effort, "heat": effort.square(), "reward": paid}, [COUNT])}, [COUNT]
    )


def reward_of(key: str = "effort") -> MeasuredReward:
    return MeasuredReward(1.0, 0.1, in_key=key, centring=RewardCentring(0.5))


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("key", ["effort", "reward"])
def test_a_measured_reward_that_is_no_number_is_told_and_moves_no_centre(key, bad):
    measured, data = reward_of(), batch_of(torch.ones(COUNT, 1))
    data["next", key][5] = bad
    with pytest.raises(ValueError, match=rf"^The reward '{key}' is {bad:g} at \[5, 0\], in 1 of 8 numbers"):
        measured(data)
    assert float(measured.centring.mean) == 0.0


class Pushed(EnvBase):
    """Its effort is what is done."""

    def __init__(self) -> None:
        super().__init__()
        self.observation_spec = Composite(observation=Unbounded(1), effort=Unbounded(1))
        self.action_spec, self.reward_spec = Bounded(-1, 1, (1,)), Unbounded(1)

    def _reset(self, tensordict):
        return TensorDict({"observation": torch.zeros(1), "effort": torch.zeros(1)}, [])

    def _step(self, tensordict):
        effort, done = tensordict["action"].sqrt(), torch.zeros(1, dtype=torch.bool)
        return TensorDict({"observation": effort, "effort": effort, "reward": effort * 0, "done": done}, [])

    def _set_seed(self, seed):
        pass


def test_in_an_env_it_is_told_in_its_step():
    env = TransformedEnv(Pushed(), reward_of())
    begun = env.reset()
    env.step(begun.set("action", torch.ones(1)))
    with pytest.raises(ValueError, match=r"^The reward 'effort' is nan at \[0\], in 1 of 1 numbers"):
        env.step(env.reset().set("action", -torch.ones(1)))


# ----------------------------------------------------------------------------------------------------- once for a batch


def efforts() -> torch.Tensor:
    return torch.arange(float(COUNT)).unsqueeze(-1)


def sampled(data: TensorDict) -> TensorDict:
    buffer = ReplayBuffer(storage=LazyTensorStorage(COUNT), batch_size=COUNT)
    buffer.extend(data)
    return buffer.sample()


@pytest.mark.parametrize(
    "again",
    [
        lambda data: data,
        lambda data: data.view(2, 4),
        lambda data: data.copy(),
        lambda data: data.clone(),
        lambda data: data[torch.randperm(COUNT)],
        lambda data: data[2:4],
        lambda data: data.to(torch.float64),
        lambda data: torch.cat([data, data]),
        lambda data: data.exclude("loc"),
        sampled,
    ],
)
def test_a_batch_is_not_paid_twice(again):
    data = batch_of(efforts())
    measured = reward_of()
    paid, centre = measured(data)["next", "reward"].clone(), measured.centring.mean.clone()
    assert data["next", "reward_before_effort"].tolist() == [0.0] * COUNT
    for another in (measured, reward_of()):
        with pytest.raises(ValueError, match="^This batch has got the measured reward of 'effort' already"):
            another(again(data))
    assert torch.equal(data["next", "reward"], paid) and torch.equal(measured.centring.mean, centre)


class Chosen(Pushed):
    """Its effort is of another precision than its reward."""

    def __init__(self, kind: torch.dtype) -> None:
        super().__init__()
        self.kind = kind
        self.observation_spec = Composite(observation=Unbounded(1), effort=Unbounded(1, dtype=kind))

    def _reset(self, tensordict):
        return super()._reset(tensordict).set("effort", torch.zeros(1, dtype=self.kind))

    def _step(self, tensordict):
        done = torch.zeros(1, dtype=torch.bool)
        effort = tensordict["action"].abs()
        found = {"observation": effort, "effort": effort.to(self.kind), "reward": effort * 0, "done": done}
        return TensorDict(found, [])


@pytest.mark.parametrize("kind", [torch.float32, torch.float64])
def test_an_env_that_pays_says_so_in_its_specs_and_in_its_batches(kind):
    env = TransformedEnv(Chosen(kind), reward_of())
    check_env_specs(env)
    data = next(iter(Collector(env, frames_per_batch=8, total_frames=8)))
    assert data["next", "reward"].dtype == torch.float32 and data["next", "reward"].any()
    assert not data["next", "reward_before_effort"].any()
    with pytest.raises(ValueError, match="'next' has 'reward_before_effort'.*and not where the env has it"):
        reward_of()(data)
    with pytest.raises(ValueError, match="^The env has 'reward_before_effort'"):
        TransformedEnv(Chosen(kind), Compose(reward_of(), reward_of())).reset()


def test_what_was_paid_before_is_no_part_of_what_a_policy_sees():
    seen = []
    for paying in ([], [reward_of()]):
        gathered = CatTensors(out_key="seen", del_keys=False)
        env = TransformedEnv(Chosen(torch.float32), Compose(*paying, gathered))
        seen.append((gathered.in_keys, env.rollout(3)["next", "seen"].shape))
    assert seen[0] == seen[1]


def test_a_reward_keeps_its_precision():
    for of_reward, of_effort in ((torch.float32, torch.float64), (torch.float64, torch.float32)):
        data = batch_of(efforts().to(of_effort), torch.zeros(COUNT, 1, dtype=of_reward))
        assert reward_of()(data)["next", "reward"].dtype == of_reward


def test_nor_where_another_reward_was_added_between():
    first, second, data = reward_of("effort"), reward_of("heat"), batch_of(efforts())
    second(first(data))
    for measured in (first, second):
        with pytest.raises(ValueError, match="would get it again"):
            measured(data)


def test_another_batch_is_paid_also_where_it_lies_in_the_memory_of_the_last_one():
    measured, effort, reward = reward_of(), efforts(), torch.zeros(COUNT, 1)
    measured(batch_of(effort, reward))
    measured(batch_of(effort, reward))  # the same memory, as a captured collector gives it: the reward is bare again
    data = measured(batch_of(effort, reward))
    for key in ("effort", "reward"):
        data["next", key].copy_(efforts() + 1.0)  # a collector that writes into the batch that it gave: with its mark
    with pytest.raises(ValueError, match=r"return_same_td=True, give it data.copy\(\)"):
        measured(data)
    measured(batch_of(efforts()))


def test_batches_of_a_collector_that_gives_one_tensordict_again_are_paid_as_copies():
    measured = reward_of()
    for data in Collector(Chosen(torch.float32), frames_per_batch=8, total_frames=24, return_same_td=True):
        assert measured(data.copy())["next", "reward"].any() and not data["next", "reward"].any()


def test_a_reward_that_was_put_back_is_paid_anew():
    measured, data = reward_of(), batch_of(efforts())
    bare = data["next", "reward"].clone()
    paid = measured(data)["next", "reward"]
    data["next", "reward"] = bare
    torch.testing.assert_close(measured(data)["next", "reward"], paid)


def test_nested_entries_of_alike_names_are_paid_each():
    _, data = collected()
    ended = data["next"]
    ended["a", "b"], ended["a_b"] = torch.full((2, 4, 1), 2.0), torch.full((2, 4, 1), 3.0)
    for key in (("a", "b"), "a_b"):
        MeasuredReward(1.0, 1.0, in_key=key, centring=RewardCentring(0.0))(data)
    assert torch.equal(data["next", "reward"], torch.full((2, 4, 1), 6.0))
    assert {"reward_before_a__b", "reward_before_a_b"} <= set(ended.keys())
