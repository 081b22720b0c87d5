"""Training of P candidates at once: one TorchRL Collector, one loss, one optimiser step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import EnvBase

from hts.config import PPOConfig
from hts.errors import SimulationError
from hts.rl.actor import Explorer, log_prob
from hts.rl.advantage import advantages
from hts.rl.batched_updates import BatchedSteps
from hts.rl.capture import Captured
from hts.rl.captured_collector import CapturedRollout
from hts.rl.centring import Centre
from hts.rl.kl import Multipliers, gaussian_kl
from hts.rl.population import Population
from hts.rl.population_collector import Rollout, can_roll_out
from hts.rl.precision import tf32
from hts.rl.random import PopulationRandom
from hts.rl.rows import row_mean, row_standardised
from hts.rl.threads import one_thread
from hts.rl.updates import GradientSteps, Samples, SeparateSteps

KL_STRIDE = 4  # on a GPU the multiplier's KL is the mean over every fourth state: some thousands a candidate are plenty


@dataclass
class BatchStats:
    """What one batch showed, each a list of length P, plus the environment steps so far (all candidates)."""

    steps: int
    values: dict[str, list[float]]


class _CapturedLearning(NamedTuple):
    """What learning launches as graphs: reward [P, N, T], where `samples` reads it; and the KL after the update [P]."""

    reward: torch.Tensor
    samples: Captured[tuple[Samples, Samples]]
    kl: Captured[torch.Tensor]


def make_collector(env: EnvBase, actor: Explorer, frames_per_batch: int, device: torch.device) -> Collector:
    """TorchRL's collector of batches [P, N, T]."""
    return Collector(
        env, actor, frames_per_batch=frames_per_batch, total_frames=-1, device=device, track_traj_ids=False,
        trust_policy=True, use_buffers=False, track_policy_version=False,
        return_same_td=device.type == "cpu",  # each batch is a fresh one, so there is nothing to copy it for
        auto_register_policy_transforms=False,  # nothing here is recurrent: the memory is the transform's own
    )  # fmt: skip


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
        capture = config.capture and device.type == "cuda"
        self.steps: GradientSteps = (
            SeparateSteps(population, config, self._stop_in_batch)
            if device.type == "cpu"
            else BatchedSteps(population, config, self._stop_in_batch, capture)
        )
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
        self.rollout: Rollout | None = None
        self._captured: _CapturedLearning | None = None
        self.collector: Collector | None = None
        if not can_roll_out(env):
            self.collector = make_collector(env, self.actor, per_batch, device)
            self._stream = iter(self.collector)
        elif device.type == "cpu":
            self.rollout = Rollout(env, population, self.noise, config.horizon)
        else:
            self.rollout = CapturedRollout(
                env, population, self.noise, config.horizon, capture=capture, tf32=config.tf32,
                aside=capture and not update_normaliser, anchor=anchor, fuse=config.fuse,
            )  # fmt: skip
        if resume is not None and list(resume.get("transform", {}).keys()):  # now: making the collector resets the env
            self.env.transform.load_state_dict(dict(resume["transform"].items()))
        self.steps_per_batch = per_batch

    # --------------------------------------------------------------------------------------------------- a batch

    def collect(self) -> TensorDictBase:
        """One batch [P, N, T] from the env."""
        with one_thread():
            return next(self._stream) if self.rollout is None else self.rollout.collect()

    def batch(self) -> BatchStats:
        """Collect, then learn from it."""
        return self.learn(self.collect())

    def learn(self, data: TensorDictBase) -> BatchStats:
        """Update every candidate from a batch [P, N, T]."""
        with one_thread(), tf32(self.config.tf32):
            return self._learn(data)

    def _learn(self, data: TensorDictBase) -> BatchStats:
        with torch.no_grad():
            rewards, stats = self._rewards(data)
            if self.update_normaliser:
                self.population.update_normaliser("critic_observation", data["critic_observation"].flatten(1, 2))
            samples, constant = self._prepared(data, rewards)
        losses = self._epochs(samples, constant)
        with torch.no_grad():
            if self.update_normaliser:
                # The observation normaliser moves only between batches: the samples' log-probabilities were made with it.
                self.population.update_normaliser("observation", data["observation"].flatten(1, 2))
            self.population.refresh()
            if self.anchor is not None:
                self.kl = (
                    self._measure_kl(data, samples["anchor_mean"])
                    if self._captured is None
                    else self._captured.kl().clone()
                )
                if self.batches >= self.config.warmup_batches:
                    self.multipliers.update(self.kl)
        self.batches += 1
        falls = data["next", "terminated"].flatten(1).sum(1)
        std = self.population.log_std().exp().mean((1, 2))
        stats |= {**losses, "kl": self.kl, "multiplier": self.multipliers.value, "falls": falls, "std": std}
        values = {name: value.tolist() for name, value in stats.items()}
        values["learning_rate"] = self.steps.rates
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
        self.steps.halt(index)
        if len(self.stopped) == self.population.count:
            raise SimulationError("Training stopped, no candidate is left: " + "; ".join(self.stopped.values()))
        if self.anchor is not None:
            with torch.no_grad():
                self.population.vectors[index].copy_(self.anchor.vectors[index])

    def _stop_in_batch(self, index: int, reason: str) -> None:
        self._stop(index, f"{reason} in batch {self.batches}")

    def _prepare(self, data: TensorDictBase, reward: torch.Tensor) -> tuple[Samples, Samples]:
        """Flatten [P, N, T] to [P, S] samples with everything the loss needs, observations as the networks see them;
        and what is one per candidate, [P, 1, J]."""
        population = self.population
        observation, critic_observation = (data[name].flatten(1, 2) for name in ("observation", "critic_observation"))
        known = data.keys()
        value = data["value"].flatten(1, 2) if "value" in known else population.value(critic_observation)
        last = population.value(data["next", "critic_observation"][..., -1, :])
        shape = reward.shape
        terminated, truncated = (data["next", key].squeeze(-1) for key in ("terminated", "truncated"))
        advantage, target = advantages(
            reward, value.view(shape), last, terminated, truncated, self.config.gamma, self.config.gae_lambda
        )
        action, mean = data["action"].flatten(1, 2), data["action_mean"].flatten(1, 2)
        constant = {"old_log_std": population.log_std().clone()}
        samples = {
            "observation": population.normalised("observation", observation),
            "critic_observation": population.normalised("critic_observation", critic_observation),
            "action": action, "old_mean": mean, "log_prob": log_prob(action, mean, constant["old_log_std"]),
            "advantage": row_standardised(advantage.flatten(1)), "target": target.flatten(1), "old_value": value,
        }  # fmt: skip
        if self.anchor is not None:
            there = "anchor_mean" in known
            samples["anchor_mean"] = data["anchor_mean"].flatten(1, 2) if there else self.anchor.mean(observation)
            constant["anchor_log_std"] = self.anchor.log_std()
        return samples, constant

    def _prepared(self, data: TensorDictBase, reward: torch.Tensor) -> tuple[Samples, Samples]:
        """`_prepare`, as a captured graph where a rollout leaves its batches in the same memory each time."""
        if self.rollout is None or not self.rollout.captured:
            return self._prepare(data, reward)
        if self._captured is None:
            kept = reward.clone()
            samples = Captured(lambda: self._prepare(data, kept), reward.device)
            kl = Captured(lambda: self._measure_kl(data, samples.result[0]["anchor_mean"]), reward.device)
            self._captured = _CapturedLearning(kept, samples, kl)
        self._captured.reward.copy_(reward)
        return self._captured.samples()

    def _epochs(self, samples: Samples, constant: Samples) -> dict[str, torch.Tensor]:
        """All gradient steps of all candidates on this batch; mean losses, each [P]."""
        orders = [self.order.permutation(samples["advantage"].shape[1]) for _ in range(self.config.epochs)]
        policy_on = 0.0 if self.batches < self.config.warmup_batches else 1.0
        losses = self.steps.run(samples, constant, self.multipliers.value, orders, policy_on)
        return {f"loss/{name}": value for name, value in losses.items()}

    def _measure_kl(self, data: TensorDictBase, anchor_mean: torch.Tensor) -> torch.Tensor:
        """Mean KL(pi || anchor) [P] over the batch's states, with the parameters as they are now. On a GPU, whose batches
        are large, over every fourth of them."""
        assert self.anchor is not None
        observation = data["observation"].flatten(1, 2)
        some = slice(None, None, 1 if observation.device.type == "cpu" else KL_STRIDE)
        mean = self.population.mean(observation[:, some])
        return row_mean(gaussian_kl(mean, self.population.log_std(), anchor_mean[:, some], self.anchor.log_std()))

    # -------------------------------------------------------------------------------------------- saving, loading

    def full_state(self) -> TensorDict:
        """Everything to go on exactly from here: parameters, optimiser, env, random numbers, multipliers, centres."""
        vectors = {str(index): vector.detach().clone() for index, vector in enumerate(self.population.vectors)}
        rates = torch.tensor(self.steps.rates, dtype=torch.float64)
        parts = {
            "vectors": vectors, "optimiser": self.steps.state(), "rates": rates, "noise": self.noise.state_dict(), "order": self.order.state_dict(),
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

    def _load(self, state: TensorDictBase) -> None:
        with torch.no_grad():
            for index, vector in enumerate(self.population.vectors):
                vector.copy_(state["vectors", str(index)])
            for name, buffer in self.population.named_buffers():
                buffer.copy_(state["normaliser", name])
        saved = state["optimiser"]
        self.steps.load_state({name: dict(saved[name].items()) for name in saved.keys()})  # noqa: SIM118
        self.steps.rates = state["rates"].tolist()
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
        for index in self.stopped:
            self.steps.halt(index)
        self.env.load_full_state(state["env"])
        self.population.refresh()

    def close(self) -> None:
        """Shut the collector (and its env) down."""
        if self.collector is not None:
            self.collector.shutdown()
        else:
            self.env.close()
        self.steps.close()
