"""Training of P candidates at once: one TorchRL Collector, one loss, one optimiser step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import EnvBase

from hts.config import PPOConfig
from hts.envs.random import PopulationRandom
from hts.errors import SimulationError
from hts.policies.networks import Population
from hts.ppo.actor import Explorer, log_prob
from hts.ppo.advantage import advantages
from hts.ppo.anchor import Multipliers, gaussian_kl
from hts.ppo.centring import Centre
from hts.ppo.loss import anchored_ppo_loss
from hts.ppo.rows import row_mean, row_standardised
from hts.ppo.threads import one_thread, pool


@dataclass
class BatchStats:
    """What one batch showed, each a list of length P, plus the environment steps so far (all candidates)."""

    steps: int
    values: dict[str, list[float]]


class PopulationTrainer:
    """PPO for a population, with an optional anchor.

    population: P candidates, changed in place; anchor: frozen Population of P, or None (pretraining);
    bounds [P]: c per candidate, nats; weights: objective -> lambda [P]; seeds: one per candidate;
    names: what candidates are called in errors.

    On the CPU each candidate takes its gradient steps alone, as many side by side as there are cores; on a GPU all
    of them take each step together.

    A candidate whose numbers stop being finite is stopped, named in `stopped`, and put back to its anchor; the
    others go on. If none is left, SimulationError.
    """

    def __init__(
        self, env: EnvBase, population: Population, config: PPOConfig, *, seeds: Sequence[int], names: Sequence[str],
        anchor: Population | None = None, bounds: torch.Tensor | None = None,
        weights: Mapping[str, torch.Tensor] | None = None, update_normaliser: bool = False, resume: TensorDictBase | None = None,
    ):  # fmt: skip
        self.env, self.population, self.config, self.anchor = env, population, config, anchor
        self.names, self.update_normaliser = list(names), update_normaliser
        count, device = population.count, population.device
        self.dt = env.dt
        self.noise = PopulationRandom([seed + 101 for seed in seeds], device)
        self.order = PopulationRandom([seed + 202 for seed in seeds], device)
        alone = device.type == "cpu"
        self.parts = [slice(i, i + 1) for i in range(count)] if alone else [slice(0, count)]
        self.optimisers = [self._make_optimiser(part) for part in self.parts]
        self._pool = pool(len(self.parts))
        bounds = bounds if bounds is not None else torch.full((count,), torch.inf)
        self.multipliers = Multipliers(bounds.to(device), config.multiplier_rate)
        self.weights = {name: value.to(device) for name, value in (weights or {}).items()}
        self.centres = {name: Centre(count, config.centring_rate, device) for name in self.weights}
        self.stopped: dict[int, str] = {}
        self.batches = 0
        self.kl = torch.zeros(count, device=device)
        population.refresh()
        if resume is not None:
            self._load(resume)
        per_batch = count * env.batch_size[1] * config.horizon
        self.actor = Explorer(population, self.noise)
        self.collector = Collector(
            env, self.actor, frames_per_batch=per_batch, total_frames=-1, device=device, track_traj_ids=False,
            trust_policy=True, use_buffers=False, track_policy_version=False,
            return_same_td=device.type == "cpu",  # each batch is a fresh one, so there is nothing to copy it for
            auto_register_policy_transforms=False,  # nothing here is recurrent: the memory is the transform's own
        )  # fmt: skip
        if resume is not None and list(resume.get("transform", {}).keys()):  # now: making the collector resets the env
            self.env.transform.load_state_dict(dict(resume["transform"].items()))
        self._stream = iter(self.collector)
        self.steps_per_batch = per_batch

    def _make_optimiser(self, part: slice) -> torch.optim.Optimizer:
        """Adam for the candidates of a part, a group each, so that learning rates are their own."""
        groups = [
            {"params": [vector], "lr": self.config.learning_rate} for vector in list(self.population.vectors)[part]
        ]
        return torch.optim.Adam(groups, eps=1e-8, fused=True)

    @property
    def param_groups(self) -> list[dict[str, Any]]:
        """The optimisers' groups, one per candidate."""
        return [group for optimiser in self.optimisers for group in optimiser.param_groups]

    # --------------------------------------------------------------------------------------------------- a batch

    def collect(self) -> TensorDictBase:
        """One batch [P, N, T] from the env."""
        with one_thread():
            return next(self._stream)

    def batch(self) -> BatchStats:
        """Collect, then learn from it."""
        return self.learn(self.collect())

    def learn(self, data: TensorDictBase) -> BatchStats:
        """Update every candidate from a batch [P, N, T]."""
        with one_thread():
            return self._learn(data)

    def _learn(self, data: TensorDictBase) -> BatchStats:
        with torch.no_grad():
            rewards, stats = self._rewards(data)
            samples = self._prepare(data, rewards)
        losses = self._epochs(samples)
        with torch.no_grad():
            self.population.refresh()
            if self.anchor is not None:
                self.kl = self._measure_kl(samples)
                if self.batches >= self.config.warmup_batches:
                    self.multipliers.update(self.kl)
        self.batches += 1
        falls = data["next", "terminated"].flatten(1).sum(1)
        std = self.population.log_std().exp().mean((1, 2))
        stats |= {**losses, "kl": self.kl, "multiplier": self.multipliers.value, "falls": falls, "std": std}
        values = {name: value.tolist() for name, value in stats.items()}
        values["learning_rate"] = [group["lr"] for group in self.param_groups]
        return BatchStats(self.batches * self.steps_per_batch, values)

    def _rewards(self, data: TensorDictBase) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """r = r_sim + sum_j lambda_j dt (r_real_j - centre_j), [P, N, T]; centred first, never clipped.

        lambda's unit: task reward per second, for one standard deviation of the measured channel (the model's
        prediction is z-scored by its data), so that r_sim's weights, also rates per second, are on the same scale.
        """
        simulated = data["next", "reward"].squeeze(-1)
        self._stop_if_bad({"r_sim": simulated})
        stats = {"r_sim": row_mean(simulated) / self.dt}
        total = simulated
        for name, weight in self.weights.items():
            real = data["next", "real_reward", name].squeeze(-1)
            self._stop_if_bad({f"r_real of {name}": real})
            centre = self.centres[name]
            centre.update(real)
            total = total + (weight * self.dt).view(-1, 1, 1) * (real - centre.mean.view(-1, 1, 1))
            stats[f"r_real/{name}"] = row_mean(real)
        return total, stats

    def _stop_if_bad(self, parts: Mapping[str, torch.Tensor]) -> None:
        """Stop candidates with a non-finite value; parts: name -> [P, N, T]."""
        for what, value in parts.items():
            bad = ~torch.isfinite(value)
            if not bool(bad.any()):
                continue
            for index in bad.flatten(1).any(1).nonzero().flatten().tolist():
                first = int(bad[index].any(0).nonzero()[0])
                step = self.batches * self.config.horizon + first
                self._stop(
                    index,
                    f"{what} is not finite at control step {step} (batch {self.batches}) in {int(bad[index, :, first].sum())} of its worlds",
                )

    def _stop(self, index: int, reason: str) -> None:
        if index in self.stopped:
            return
        self.stopped[index] = f"candidate {self.names[index]}: {reason}"
        if len(self.stopped) == self.population.count:
            raise SimulationError("Training stopped, no candidate is left: " + "; ".join(self.stopped.values()))
        if self.anchor is not None:
            with torch.no_grad():
                self.population.vectors[index].copy_(self.anchor.vectors[index])

    def _prepare(self, data: TensorDictBase, reward: torch.Tensor) -> dict[str, torch.Tensor]:
        """Flatten [P, N, T] to [P, S] samples with everything the loss needs."""
        population = self.population
        observation = data["observation"].flatten(1, 2)
        critic_observation = data["critic_observation"].flatten(1, 2)
        if self.update_normaliser:
            population.update_normaliser("critic_observation", critic_observation)
        value = population.value(critic_observation)
        last = population.value(data["next", "critic_observation"][..., -1, :])
        shape = reward.shape
        terminated, truncated = (data["next", key].squeeze(-1) for key in ("terminated", "truncated"))
        advantage, target = advantages(
            reward, value.view(shape), last, terminated, truncated, self.config.gamma, self.config.gae_lambda
        )
        advantage = row_standardised(advantage.flatten(1))
        action, mean = data["action"].flatten(1, 2), data["action_mean"].flatten(1, 2)
        log_std = population.log_std().clone()
        samples = {
            "observation": observation, "critic_observation": critic_observation, "action": action, "old_mean": mean,
            "log_prob": log_prob(action, mean, log_std), "advantage": advantage, "target": target.flatten(1), "old_value": value,
        }  # fmt: skip
        self._old_log_std = log_std
        if self.anchor is not None:
            samples["anchor_mean"] = self.anchor.mean(observation)
        return samples

    def _epochs(self, samples: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """All gradient steps of all candidates on this batch; mean losses, each [P]."""
        size = samples["advantage"].shape[1]
        orders = [self.order.permutation(size) for _ in range(self.config.epochs)]
        used = dict(samples)
        for name in ("observation", "critic_observation"):
            used[name] = self.population.normalised(name, samples[name])
        constant = {"old_log_std": self._old_log_std}
        if self.anchor is not None:
            constant["anchor_log_std"] = self.anchor.log_std()

        def train(index: int) -> dict[str, torch.Tensor]:
            return self._train(index, used, constant, orders)

        each = range(len(self.parts))
        rows = list(map(train, each) if len(self.parts) == 1 else self._pool.map(train, each))
        if self.update_normaliser:
            # The observation normaliser moves only between batches: the samples' log-probabilities were made with it.
            self.population.update_normaliser("observation", samples["observation"])
        return {f"loss/{name}": torch.cat([row[name] for row in rows]) for name in rows[0]}

    def _train(
        self, index: int, samples: Mapping[str, torch.Tensor], constant: Mapping[str, torch.Tensor], orders: Sequence[torch.Tensor]
    ) -> dict[str, torch.Tensor]:  # fmt: skip
        """The gradient steps of one part of the population, which shares nothing with the other parts."""
        config, part = self.config, self.parts[index]
        constant = {name: value[part] for name, value in constant.items()}
        multipliers = self.multipliers.value[part]
        policy_on = 0.0 if self.batches < config.warmup_batches else 1.0
        sums: dict[str, torch.Tensor] = {}
        updates = 0
        for order in orders:
            for rows in order[part].chunk(config.minibatches, dim=1):
                batch = {name: _take(value[part], rows) for name, value in samples.items()} | constant
                loss = anchored_ppo_loss(
                    self.population, batch, multipliers, clip=config.clip, value_coef=config.value_coef,
                    entropy_coef=config.entropy_coef, policy_on=policy_on, members=part, normalised=True,
                )  # fmt: skip
                self._step(index, loss.total)
                if config.adaptive_rate:
                    self._adapt(index, loss.kl_old)
                updates += 1
                for name in ("policy", "value", "kl_old"):
                    sums[name] = sums.get(name, 0.0) + getattr(loss, name)
        return {name: value / updates for name, value in sums.items()}

    def _step(self, index: int, loss: torch.Tensor) -> None:
        """One Adam step of every candidate of a part that is still running, its gradient clipped by its own norm. loss [part]."""
        part, optimiser = self.parts[index], self.optimisers[index]
        optimiser.zero_grad(set_to_none=True)
        loss.sum().backward()
        vectors = list(self.population.vectors)[part]
        norms = torch.stack(torch._foreach_norm([vector.grad for vector in vectors]))
        scale = (self.config.max_grad_norm / (norms + 1e-6)).clamp(max=1.0)
        torch._foreach_mul_([vector.grad for vector in vectors], list(scale.unbind()))
        if not bool(torch.isfinite(norms).all()):
            for row in (~torch.isfinite(norms)).nonzero().flatten().tolist():
                self._stop(part.start + row, f"the gradient is not finite in batch {self.batches}")
        for row, vector in enumerate(vectors):
            if part.start + row in self.stopped:
                vector.grad = None
        optimiser.step()

    def _adapt(self, index: int, kl_old: torch.Tensor) -> None:
        """Rate / 1.5 above twice the desired KL, x 1.5 below half of it, per candidate (rsl_rl)."""
        desired = self.config.desired_kl
        for group, kl in zip(self.optimisers[index].param_groups, kl_old.tolist(), strict=True):
            if kl > 2 * desired:
                group["lr"] = max(1e-5, group["lr"] / 1.5)
            elif 0 < kl < desired / 2:
                group["lr"] = min(1e-2, group["lr"] * 1.5)

    def _measure_kl(self, samples: dict[str, torch.Tensor]) -> torch.Tensor:
        """Mean KL(pi || anchor) [P] over the batch's states, with the parameters as they are now."""
        assert self.anchor is not None
        mean = self.population.mean(samples["observation"])
        return row_mean(gaussian_kl(mean, self.population.log_std(), samples["anchor_mean"], self.anchor.log_std()))

    # -------------------------------------------------------------------------------------------- saving, loading

    def full_state(self) -> TensorDict:
        """Everything to go on exactly from here: parameters, optimiser, env, random numbers, multipliers, centres."""
        vectors = {str(index): vector.detach().clone() for index, vector in enumerate(self.population.vectors)}
        optimiser = {}
        for index, vector in enumerate(self.population.vectors):
            state = self._optimiser_of(index).state.get(vector)
            if state:
                optimiser[str(index)] = {name: state[name].clone() for name in ("step", "exp_avg", "exp_avg_sq")}
        rates = torch.tensor([group["lr"] for group in self.param_groups], dtype=torch.float64)
        parts = {
            "vectors": vectors, "optimiser": optimiser, "rates": rates, "noise": self.noise.state_dict(), "order": self.order.state_dict(),
            "normaliser": {name: value.clone() for name, value in self.population.named_buffers()}, "multipliers": self.multipliers.state_dict(),
            "centres": {name: centre.state_dict() for name, centre in self.centres.items()}, "kl": self.kl.clone(),
            "batches": torch.tensor(self.batches), "stopped": torch.tensor(sorted(self.stopped), dtype=torch.int64),
            "env": self.env.full_state(), "transform": self._transform_state(),
        }  # fmt: skip
        return TensorDict(parts, batch_size=[])

    def _transform_state(self) -> dict[str, torch.Tensor]:
        """The memory of measurement models inside the env, world by world."""
        transform = getattr(self.env, "transform", None)
        return {name: value.clone() for name, value in transform.state_dict().items()} if transform is not None else {}

    def _optimiser_of(self, index: int) -> torch.optim.Optimizer:
        return self.optimisers[min(index, len(self.optimisers) - 1)]

    def _load(self, state: TensorDictBase) -> None:
        with torch.no_grad():
            for index, vector in enumerate(self.population.vectors):
                vector.copy_(state["vectors", str(index)])
                if str(index) in state["optimiser"].keys():  # noqa: SIM118 - a TensorDict
                    saved = state["optimiser", str(index)]
                    self._optimiser_of(index).state[vector] = {
                        name: saved[name].to(vector.device if name != "step" else saved[name].device).clone()
                        for name in ("step", "exp_avg", "exp_avg_sq")
                    }
            for name, buffer in self.population.named_buffers():
                buffer.copy_(state["normaliser", name])
        for group, rate in zip(self.param_groups, state["rates"].tolist(), strict=True):
            group["lr"] = rate
        self.noise.load_state_dict(state["noise"])
        self.order.load_state_dict(state["order"])
        self.multipliers.load_state_dict(state["multipliers"])
        for name, centre in self.centres.items():
            centre.load_state_dict(state["centres", name])
        self.kl = state["kl"].to(self.kl.device)
        self.batches = int(state["batches"])
        self.stopped = {
            index: f"candidate {self.names[index]}: stopped before the checkpoint"
            for index in state["stopped"].tolist()
        }
        self.env.load_full_state(state["env"])
        self.population.refresh()

    def close(self) -> None:
        """Shut the collector (and its env) down."""
        self.collector.shutdown()
        self._pool.shutdown()


def _take(value: torch.Tensor, rows: torch.Tensor) -> torch.Tensor:
    """value [P, S, ...], rows [P, B] -> [P, B, ...]."""
    if len(value) == 1:
        return value[0].index_select(0, rows[0]).unsqueeze(0)
    return value[torch.arange(len(value), device=value.device).unsqueeze(1), rows]
