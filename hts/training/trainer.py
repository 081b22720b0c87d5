"""Training of P candidates at once: a collector, one loss, one optimiser step."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

from hts.config import PPOConfig
from hts.errors import SimulationError
from hts.rl.actor import PopulationActor
from hts.rl.backend import backend_for
from hts.rl.captured_collector import CapturedCollector
from hts.rl.centring import RewardCentring
from hts.rl.deferred import DeferrableTransform, base_and_transforms, source_of
from hts.rl.measured_reward import MeasuredReward
from hts.rl.multiplier import EqualityMultiplier, LagrangeMultiplier, UpperMultiplier
from hts.rl.population import Population
from hts.rl.precision import tf32
from hts.rl.random import EXPLORATION_SEED, PopulationRandom
from hts.rl.rows import row_mean, row_std
from hts.rl.samples import Samples, kl_of_batch, samples_of
from hts.rl.settings import UpdateSettings
from hts.rl.task_env import TaskEnv
from hts.rl.threads import one_thread

STRENGTH = "held/strength"  # of a batch's statistics: how strong the rewards are that pull at what is held, per second
SETTLING_SECONDS = 2.0  # s: so long instances that began together find their feet, and rewards spread twice as far


@dataclass
class BatchStats:
    """What one batch showed, each a list of length P, plus the environment steps so far (all candidates)."""

    steps: int
    values: dict[str, list[float]]


@dataclass(frozen=True)
class _Learning:
    """What learning does again and again with batches that lie in the same memory: the reward [P, N, T] where `samples`
    reads it; samples of a batch; and the KL after the update [P]."""

    reward: torch.Tensor
    samples: Callable[[], tuple[Samples, Samples]]
    kl: Callable[[], torch.Tensor]


def update_settings(config: PPOConfig) -> UpdateSettings:
    """As much of the configuration as gradient steps want."""
    return UpdateSettings(**config.model_dump(include={*UpdateSettings.__dataclass_fields__}))


class PopulationTrainer:
    """PPO for a population, with an optional anchor.

    population: P candidates, changed in place; anchor: frozen Population of P, or None (pretraining);
    bounds [P]: c per candidate, nats; weights: objective -> lambda [P]; held: name of an error under ("next", "held")
    whose mean is held at zero -> an error that matters; held_below: likewise, of a mean that is kept at or below a
    number -> that number; prices: name of either -> [P], where its multiplier begins, per `strength` (see
    `EqualityMultiplier`) once instances have found their feet, else 0; seeds: one per candidate; names: what candidates
    are called in errors.

    Collection and gradient steps are those of the device's `hts.rl.backend`. A candidate whose numbers stop being
    finite is stopped, named in `stopped`, and put back to its anchor; the others go on. If none is left,
    SimulationError.
    """

    def __init__(
        self,
        env: EnvBase,
        population: Population,
        config: PPOConfig,
        *,
        seeds: Sequence[int],
        names: Sequence[str],
        anchor: Population | None = None,
        bounds: torch.Tensor | None = None,
        weights: Mapping[str, torch.Tensor] | None = None,
        held: Mapping[str, float] | None = None,
        held_below: Mapping[str, float] | None = None,
        prices: Mapping[str, torch.Tensor] | None = None,
        update_normaliser: bool = False,
        resume: TensorDictBase | None = None,
    ) -> None:
        self.env, self.population, self.config, self.anchor = env, population, config, anchor
        self.names, self.update_normaliser = list(names), update_normaliser
        count, device = population.count, population.device
        self.dt = env.dt
        self.noise = PopulationRandom([seed + EXPLORATION_SEED for seed in seeds], device)
        self.order = PopulationRandom([seed + 202 for seed in seeds], device)
        self.backend = backend_for(device, capture=config.capture, tf32=config.tf32, fuse=config.fuse)
        self.steps = self.backend.gradient_steps(population, update_settings(config), self._stop_in_batch)
        bounds = bounds if bounds is not None else torch.full((count,), torch.inf)
        self.multipliers = LagrangeMultiplier(bounds.to(device), config.multiplier_rate)
        # A batch is rewarded as a whole: the centre moves once, with all of it.
        self.measured = {
            name: MeasuredReward(
                weight.to(device),
                self.dt,
                in_key=("real_reward", name),
                centring=RewardCentring(config.centring_rate, count, device),
            )
            for name, weight in (weights or {}).items()
        }
        pace = {
            "rate": config.hold_rate,
            "gain": config.hold_gain,
            "smoothing": config.hold_smoothing,
            "device": device,
        }
        self.held: dict[str, EqualityMultiplier] = {
            **{name: EqualityMultiplier(scale, count, **pace) for name, scale in (held or {}).items()},
            **{name: UpperMultiplier(limit, count, **pace) for name, limit in (held_below or {}).items()},
        }
        self.prices = {name: price.to(device) for name, price in (prices or {}).items()}
        self.settling = math.floor(SETTLING_SECONDS / (config.horizon * self.dt) + 1e-6) + 1  # batches
        self.stopped: dict[int, str] = {}
        self.batches = 0
        self.kl = torch.zeros(count, device=device)
        population.refresh()
        if resume is not None:
            self._load(resume)
        self.steps_per_batch = count * env.batch_size[1] * config.horizon
        self.actor = PopulationActor(population, self.noise)
        self.collector = self.backend.collector(
            env, self.actor, self.steps_per_batch, anchor, fixed_normaliser=not update_normaliser
        )
        self._batches = iter(self.collector)
        self._learning: _Learning | None = None
        if resume is not None:  # now: making a collector may reset the env
            before = resume.get("transform", None)  # as versions before 0.2 wrote it
            if before is not None and list(before.keys()):
                env.transform.load_state_dict(dict(before.items()))
            for index, transform in enumerate(base_and_transforms(env)[1]):
                memory = resume.get(("transforms", str(index)), None)
                if memory is not None:
                    transform.load_state_dict(dict(memory.items()))

    # --------------------------------------------------------------------------------------------------- a batch

    def collect(self) -> TensorDictBase:
        """One batch [P, N, T] from the env."""
        with one_thread():
            return next(self._batches)

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
                # The observation normaliser moves only between batches: the log-probabilities were made with it.
                self.population.update_normaliser("observation", data["observation"].flatten(1, 2))
            self.population.refresh()
            if self.anchor is not None:
                learning = self._learning
                self.kl = self._measure_kl(data, samples) if learning is None else learning.kl().clone()
                if self.batches >= self.config.warmup_batches:
                    self.multipliers.step(self.kl)  # a NaN stops its own candidate, by its next gradient
        self.batches += 1
        falls = data["next", "terminated"].flatten(1).sum(1)
        std = self.population.log_std().exp().mean((1, 2))
        stats |= {**losses, "kl": self.kl, "multiplier": self.multipliers.value, "falls": falls, "std": std}
        values = {name: value.tolist() for name, value in stats.items()}
        values["learning_rate"] = self.steps.rates
        return BatchStats(self.batches * self.steps_per_batch, values)

    def _rewards(self, data: TensorDictBase) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """r = r_sim + sum_j lambda_j dt (r_real_j - centre_j), [P, N, T]; see `hts.rl.MeasuredReward`.

        lambda's unit: task reward per second, for one standard deviation of the measured channel (the model's
        prediction is z-scored by its data), so that r_sim's weights, also rates per second, are on the same scale.
        The first batch also says how far both spread over its steps and worlds, per second: see `hts.run.task_watch`.
        """
        simulated = data["next", "reward"].squeeze(-1)
        self._stop_if_bad({"r_sim": simulated})
        stats = {"r_sim": row_mean(simulated) / self.dt}
        first = self.batches == 0 and bool(self.measured)  # here everybody still acts as its anchor
        if first:
            stats["spread/task"] = row_std(simulated) / self.dt
        total = simulated
        strength = torch.ones_like(self.kl)
        for name, measured in self.measured.items():
            real = data["next", "real_reward", name].squeeze(-1)
            self._refuse_all_bad(name, real, data["next"])
            self._stop_if_bad({f"r_real of {name}": real})
            measured.centring.update(real)
            total = total + measured.added(real)
            stats[f"r_real/{name}"] = row_mean(real)
            if first:
                stats[f"spread/{name}"] = row_std(real)
            spread = row_mean((real - row_mean(real).view(-1, 1, 1)).square()).sqrt()
            strength = strength + measured.weight * spread
        if self.held:
            stats[STRENGTH] = strength
        for name, multiplier in self.held.items():
            if self.batches < self.settling and name in self.prices:
                price = self.prices[name]  # 0: its anchor knows none, so it finds its own from the first batch on
                multiplier.begin(torch.where(price == 0, multiplier.integral, price * strength))
            error = data["next", "held", name].squeeze(-1)
            self._stop_if_bad({name: error})
            counted = (error != 0).flatten(1).sum(1).clamp(min=1)
            mean = row_mean(error) * error[0].numel() / counted
            stats |= {f"held/{name}": mean, f"held/{name}_multiplier": multiplier.update(mean, strength)}
            total = total + self.dt * multiplier(error)
        return total, stats

    def _refuse_all_bad(self, name: str, real: torch.Tensor, outcome: TensorDictBase) -> None:
        """Raise SimulationError for an r_real that is no number for anybody before anybody has learned: it is not the
        training's doing, so smaller steps or λ would not help."""
        if self.batches > 0:
            return
        bad = ~torch.isfinite(real)
        if bool(bad.flatten(1).any(1).all()):
            step = int(bad.flatten(0, 1).any(0).nonzero()[0])
            source = source_of(self.env, ("real_reward", name), outcome) or f"{type(self.env).__name__}, which wrote it"
            raise SimulationError(
                f"Training stopped: r_real of {name} is not finite at control step {step}, in all candidates, before "
                f"any has learned. Look at {source}."
            )

    def _stop_if_bad(self, parts: Mapping[str, torch.Tensor]) -> None:
        """Stop candidates with a non-finite value; parts: name -> [P, N, T]."""
        for what, value in parts.items():
            bad = ~torch.isfinite(value)
            if not bool(bad.any()):
                continue
            for index in bad.flatten(1).any(1).nonzero().flatten().tolist():
                first = int(bad[index].any(0).nonzero()[0])
                step = self.batches * self.config.horizon + first
                self.stop(
                    index,
                    f"{what} is not finite at control step {step} (batch {self.batches}) in "
                    f"{int(bad[index, :, first].sum())} of its worlds",
                )

    def stop(self, index: int, reason: str) -> None:
        """Stop a candidate, unless it is: it goes back to its anchor and learns nothing more; `reason` says why.
        Raises SimulationError if it was the last one."""
        if index in self.stopped:
            return
        self.stopped[index] = f"candidate {self.names[index]}: {reason}"
        self.steps.halt(index)
        if len(self.stopped) == self.population.count:
            raise SimulationError(
                f"Training stopped, no candidate is left: {'; '.join(self.stopped.values())}. To resume it would end "
                "there again: begin another with a smaller ppo.learning_rate or, where λ are large, smaller λ."
            )
        if self.anchor is not None:
            with torch.no_grad():
                self.population.vectors[index].copy_(self.anchor.vectors[index])

    def _stop_in_batch(self, index: int, reason: str) -> None:
        self.stop(index, f"{reason} in batch {self.batches}")

    def _samples(self, data: TensorDictBase, reward: torch.Tensor) -> tuple[Samples, Samples]:
        """See `samples_of`."""
        return samples_of(
            data,
            reward,
            self.population,
            self.anchor,
            gamma=self.config.gamma,
            lam=self.config.gae_lambda,
            next_values=self.backend.next_values,
        )

    def _prepared(self, data: TensorDictBase, reward: torch.Tensor) -> tuple[Samples, Samples]:
        """`_samples`, launched as one where the collector leaves its batches in the same memory each time."""
        if not (isinstance(self.collector, CapturedCollector) and self.collector.captured):
            return self._samples(data, reward)
        if self._learning is None:
            fixed, found = reward.clone(), {}

            def prepare() -> tuple[Samples, Samples]:
                found["samples"], constant = self._samples(data, fixed)
                return found["samples"], constant

            samples = self.backend.repeated(prepare)
            kl = self.backend.repeated(lambda: self._measure_kl(data, found["samples"]))
            self._learning = _Learning(fixed, samples, kl)
        self._learning.reward.copy_(reward)
        return self._learning.samples()

    def _epochs(self, samples: Samples, constant: Samples) -> dict[str, torch.Tensor]:
        """All gradient steps of all candidates on this batch; mean losses, each [P]."""
        size = samples["advantage"].shape[1]
        orders = [self.backend.permutation(self.order, size) for _ in range(self.config.epochs)]
        policy_on = 0.0 if self.batches < self.config.warmup_batches else 1.0
        losses = self.steps.run(samples, constant, self.multipliers.value, orders, policy_on)
        return {f"loss/{name}": value for name, value in losses.items()}

    def _measure_kl(self, data: TensorDictBase, samples: Samples) -> torch.Tensor:
        """Mean KL(pi || anchor) [P] over the batch's states, with the parameters as they are now."""
        assert self.anchor is not None
        return kl_of_batch(data, self.population, self.anchor, samples["reference_mean"], self.backend.kl_stride)

    # -------------------------------------------------------------------------------------------- saving, loading

    def full_state(self) -> TensorDict:
        """Everything to go on exactly from here: parameters, optimiser, env, random numbers, multipliers, centres."""
        vectors = {str(index): vector.detach().clone() for index, vector in enumerate(self.population.vectors)}
        rates = torch.tensor(self.steps.rates, dtype=torch.float64)
        parts = {
            "vectors": vectors,
            "optimiser": self.steps.state(),
            "rates": rates,
            "noise": self.noise.state_dict(),
            "order": self.order.state_dict(),
            "normaliser": {name: value.clone() for name, value in self.population.named_buffers()},
            "multipliers": _plain(self.multipliers),
            "held": {name: _plain(multiplier) for name, multiplier in self.held.items()},
            "centres": {name: _plain(measured.centring) for name, measured in self.measured.items()},
            "kl": self.kl.clone(),
            "batches": torch.tensor(self.batches),
            "stopped": torch.tensor(sorted(self.stopped), dtype=torch.int64),
            "env": self._env_state(),
            "transforms": self._transform_state(),
        }
        return TensorDict(parts, batch_size=[])

    @property
    def resumable(self) -> bool:
        """Whether `full_state` can be had: the env and its transforms must know how to be saved in mid-episode."""
        bare, transforms = base_and_transforms(self.env)
        if not all(one.savable for one in transforms if isinstance(one, DeferrableTransform)):
            return False
        return isinstance(bare, TaskEnv) and bare.full_state() is not None

    def _env_state(self) -> TensorDictBase:
        bare = base_and_transforms(self.env)[0]
        state = bare.full_state() if isinstance(bare, TaskEnv) else None
        if state is None:
            raise SimulationError(f"{type(bare).__name__} cannot be saved in mid-episode: it has no full_state.")
        return state

    def _transform_state(self) -> dict[str, dict[str, torch.Tensor]]:
        """The memory of measurement models inside the env."""
        transforms = base_and_transforms(self.env)[1]
        return {str(index): _plain(transform) for index, transform in enumerate(transforms)}

    def _load(self, state: TensorDictBase) -> None:
        with torch.no_grad():
            for index, vector in enumerate(self.population.vectors):
                vector.copy_(state["vectors", str(index)])
            for name, buffer in self.population.named_buffers():
                buffer.copy_(state["normaliser", name])
        rows = state["optimiser"]
        self.steps.load_state({name: dict(rows[name].items()) for name in rows.keys()})  # noqa: SIM118
        self.steps.rates = state["rates"].tolist()
        self.noise.load_state_dict(state["noise"])
        self.order.load_state_dict(state["order"])
        self.multipliers.load_state_dict(dict(state["multipliers"].items()))
        for name, measured in self.measured.items():
            measured.centring.load_state_dict(dict(state["centres", name].items()))
        for name, multiplier in self.held.items():
            saved = dict(state["held", name].items()) if name in state["held"].keys() else {}  # noqa: SIM118
            multiplier.load_state_dict({**_plain(multiplier), **saved})  # checkpoints of before held and smoothed less
        self.kl = state["kl"].to(self.kl.device)
        self.batches = int(state["batches"])
        self.stopped = {
            index: f"candidate {self.names[index]}: stopped before the checkpoint"
            for index in state["stopped"].tolist()
        }
        for index in self.stopped:
            self.steps.halt(index)
        base_and_transforms(self.env)[0].go_on(state["env"])
        self.population.refresh()

    def close(self) -> None:
        """Shut the collector and its env down, and let go of threads."""
        self.collector.shutdown()
        self.steps.close()


def _plain(module: torch.nn.Module) -> dict[str, torch.Tensor]:
    """Copies of a module's state, by name."""
    return {name: value.clone() for name, value in module.state_dict().items()}
