"""The KL-constrained PPO loss as a TorchRL loss module."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictParams
from tensordict.utils import NestedKey
from torch import nn
from torch.distributions import Distribution
from torchrl.modules import set_recurrent_mode
from torchrl.objectives.common import LossModule
from torchrl.objectives.utils import ValueEstimators
from torchrl.objectives.value import GAE

from hts.rl.actor import PopulationActor
from hts.rl.counted import counted, marks_in
from hts.rl.entropy import entropy_of
from hts.rl.given import OfItsSizes
from hts.rl.kl import in_reach, kl_of, learned, squashed_alike
from hts.rl.loss_checks import (
    check_action,
    check_actor,
    check_critic,
    check_detached,
    check_finite,
    check_not_empty,
    check_possible,
    check_reference,
    check_same,
    check_settings,
    distribution_of,
    lacks,
    lacks_old_value,
    lacks_value,
    one_each,
    read_by,
    written_keys,
)
from hts.rl.multiplier import LagrangeMultiplier, as_bounds
from hts.rl.rows import row_mean, row_standardised
from hts.rl.surrogate import surrogate, value_error
from hts.rl.told import tell

FORGOTTEN = 1000  # losses before the first update of alpha; 10 passes over a batch in 64 parts are 640


def frozen(module: nn.Module) -> nn.Module:
    """A copy whose parameters are buffers: it is saved and moved with its owner, and no optimiser ever sees it."""
    copied = copy.deepcopy(module).eval()
    for part in list(copied.modules()):
        if isinstance(part, TensorDictParams):
            continue  # holds no parameter of its own: its owner has got another
        for name, child in part.named_children():
            if isinstance(child, TensorDictParams):  # as `MultiAgentMLP` has them, by nested names
                setattr(part, name, TensorDictParams(child.data.clone(), no_convert=True))
        for name, parameter in list(part.named_parameters(recurse=False)):
            delattr(part, name)
            part.register_buffer(name, parameter.detach().clone())
    return copied


def _candidates(module: nn.Module) -> int | None:
    """P of the population that acts in a module; None where there is none."""
    return next((one.population.count for one in module.modules() if isinstance(one, PopulationActor)), None)


def _bound_of_each(kl_bound: float | torch.Tensor, actor: nn.Module, reference: nn.Module) -> float | torch.Tensor:
    """kl_bound, [P] where the actor is several candidates: one mean over all of them would bound nobody. Raises
    ValueError for bounds, or a reference, of another number of candidates."""
    count, others = _candidates(actor), _candidates(reference)
    if count is None:
        return kl_bound
    if others is not None and others != count:
        raise ValueError(f"reference has {others} candidates, actor_network {count}; expected as many.")
    bounds = as_bounds(kl_bound)
    if bounds.ndim == 1 and len(bounds) != count:
        raise ValueError(
            f"kl_bound has the shape {tuple(bounds.shape)}, actor_network {count} candidates; expected a bound for "
            "each, or a float that holds for each."
        )
    return bounds.repeat(count) if bounds.ndim == 0 and count > 1 else kl_bound


class KLConstrainedPPOLoss(OfItsSizes, LossModule):
    """Clipped PPO whose mean KL to a frozen reference policy is held below c by a Lagrange multiplier.

        loss_objective = -E[min(rho A, clip(rho, 1 - eps, 1 + eps) A)] + alpha E[KL(pi || reference)]
        loss_critic    =  v E[(V - G)^2], the larger of it and its clipped form where clip_value is set
        loss_entropy   = -h E[H(pi)]
        kl             =  E[KL(pi || reference)], nats, without gradient

    The expectation of the KL is under the policy being trained (its own states, pi first). TorchRL's `KLPENPPOLoss`
    is not this: it penalises the KL to the behaviour policy, in the other direction. `forward` computes and changes
    nothing; once a batch, after its gradient steps:

        loss.update_multiplier(loss.kl_to_reference(data))

    A UserWarning, once, tells of 1000 losses with gradients, a finite bound and a multiplier_rate above 0 before the
    first update: without any, alpha stays what it is. What torch.compile has compiled is not counted. Another, once,
    tells of an actor without gradients.

    actor_network: has `get_dist`, as a `ProbabilisticActor`; critic_network: writes the value; reference: the policy to
    stay close to, copied and frozen with everything it holds (its observation normaliser too); None: the actor as it is
    now.
    kl_bound: c, nats, infinity for no bound (then, with equal settings, this is `ClipPPOLoss`).

    With a float kl_bound everything is a mean over the batch and every output a scalar. With a tensor [P] the batch's
    first dimension is P candidates, outputs are [P], nothing is reduced over candidates, and c = inf switches single
    ones off. Sum the losses before `backward`: candidates share no parameter. Where the actor is a `PopulationActor` of
    several candidates, or holds one, a float is the bound of each: it stands for [P] times itself.

    Log-probabilities [..., A] are of A agents, which may share an advantage, a value and its target, [..., 1], as in
    `ClipPPOLoss`; every output is a mean over agents, too.

    Steps that TorchRL's masks leave out count in nothing, as in its own losses (`loss_mask_key`): what
    `split_trajectories` or a `SliceSampler` has filled stretches up with, and what `GAE(shifted=True)` marks.

    multiplier_rate: eta of `LagrangeMultiplier`; clip_epsilon: eps; critic_coeff: v; entropy_coeff: h; clip_value: None
    for no clipping of the value, True for eps; normalize_advantage: to mean 0 and deviation 1, of each candidate;
    a single sample stays as it is.
    """

    @dataclass
    class _AcceptedKeys:
        """What `set_keys` takes, and where things are otherwise; action and sample_log_prob: where the actor says.

        advantage, value_target: of GAE; value: the critic's, also that of the old critic in the batch; sample_log_prob:
        ln pi_old(a); action; reward, done, terminated: for the value estimator.
        """

        advantage: NestedKey = "advantage"
        value_target: NestedKey = "value_target"
        value: NestedKey = "state_value"
        sample_log_prob: NestedKey = "action_log_prob"
        action: NestedKey = "action"
        reward: NestedKey = "reward"
        done: NestedKey = "done"
        terminated: NestedKey = "terminated"

    tensor_keys: _AcceptedKeys
    default_keys = _AcceptedKeys
    default_value_estimator = ValueEstimators.GAE
    out_keys = ["loss_objective", "loss_critic", "loss_entropy", "kl", "kl_approx", "clip_fraction"]  # noqa: RUF012

    def __init__(
        self,
        actor_network: TensorDictModuleBase,
        critic_network: TensorDictModuleBase,
        *,
        reference: TensorDictModuleBase | None = None,
        kl_bound: float | torch.Tensor = 0.5,
        multiplier_rate: float = 0.05,
        clip_epsilon: float = 0.2,
        critic_coeff: float = 1.0,
        entropy_coeff: float = 0.0,
        clip_value: float | bool | None = True,
        normalize_advantage: bool = False,
    ) -> None:
        super().__init__()
        check_actor(actor_network)
        check_critic(critic_network)
        if reference is not None:
            check_reference(reference, actor_network)
        check_settings(critic_coeff, entropy_coeff, clip_epsilon, clip_value)
        self.actor_network, self.critic_network = actor_network, critic_network
        self.set_keys(**written_keys(actor_network))
        self.reference = frozen(actor_network if reference is None else reference)
        self.multiplier = LagrangeMultiplier(_bound_of_each(kl_bound, actor_network, self.reference), multiplier_rate)
        self.clip_epsilon, self.critic_coeff, self.entropy_coeff = clip_epsilon, critic_coeff, entropy_coeff
        self.clip_value = clip_epsilon if clip_value is True else (clip_value or None)
        self.normalize_advantage = normalize_advantage
        self._told_frozen = False
        self._alike: bool | None = None
        self._waiting = FORGOTTEN if multiplier_rate > 0.0 and bool(self.kl_bound.isfinite().any()) else 0
        parameter = next(actor_network.parameters(), None)
        if parameter is not None:
            self.multiplier.to(parameter.device)

    def train(self, mode: bool = True) -> KLConstrainedPPOLoss:
        """Training mode of actor and critic; the reference stays as it is when it acts."""
        super().train(mode)
        self.reference.eval()
        return self

    @property
    def functional(self) -> bool:
        """False: the networks are used as they are, no parameters are taken out of them."""
        return False

    @property
    def kl_bound(self) -> torch.Tensor:
        """c, nats, [] or [P]. Change it in place between batches: `loss.kl_bound.fill_(0.2)`."""
        return self.multiplier.bounds

    @property
    def in_keys(self) -> list[NestedKey]:  # type: ignore[override]
        keys = self.tensor_keys
        found = [*self.actor_network.in_keys, *self.critic_network.in_keys, keys.action, keys.sample_log_prob]
        found += [keys.advantage, keys.value_target, *((keys.value,) if self.clip_value else ())]
        return list(dict.fromkeys(found))

    def _forward_value_estimator_keys(self, **kwargs: NestedKey) -> None:
        if self._value_estimator is not None:
            self._value_estimator.set_keys(**{name: getattr(self.tensor_keys, name) for name in ESTIMATED})

    def make_value_estimator(self, value_type: ValueEstimators | str | None = None, **hyperparams: Any) -> LossModule:
        """GAE on this loss's critic and keys, as `loss.value_estimator`; hyperparams: gamma, lmbda, ... Raises
        NotImplementedError for any other estimator: give its advantage and value_target in the batch instead."""
        if value_type not in (None, ValueEstimators.GAE, "gae"):
            raise NotImplementedError(
                f"{value_type} is not supported, GAE is. Put advantage and value_target into the batch."
            )
        self._value_estimator = GAE(value_network=self.critic_network, **{"gamma": 0.99, "lmbda": 0.95, **hyperparams})
        self._forward_value_estimator_keys()
        return self

    # --------------------------------------------------------------------------------------------------- computing

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """tensordict [...], or [P, ...]: see `in_keys`. Returns `out_keys`, each [] or [P]: three losses, and without
        gradients kl, kl_approx (an estimate of that to the policy that acted), nats, and clip_fraction.

        Raises KeyError naming what the batch lacks, ValueError where its actions or their log-probabilities carry
        gradients: against themselves nothing would be learned; for shapes that do not fit each other, actions of
        another shape than the actor's, an empty batch, and, on a CPU, actions that the actor never gives, and actions,
        log-probabilities, advantages, targets or old values that are not finite, of several candidates where nobody's
        are."""
        if torch.is_grad_enabled() and not torch.compiler.is_compiling():  # a number that changes is compiled anew
            self._count()
        keys, batch = self.tensor_keys, tensordict.copy()
        gives = {keys.action: "A collector", keys.sample_log_prob: "An actor with return_log_prob=True"}
        for key in (keys.action, keys.sample_log_prob, keys.advantage, keys.value_target):
            if batch.get(key, None) is None:
                raise lacks(batch, key, gives.get(key, "GAE"))
        check_not_empty(batch.shape)
        if batch.ndim:  # else only what is computed of it says whose it is
            self._check_candidates(batch.shape)
        marks = marks_in(batch, self._loss_mask_keys())
        for key in (keys.advantage, keys.value_target):
            self._check_finite(batch, key, marks)
        old_value = batch.get(keys.value, None)
        check_detached(batch, keys.action, keys.sample_log_prob)
        policy = self._policy_in(batch)
        check_action(batch[keys.action], policy, keys.action)
        self._check_finite(batch, keys.action, marks)
        check_possible(batch, keys.action, policy, marks)
        action = in_reach(policy, batch[keys.action], counted(batch, batch[keys.action].shape, marks))
        log_prob = policy.log_prob(action)
        self._check_candidates(log_prob.shape)
        steps = counted(batch, log_prob.shape, marks)
        if torch.is_grad_enabled() and not torch.compiler.is_compiling() and not log_prob.requires_grad:
            self._tell_frozen()
        log_ratio = log_prob - one_each(batch, keys.sample_log_prob, log_prob)
        self._check_finite(batch, keys.sample_log_prob, marks)
        advantage = one_each(batch, keys.advantage, log_prob, shared_by=policy)
        if self.normalize_advantage:
            advantage = self._standardised(advantage, counted(batch, advantage.shape, marks))
        with torch.set_grad_enabled(torch.is_grad_enabled() and self._pulls()):
            kl = self._kl(policy, batch)
        valued = read_by("critic_network", self.critic_network, batch.exclude(keys.value), self.critic_network)
        if valued.get(keys.value, None) is None:
            raise lacks_value(self.critic_network.out_keys, keys.value)
        target = one_each(batch, keys.value_target, log_prob, shared_by=policy)
        value = one_each(valued, keys.value, log_prob, shared_by=policy)
        check_same({keys.value_target: target, keys.value: value})
        if self.clip_value is not None and old_value is None:
            raise lacks_old_value(batch, keys.value, self.critic_network.in_keys)
        old_value = value.detach() if old_value is None else one_each(batch, keys.value, log_prob, shared_by=policy)
        check_same({keys.value_target: target, keys.value: old_value})
        if self.clip_value is not None:
            self._check_finite(batch, keys.value, marks)
        error = value_error(value, target, old_value, self.clip_value)
        mean_kl = self._mean(kl, steps)
        objective = self._mean(surrogate(log_ratio, advantage, self.clip_epsilon), steps) + self.multiplier(mean_kl)
        with torch.no_grad():
            clipped = ((log_ratio.exp() - 1.0).abs() > self.clip_epsilon).to(log_ratio.dtype)
        losses = {
            "loss_objective": objective,
            "loss_critic": self.critic_coeff * self._mean(error, counted(batch, error.shape, marks)),
            "loss_entropy": self._entropy_loss(policy, log_ratio, steps),
            "kl": mean_kl.detach(),
            "kl_approx": self._mean(-log_ratio.detach(), steps),
            "clip_fraction": self._mean(clipped, steps),
        }
        return TensorDict(losses, batch_size=self.multiplier.value.shape)

    @torch.no_grad()
    @set_recurrent_mode(True)  # as TorchRL has it in `forward`
    def kl_to_reference(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Mean KL(pi || reference) over the states of a batch, with the parameters as they are; [] or [P], nats. Of a
        recurrent actor over whole stretches, [..., T], as `forward` has it. Raises ValueError for an empty batch, and
        one without its candidates in front."""
        batch = tensordict.copy()
        check_not_empty(batch.shape)
        if batch.ndim:  # else only what is computed of it says whose it is
            self._check_candidates(batch.shape)
        kl = self._kl(self._policy_in(batch), batch)
        self._check_candidates(kl.shape)
        return self._mean(kl, counted(batch, kl.shape, self._loss_mask_keys()), least=0)

    def update_multiplier(self, kl: torch.Tensor) -> torch.Tensor:
        """alpha <- [alpha + eta min(KL / c - 1, 2)]_+, once per batch; see `LagrangeMultiplier`. Returns the new
        alpha. Raises ValueError for a KL that is NaN or of another shape than kl_bound. Warns, once, of one that stays
        above 2 c."""
        return self.multiplier.update(kl)

    def _policy_in(self, batch: TensorDictBase) -> Distribution:
        return distribution_of("actor_network", self.actor_network, batch)

    @torch.no_grad()
    def _reference_in(self, batch: TensorDictBase) -> Distribution:
        return distribution_of("reference", self.reference, batch.copy())

    def _pulls(self) -> bool:
        """Whether the KL's gradient may count. It need not be finite where one sample stands for the KL, and 0 times
        that is NaN. On a GPU nobody asks alpha, and it may."""
        alpha = self.multiplier.value
        return alpha.device.type != "cpu" or torch.compiler.is_compiling() or bool(alpha.any())

    def _kl(self, policy: Distribution, batch: TensorDictBase) -> torch.Tensor:
        reference = self._reference_in(batch)
        if self._alike is None or not torch.compiler.is_compiling():  # which cannot compare limits, and takes them to
            self._alike = squashed_alike(policy, reference)  # be what they were, unless they are learned
        return kl_of(policy, reference, self._alike and not (torch.compiler.is_compiling() and learned(policy)))

    def _count(self) -> None:
        """Warn, once, where alpha has not been updated for so long that it may have been forgotten."""
        if self._waiting == 0 or self.multiplier.updated:
            return
        self._waiting -= 1
        if self._waiting == 0:
            tell(
                f"{FORGOTTEN} losses were computed and the multiplier was never updated: it stays what it is, and "
                "nothing holds the policy to kl_bound. Call loss.update_multiplier(loss.kl_to_reference(data)) once a "
                "batch, or make the loss with multiplier_rate=0 if that is meant."
            )

    def _tell_frozen(self) -> None:
        """Warn, once, of an actor without gradients: the critic's would let every step pass."""
        if not self._told_frozen:
            self._told_frozen = True
            tell(
                "No parameter of actor_network asks for gradients, so the policy stays what it is while the critic "
                "learns. Give the policy that is to be trained, not a frozen copy, or actor.requires_grad_()."
            )

    def _check_finite(self, batch: TensorDictBase, key: NestedKey, marks: Sequence[NestedKey]) -> None:
        keys = self.tensor_keys
        made = {keys.action: "policy", keys.sample_log_prob: "policy", keys.value: "critic"}
        gives = None if key not in made else f"The {made[key]} that acted gave it, or what it saw is not finite"
        several = self.kl_bound.ndim > 0
        check_finite(batch, key, reward=keys.reward, candidates=several, gives=gives, masks=marks)

    def _check_candidates(self, shape: torch.Size) -> None:
        """Raise ValueError unless a batch of this shape begins with as many candidates as there are bounds."""
        count = self.kl_bound.shape
        if count and shape[:1] != count:
            raise ValueError(
                f"The batch has the shape {tuple(shape)}, kl_bound {tuple(count)}: its first dimension is to be the "
                f"candidates, {count[0]}, which flatten(1, 2) of a batch [P, N, T] keeps in front. Give a float as "
                "kl_bound where there is one policy."
            )

    def _entropy_loss(self, policy: Distribution, log_ratio: torch.Tensor, steps: torch.Tensor | None) -> torch.Tensor:
        """-h E[H(pi)]; nothing is computed, or sampled, where h is 0."""
        entropy = entropy_of(policy, log_ratio) if self.entropy_coeff else torch.zeros_like(log_ratio)
        return -self.entropy_coeff * self._mean(entropy, steps)

    def _mean(self, x: torch.Tensor, steps: torch.Tensor | None, least: int = 1) -> torch.Tensor:
        """[] or [P]; steps: which of x count. least: a candidate with fewer has that many, of 0 each; 0: it has NaN."""
        mean = row_mean if self.multiplier.value.ndim else torch.mean
        if steps is None:
            return mean(x)
        share = mean(steps.to(x.dtype))
        return mean(torch.where(steps, x, 0.0)) / share.clamp(min=least * share.numel() / x.numel())

    def _standardised(self, x: torch.Tensor, steps: torch.Tensor | None) -> torch.Tensor:
        count = len(x) if self.multiplier.value.ndim else 1
        return row_standardised(x.reshape(count, -1), None if steps is None else steps.reshape(count, -1)).view(x.shape)


ESTIMATED = ("advantage", "value_target", "value", "reward", "done", "terminated")
"""Keys that the value estimator shares with the loss."""
