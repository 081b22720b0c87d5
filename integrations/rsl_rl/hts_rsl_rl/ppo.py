"""`AnchoredPPO`: rsl_rl's PPO with the mean KL to a fixed policy held below c by a Lagrange multiplier."""

from __future__ import annotations

import copy
from importlib.metadata import version
from typing import Any

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import nn

from hts_rsl_rl.anchor import actor_state, critic_state, fingerprint, load_into, read_checkpoint
from hts_rsl_rl.errors import AnchorError
from hts_rsl_rl.multiplier import LagrangeMultiplier, RunningMean

SAVED = "anchored"
"""Key of the state of the bound in a checkpoint."""
# Up to 5.4 rsl_rl's normalisers learn at every step (PPO.process_env_step), from 5.5 on at the end of PPO.update, in
# whose place ours stands.
ONCE_A_BATCH = tuple(int(part) for part in version("rsl-rl-lib").split(".")[:2]) >= (5, 5)


class AnchoredPPO(PPO):
    """Clipped PPO with E[KL(pi || anchor)] <= c, the expectation over the states that pi itself visits.

        L = -E[min(rho A, clip(rho, 1 - eps, 1 + eps) A)] + v L_V - h E[H(pi)] + alpha E[KL(pi || anchor)]
        alpha <- [alpha + eta (KL / c - 1)]_+, once per batch, with the KL after its gradient steps

    The policy that is trained comes first in the KL, and the anchor never moves, nor does the normaliser of its
    observations; PPO's own `desired_kl` is another thing, between two batches, and works as ever.

    Settings beside those of rsl_rl's PPO, under `algorithm`:

    anchor_checkpoint: a model_N.pt of rsl_rl, read with weights_only=True; kl_bound: c, nats, infinity for none;
    multiplier_rate: eta; start_from_anchor: begin with the anchor's actor, and its critic where the file has one;
    freeze_normalization: keep the actor's observation normaliser as the anchor has it, since a normaliser that moves
    is a policy that moves; centring_rate: subtract a running mean from all rewards, beta per batch, None for none (for
    tasks that end early it changes what staying alive is worth: there centre the measured reward alone, as
    `MeasuredReward` does).

    Logged with the losses: kl_to_anchor (nats), multiplier, sigma_over_anchor (mean ratio: a KL that is bought by
    widening sigma is not a step), reward_centre. Raises AnchorError.
    """

    def __init__(
        self,
        actor: MLPModel,
        critic: MLPModel,
        storage: RolloutStorage,
        *args: Any,
        anchor_checkpoint: str = "",
        kl_bound: float = 0.5,
        multiplier_rate: float = 0.05,
        start_from_anchor: bool = True,
        freeze_normalization: bool = True,
        centring_rate: float | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__(actor, critic, storage, *args, **kwargs)
        for setting, present in (
            ("a recurrent actor or critic", actor.is_recurrent or critic.is_recurrent),
            ("rnd_cfg", self.rnd is not None),
            ("symmetry_cfg", self.symmetry is not None),
            ("use_mixed_precision", bool(kwargs.get("use_mixed_precision"))),
        ):
            if present:
                raise AnchorError(f"AnchoredPPO does not support {setting}. Leave it out, or train with PPO.")
        self.learning_rate: float
        self.lagrange = LagrangeMultiplier(kl_bound, multiplier_rate)
        self.centring = None if centring_rate is None else RunningMean(centring_rate, self.device)
        self._rewards: list[torch.Tensor] = []

        checkpoint = read_checkpoint(anchor_checkpoint)
        state = actor_state(checkpoint, anchor_checkpoint)
        self.anchor = copy.deepcopy(self._raw_actor)
        load_into(self.anchor, state, "actor", anchor_checkpoint)
        self.anchor.requires_grad_(False).eval()
        self.anchor_sha256 = fingerprint(self.anchor.state_dict())
        if start_from_anchor:
            load_into(self._raw_actor, state, "actor", anchor_checkpoint)
            values = critic_state(checkpoint)
            if values is not None:
                load_into(self._raw_critic, values, "critic", anchor_checkpoint)
        if freeze_normalization and self._raw_actor.obs_normalization:
            self._raw_actor.obs_normalizer.until = 0  # it learns until so many samples were seen

    # ---------------------------------------------------------------------------------------------- collecting

    def process_env_step(
        self, obs: TensorDict, rewards: torch.Tensor, dones: torch.Tensor, extras: dict[str, torch.Tensor]
    ) -> None:
        """As PPO; the rewards' mean is remembered for the centre."""
        if self.centring is not None:
            self._rewards.append(rewards.mean())
        super().process_env_step(obs, rewards, dones, extras)

    def compute_returns(self, obs: TensorDict) -> None:
        """As PPO, of centred rewards."""
        if self.centring is not None:
            self.centring.update(torch.stack(self._rewards).mean())
            self._rewards = []
            self.storage.rewards -= self.centring.mean
        super().compute_returns(obs)

    # ------------------------------------------------------------------------------------------------ learning

    def update(self) -> dict[str, float]:
        """The gradient steps of a batch, then one step of the multiplier. Returns what is logged."""
        sums: dict[str, float] = {"value": 0.0, "surrogate": 0.0, "entropy": 0.0}
        steps = 0
        for batch in self.storage.mini_batch_generator(self.num_mini_batches, self.num_learning_epochs):
            parts = self._step(batch)
            sums = {name: total + parts[name] for name, total in sums.items()}
            steps += 1
        if ONCE_A_BATCH:
            seen = self.storage.observations.flatten(0, 1)
            self.actor.update_normalization(seen)
            self.critic.update_normalization(seen)
        kl, widened = self.kl_to_anchor(self.storage.observations.flatten(0, 1))
        self.lagrange.update(kl)
        self.storage.clear()
        return {
            **{name: total / steps for name, total in sums.items()},
            "kl_to_anchor": kl,
            "multiplier": self.lagrange.value,
            "sigma_over_anchor": widened,
            **({} if self.centring is None else {"reward_centre": float(self.centring.mean)}),
        }

    def _step(self, batch: RolloutStorage.Batch) -> dict[str, float]:
        """One gradient step."""
        advantages = batch.advantages.squeeze(-1)
        if self.normalize_advantage_per_mini_batch:
            advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        self.actor(batch.observations, stochastic_output=True)
        log_probability = self.actor.get_output_log_prob(batch.actions)
        policy, entropy = self.actor.output_distribution_params, self.actor.output_entropy.mean()
        values = self.critic(batch.observations)
        if self.desired_kl is not None and self.schedule == "adaptive":
            with torch.no_grad():
                self._adapt_rate(self._mean(self.actor.get_kl_divergence(batch.old_distribution_params, policy)))

        ratio = torch.exp(log_probability - batch.old_actions_log_prob.squeeze(-1))
        clipped = ratio.clamp(1.0 - self.clip_param, 1.0 + self.clip_param)
        surrogate = -torch.minimum(ratio * advantages, clipped * advantages).mean()
        error = (values - batch.returns).square()
        if self.use_clipped_value_loss:
            near = batch.values + (values - batch.values).clamp(-self.clip_param, self.clip_param)
            error = torch.maximum(error, (near - batch.returns).square())
        kl = self.actor.get_kl_divergence(policy, self._anchor_in(batch.observations)).mean()
        loss = surrogate + self.value_loss_coef * error.mean() - self.entropy_coef * entropy + self.lagrange.value * kl
        if not bool(torch.isfinite(loss)):
            raise AnchorError(
                f"The loss is not finite: surrogate {surrogate.item():g}, value {error.mean().item():g}, KL to the "
                f"anchor {kl.item():g}. Look for rewards or observations that are not finite, or lower learning_rate, "
                "and go on from the last checkpoint."
            )

        self.optimizer.zero_grad()
        loss.backward()
        if self.is_multi_gpu:
            self.reduce_parameters()
        nn.utils.clip_grad_norm_(self.actor.parameters(), self.max_grad_norm)
        nn.utils.clip_grad_norm_(self.critic.parameters(), self.max_grad_norm)
        self.optimizer.step()
        return {"value": error.mean().item(), "surrogate": surrogate.item(), "entropy": entropy.item()}

    @torch.no_grad()
    def _anchor_in(self, observations: TensorDict) -> tuple[torch.Tensor, ...]:
        """Parameters of the anchor's distribution in these states."""
        self.anchor(observations, stochastic_output=True)
        return tuple(one.clone() for one in self.anchor.output_distribution_params)

    @torch.no_grad()
    def kl_to_anchor(self, observations: TensorDict) -> tuple[float, float]:
        """Mean KL(pi || anchor), nats, over states [S], and the mean of sigma_pi / sigma_anchor, over all processes."""
        count = observations.batch_size[0]
        divergence, widened = torch.zeros((), device=self.device), torch.zeros((), device=self.device)
        for part in observations.split(max(1, -(-count // self.num_mini_batches))):
            anchor = self._anchor_in(part)
            sigma = self.anchor.output_std.clone()
            self._raw_actor(part, stochastic_output=True)
            kl = self._raw_actor.get_kl_divergence(self._raw_actor.output_distribution_params, anchor)
            divergence += kl.sum() / count
            widened += (self._raw_actor.output_std / sigma).mean() * (len(kl) / count)
        return self._mean(divergence), self._mean(widened)

    def _mean(self, value: torch.Tensor) -> float:
        """Mean over samples, and over processes where there are several."""
        mean = value.mean()
        if self.is_multi_gpu:
            torch.distributed.all_reduce(mean, op=torch.distributed.ReduceOp.SUM)
            mean /= self.gpu_world_size
        return mean.item()

    def _adapt_rate(self, kl: float) -> None:
        """rsl_rl's rule: a step that moved the policy by more than twice desired_kl makes the next ones smaller.
        Every process has the same kl, so every process comes to the same rate."""
        if kl > 2.0 * self.desired_kl:
            self.learning_rate = max(1e-5, self.learning_rate / 1.5)
        elif 0.0 < kl < self.desired_kl / 2.0:
            self.learning_rate = min(1e-2, self.learning_rate * 1.5)
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate

    # ------------------------------------------------------------------------------------------- checkpoints

    def save(self) -> dict[str, Any]:
        """As PPO, and the state of the bound under `anchored`: numbers and texts alone."""
        state: dict[str, Any] = {"multiplier": self.lagrange.value, "anchor_sha256": self.anchor_sha256}
        if self.centring is not None:
            state |= {"centre": float(self.centring.mean), "centre_trace": float(self.centring.trace)}
        return {**super().save(), SAVED: state}

    def load(self, loaded_dict: dict[str, Any], load_cfg: dict | None, strict: bool) -> bool:
        """As PPO. Multiplier and centre go on where they were if the anchor is the same; for another anchor, or a
        checkpoint of PPO, they begin anew."""
        found = super().load(loaded_dict, load_cfg, strict)
        state = loaded_dict.get(SAVED)
        if state is not None and state["anchor_sha256"] == self.anchor_sha256:
            self.lagrange.value = float(state["multiplier"])
            if self.centring is not None and "centre" in state:
                self.centring.mean.fill_(state["centre"])
                self.centring.trace.fill_(state["centre_trace"])
        return found
