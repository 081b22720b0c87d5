"""What the loss asks of its networks and of a batch, and what it says of a mistake."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any, TypeVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import CompositeDistribution, TensorDictModuleBase, TensorDictSequential
from tensordict.nn import distributions as tensordict_distributions
from tensordict.utils import NestedKey
from torch.distributions import Distribution, Independent
from torch.nn.parameter import is_lazy
from torchrl.modules import Delta, MaskedOneHotCategorical, OneHotCategorical, TanhDelta

from hts.rl.actor import PopulationActor
from hts.rl.counted import counted
from hts.rl.given import check_number
from hts.rl.kl import expands
from hts.rl.possible import impossible, name_of, support_of

Read = TypeVar("Read")
SURE = Delta, TanhDelta, tensordict_distributions.Delta


def check_actor(actor: TensorDictModuleBase, name: str = "actor_network") -> None:
    """Raise TypeError for an actor, or reference, whose distribution of one action nobody can ask for, ValueError for
    one that has no parameters yet."""
    try:
        actor.get_dist  # noqa: B018 -- of TorchRL's actors, and of whatever else gives distributions
    except AttributeError as error:
        raise TypeError(
            f"{name} is a {type(actor).__name__} without get_dist; expected a ProbabilisticActor, a "
            "ProbabilisticTensorDictSequential, or what else has it."
        ) from error
    with suppress(AttributeError):  # not every actor says it
        if len(actor.dist_sample_keys) > 1:
            raise several_actions(name, actor.dist_sample_keys)
    last = actor[-1] if isinstance(actor, TensorDictSequential) else actor  # it is the last module that knows
    with suppress(AttributeError):  # only modules with a distribution have it
        if last.distribution_class in SURE:
            raise TypeError(
                f"{name} has a {last.distribution_class.__name__}, one action in each state, of which there is no "
                "ratio of probabilities and no KL; expected a distribution that is drawn from, such as TanhNormal."
            )
    if any(map(is_lazy, actor.parameters())):
        raise ValueError(
            f"{name} has parameters without a shape yet (a lazy layer), of which no reference can be kept. Show it one "
            "batch, or the env's fake_tensordict(), before the loss is made."
        )


def written_keys(actor: TensorDictModuleBase) -> dict[str, NestedKey]:
    """Where an actor writes its action and its log-probability, as `set_keys` of a loss takes them; nothing of one that
    does not say."""
    found: dict[str, NestedKey] = {}
    with suppress(AttributeError):
        for name, keys in (("action", actor.dist_sample_keys), ("sample_log_prob", actor.log_prob_keys)):
            found |= {name: keys[0]} if len(keys) == 1 else {}
    return found


def several_actions(name: str, actions: Iterable[NestedKey]) -> TypeError:
    return TypeError(
        f"{name} has several actions, {', '.join(map(repr, actions))}; expected one. Of numbers that are drawn alike "
        "torch's Independent makes one action."
    )


def check_critic(critic: TensorDictModuleBase) -> None:
    """Raise TypeError for a critic that reads no TensorDict."""
    try:
        critic.in_keys  # noqa: B018 -- of every TensorDict module
    except AttributeError as error:
        raise TypeError(
            f"critic_network is a {type(critic).__name__}, which reads no TensorDict; expected a module that writes "
            'the value into one: ValueOperator(critic, in_keys=["observation"]) of torchrl.modules makes it one.'
        ) from error


def check_reference(reference: TensorDictModuleBase, actor: TensorDictModuleBase) -> None:
    """Raise TypeError for a reference that is no actor, ValueError for a population's that reads or does something
    else than the actor; of other modules only a batch tells."""
    check_actor(reference, "reference")
    if isinstance(reference, PopulationActor) and isinstance(actor, PopulationActor):
        told = [(one.population.sizes.observation, one.population.sizes.action) for one in (reference, actor)]
        if told[0] != told[1]:
            raise ValueError(
                f"reference reads {told[0][0]} numbers of a state and has {told[0][1]} actions, actor_network reads "
                f"{told[1][0]} and has {told[1][1]}; expected the same of both: give a policy of the same task."
            )


def check_settings(critic_coeff: float, entropy_coeff: float, clip_epsilon: float, clip_value: float | None) -> None:
    """Raise ValueError for numbers with which nothing, or the opposite, would be learned, TypeError for no numbers."""
    check_number("clip_epsilon", clip_epsilon, "how far a ratio may go from 1")
    check_number("critic_coeff", critic_coeff, "what the critic's loss is multiplied by")
    check_number("entropy_coeff", entropy_coeff, "what the entropy is multiplied by")
    if clip_value is not None:
        check_number("clip_value", clip_value, "how far a value may go; or True for clip_epsilon, None for no clipping")
    if not 0.0 < clip_epsilon < math.inf:
        raise ValueError(f"clip_epsilon is {clip_epsilon}; expected a positive number, such as 0.2.")
    if not 0.0 <= critic_coeff < math.inf:
        raise ValueError(f"critic_coeff is {critic_coeff}; expected a number from 0 on, such as 1.")
    if not math.isfinite(entropy_coeff):
        raise ValueError(f"entropy_coeff is {entropy_coeff}; expected a finite number, such as 0.001, or 0 for none.")
    if clip_value is not None and not clip_value >= 0.0:
        raise ValueError(f"clip_value is {clip_value}; expected a number from 0 on, True for clip_epsilon, or None.")


def lacks(batch: TensorDictBase, key: NestedKey, gives: str) -> KeyError:
    """What to raise where a batch has no entry of this key; gives: who writes it, in words."""
    return KeyError(f"The batch has no {key!r}; it has {sorted(map(str, batch.keys()))}. {gives} gives it.")


def lacks_value(written: Sequence[NestedKey], key: NestedKey) -> KeyError:
    """What to raise where a critic writes other entries than the one of this key."""
    return KeyError(
        f"critic_network writes {', '.join(map(repr, written))}, and no {key!r}, where the loss looks for the value: "
        "loss.set_keys(value=...) names another entry."
    )


def check_detached(batch: TensorDictBase, *keys: NestedKey) -> None:
    """Raise ValueError where one of these entries carries gradients."""
    for key in keys:
        if batch[key].requires_grad:
            raise ValueError(
                f"The batch's {key!r} carries gradients, so nothing, or something else, would be learned from it. "
                "Collect under torch.no_grad(), as collectors do, or detach it."
            )


def check_not_empty(shape: torch.Size) -> None:
    """Raise ValueError for a batch of this shape that holds nothing: the mean of nothing is NaN."""
    if 0 in shape:
        raise ValueError(
            f"The batch has the shape {tuple(shape)}, nothing is in it; expected one sample at least. Look at how it "
            "was made: an index, a mask or a part of a split is empty."
        )


def check_action(action: torch.Tensor, policy: Distribution, key: NestedKey) -> None:
    """Raise ValueError for actions of another shape than the policy's, which torch would broadcast, or speak of
    dimensions, TypeError for a policy of several actions."""
    if isinstance(policy, CompositeDistribution):  # of an actor that did not say
        raise several_actions("actor_network", policy.dists)
    own = _action_shape(policy)
    states = action.shape[: action.ndim - len(own)]
    if action.shape != states + own or not expands(policy.batch_shape, states):
        raise ValueError(
            f"{key!r} has the shape {tuple(action.shape)}, expected {tuple(policy.batch_shape + own)}: "
            f"in states {tuple(policy.batch_shape)} the policy has actions {tuple(own)}."
        )


def one_each(
    batch: TensorDictBase, key: NestedKey, log_prob: torch.Tensor, shared_by: Distribution | None = None
) -> torch.Tensor:
    """What batch has under key, in the shape of the actions' log-probabilities. Raises ValueError unless it is one
    number for each of them: what broadcasts would be added to the wrong actions.

    shared_by: the policy that gave them. If they are [..., A], of A agents, what is [..., 1] for all of them stays
    that, as in TorchRL's losses; a policy of single components is none of agents.
    """
    value = batch[key]
    if value.numel() == log_prob.numel():
        return value.reshape(log_prob.shape)
    states = value.shape[:-1]
    shared = value.shape[-1:] == (1,) and states == log_prob.shape[: len(states)] and len(states) >= max(batch.ndim, 1)
    if shared_by is not None and shared and not _is_of_components(shared_by):
        return value.reshape(*states, *(1,) * (log_prob.ndim - len(states)))
    raise ValueError(
        f"{key!r} has the shape {tuple(value.shape)}, the actor's log-probabilities {tuple(log_prob.shape)}: one "
        "number for each action is expected in both. A distribution that has one for each component, such as "
        "Normal, becomes one of whole actions by torch's Independent. What several agents share of a state ends with "
        "a dimension of 1."
    )


def check_same(values: Mapping[NestedKey, torch.Tensor]) -> None:
    """Raise ValueError for two entries of another shape, of which one is each agent's and one is shared by them."""
    (key, value), (other, like) = values.items()
    if value.shape != like.shape:
        raise ValueError(
            f"{other!r} is {tuple(like.shape)}, {key!r} {tuple(value.shape)}; expected as many numbers, one for each "
            "agent or one that they share."
        )


def _is_of_components(policy: Distribution) -> bool:
    """Whether each number of an action that is not a choice has a log-probability of its own."""
    support = support_of(policy)
    return not _action_shape(policy) and (support is None or not support.is_discrete)


def _action_shape(policy: Distribution) -> torch.Size:
    """Shape of an action. TorchRL's and tensordict's one-hot distributions are Categoricals, and say of themselves what
    those do: ()."""
    if isinstance(policy, Independent):
        return policy.event_shape + _action_shape(policy.base_dist)[len(policy.base_dist.event_shape) :]
    if isinstance(policy, OneHotCategorical | MaskedOneHotCategorical):
        return torch.Size((policy.num_samples,))
    if isinstance(policy, tensordict_distributions.OneHotCategorical):
        return policy.logits.shape[-1:]
    return policy.event_shape


def check_possible(batch: TensorDictBase, key: NestedKey, policy: Distribution, masks: Iterable[NestedKey]) -> None:
    """Raise ValueError for actions that the policy never does: a number of none of its choices, or one beyond limits
    that its distribution has, whose density is clamped there and teaches nothing. On a CPU alone, as `check_finite`."""
    action = batch[key]
    if action.device.type != "cpu" or torch.compiler.is_compiling():
        return
    bad, steps = impossible(policy, action), counted(batch, action.shape, masks)
    if bad is None or not bool((bad if steps is None else bad & steps).any()):
        return
    raise ValueError(
        f"{key!r} is {first_bad(action, bad if steps is None else bad & steps)}, which the actor's distribution "
        f"({name_of(policy)}) never gives. Expected the actions that the actor wrote, not those of another policy, "
        "or under another mask, nor in an env's units, which a transform has made of them."
    )


def distribution_of(name: str, actor: TensorDictModuleBase, batch: TensorDictBase) -> Distribution:
    """An actor's distribution in the states of a batch, which gets what the actor writes; as `read_by`."""
    policy = read_by(name, actor, batch, actor.get_dist)
    if isinstance(policy, CompositeDistribution) and len(policy.dists) == 1:  # as where a module follows the action
        return next(iter(policy.dists.values()))
    return policy


def read_by(name: str, module: TensorDictModuleBase, batch: TensorDictBase, ask: Callable[[Any], Read]) -> Read:
    """What a network, asked, makes of a batch. Raises KeyError where the batch lacks what it reads, ValueError where it
    was made for numbers of another size, of which torch would speak without saying whose they are."""
    try:
        return ask(batch)
    except KeyError as error:
        lacks = [key for key in module.in_keys if batch.get(key, None) is None]
        if not lacks:  # a mistake of its own
            raise
        raise KeyError(
            f"The batch has no {lacks[0]!r}, which {name} reads; it has {sorted(map(str, batch.keys()))}. A collector "
            "gives it, where the env has it."
        ) from error
    except RuntimeError as error:
        if type(error) is not RuntimeError:  # memory has run out, or a GPU is gone
            raise
        seen = ", ".join(f"{key!r} {tuple(batch[key].shape)}" for key in module.in_keys if key in batch.keys(True))
        raise ValueError(
            f"{name} cannot read the batch, where it finds {seen}: {' '.join(str(error).split())}. Expected numbers of "
            "the sizes that it was made for: policy, critic, reference and batch are to be of one task."
        ) from error


def first_bad(value: torch.Tensor, bad: torch.Tensor) -> str:
    """The first of the numbers that are bad, where it is, and how many there are, in words."""
    index = bad.nonzero()[0].tolist()
    return f"{float(value[tuple(index)]):g} at {index}, in {int(bad.sum())} of {bad.numel()} numbers"


def check_finite(
    batch: TensorDictBase,
    key: NestedKey,
    *,
    reward: NestedKey,
    candidates: bool,
    gives: str | None,
    masks: Iterable[NestedKey],
) -> None:
    """Raise ValueError where what a batch has under key is not finite; of candidates only where nobody's is, for
    they do not see each other, and one that is bad shows in its own loss. On a CPU alone: asking waits for a GPU, in
    every gradient step; there the update of the multiplier tells.

    gives: where it comes from, in words; None: GAE has made it of the rewards, whose key under "next" reward is; masks:
    the keys of which steps count.
    """
    value = batch[key]
    if value.device.type != "cpu" or torch.compiler.is_compiling():
        return
    bad, steps = ~value.isfinite(), counted(batch, value.shape, masks)
    if steps is not None:
        bad &= steps
    rows = bad.reshape(len(bad), -1).any(1) if candidates else bad.any()
    if not bool(rows.all()):
        return
    paid = batch.get(("next", *reward) if isinstance(reward, tuple) else ("next", reward), None)
    worse = None if paid is None else ~paid.isfinite()
    if gives is not None:
        source = f"{gives}: look at the collected batch."
    elif paid is not None and worse is not None and bool(worse.any()):
        source = f"The step's reward is {first_bad(paid, worse)}."
    else:
        source = "It comes from a reward, a value or a state of an earlier or later step: look at the collected batch."
    raise ValueError(
        f"{key!r} is {first_bad(value, bad)}. {source} A step on it would spoil the policy for good: stop, and mend "
        "the env, the measurement or the critic that gives it."
    )


def lacks_old_value(batch: TensorDictBase, key: NestedKey, read: list[NestedKey]) -> Exception:
    """What to raise where a batch has no value of the old critic; read: what the critic reads. TorchRL's GAE takes NaN
    in what a step ended in as the mark of what was not kept, works on a copy, and leaves the batch without it."""
    needs = f"The batch has no {key!r} of the old critic, which clip_value needs."
    for name in read:
        ended = batch.get(("next", *name) if isinstance(name, tuple) else ("next", name), None)
        bad = None if ended is None else ended.isnan()
        if ended is not None and bad is not None and bool(bad.any()):
            return ValueError(
                f"{needs} GAE has left it out, since {name!r} under 'next' is {first_bad(ended, bad)}. If the env "
                "wrote that, it has diverged there: mend it, or end the episode before. If a collector did, for what "
                "it did not keep (compact_obs=True), call the critic on the batch after GAE, or give clip_value=None."
            )
    return KeyError(
        f"{needs} GAE gives it, unless what a step of its batch ended in is NaN under 'next': look for that where GAE "
        "was called, else call it, or give clip_value=None."
    )
