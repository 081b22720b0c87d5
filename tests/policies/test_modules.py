"""A policy file as TorchRL's ordinary modules."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import ProbabilisticTensorDictSequential
from torchrl.modules import ProbabilisticActor, ValueOperator

from hts.contracts import RobotSpec
from hts.envs.observation import observation_layout
from hts.errors import PolicyError
from hts.policies.files import Policy, load_policy, make_card, save_policy
from hts.policies.modules import actor_of, critic_of, with_parameters
from hts.rl import Population, Sizes

SPEC = RobotSpec(
    name="cart",
    joint_names=("left", "right"),
    default_pose=(0.0, 0.0),
    kp=(1.0, 1.0),
    kd=(0.1, 0.1),
    action_scale=(0.5, 0.5),
    torque_limit=(1.0, 1.0),
    velocity_limit=(9.0, 9.0),
    position_limit=((-1.0, 1.0), (-1.0, 1.0)),
    control_rate_hz=50.0,
    physics_dt=0.01,
    substeps=2,
    base_height=0.3,
)
SIZES = Sizes(15, 7, 2, (16, 8))


def population() -> Population:
    made = Population(SIZES, 1, init_std=0.4, seed=4)
    made.observation_mean += 0.3
    made.observation_std *= 2.0
    made.critic_observation_mean -= 0.1
    made.refresh()
    return made


def policy(**made) -> Policy:
    tensors = population().candidate(0)
    return Policy(tensors, make_card(SPEC, tensors, observation_layout(2), SIZES, **made))


def test_a_policy_file_opens_as_an_ordinary_actor_and_critic(tmp_path):
    opened = load_policy(save_policy(tmp_path / "walk", policy()))
    actor, critic = actor_of(opened), critic_of(opened)
    assert isinstance(actor, ProbabilisticActor | ProbabilisticTensorDictSequential) and isinstance(
        critic, ValueOperator
    )
    data = TensorDict({"observation": 8 * torch.randn(4, 6, 15), "critic_observation": torch.randn(4, 6, 7)}, [4, 6])
    critic(actor(data))
    whole = population()
    torch.testing.assert_close(data["loc"], whole.mean(data["observation"].view(1, 24, 15)).view(4, 6, 2))
    torch.testing.assert_close(data["scale"], torch.full((4, 6, 2), 0.4))
    value = whole.value(data["critic_observation"].view(1, 24, 7)).view(4, 6, 1)
    torch.testing.assert_close(data["state_value"], value)
    torch.testing.assert_close(data["action_log_prob"], actor.get_dist(data).log_prob(data["action"]))


def test_what_was_trained_goes_back_into_a_policy_file(tmp_path):
    start = policy()
    actor, critic = actor_of(start), critic_of(start)
    assert torch.equal(with_parameters(start, actor, critic).tensors["actor.1.bias"], start.tensors["actor.1.bias"])
    assert with_parameters(start, actor, critic).card.policy_hash == start.card.policy_hash
    with torch.no_grad():
        for parameter in (*actor.parameters(), *critic.parameters()):
            parameter.add_(0.1)
    changed = load_policy(save_policy(tmp_path / "walk", with_parameters(start, actor, critic)), SPEC)
    assert changed.card.policy_hash != start.card.policy_hash
    for name in ("actor.0.weight", "critic.2.bias", "log_std"):
        torch.testing.assert_close(changed.tensors[name], start.tensors[name] + 0.1)
    assert torch.equal(changed.tensors["observation_mean"], start.tensors["observation_mean"])


def test_what_was_trained_since_does_not_claim_to_have_been_made_as_its_start_was(tmp_path):
    start = policy(command="hts pretrain --robot cart")
    actor = actor_of(start)
    assert with_parameters(start, actor).card == start.card
    with torch.no_grad():
        next(actor.parameters()).add_(0.1)
    once = load_policy(save_policy(tmp_path / "once", with_parameters(start, actor)))
    assert "command" not in once.card.made
    assert once.card.made["start"] == {"policy_hash": start.card.policy_hash, "made": start.card.made}
    with torch.no_grad():
        next(actor.parameters()).add_(0.1)
    twice = with_parameters(once, actor).card.made["start"]
    assert twice["policy_hash"] == once.card.policy_hash and twice["made"] == once.card.made


def test_a_module_of_another_shape_is_refused():
    start = policy()
    with pytest.raises(ValueError, match="The actor has 1 linear layers, its policy 3"):
        with_parameters(start, torch.nn.Linear(15, 2))


def test_numbers_that_training_has_broken_are_named():
    start = policy()
    actor, critic = actor_of(start), critic_of(start)
    with torch.no_grad():
        list(critic.parameters())[-1].fill_(float("nan"))
    with pytest.raises(PolicyError, match=r"The trained policy: 'critic.2.bias' holds numbers that are not finite"):
        with_parameters(start, actor, critic)
