"""The measurement model inside a training env, as a TorchRL transform.

For an env of batch size [P, N] that writes ("channels", name), each control step adds

    ("measured", target)       [P, N, 1]  prediction, z-scored (`model.denormalise` gives the target's unit)
    ("real_reward", objective) [P, N, 1]  r_real = objective.reward(prediction), per second, not weighted, not centred
    ("outside", target)        [P, N, 1]  share of the inputs that lie outside the range the model was fitted on

All three are 0 where an episode has just begun: nothing has been measured yet. They are observations, not the
env's reward: `hts.rl.MeasuredReward` adds λ·dt·(r_real − centre) to r_sim. NaN stays NaN, so that it can be found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, Unbounded

from hts.contracts import MeasurementModel, Prediction
from hts.errors import PluginError, SimulationError, unknown_name
from hts.guarded import guarded
from hts.measurement.data import gather
from hts.measurement.pessimism import pessimistic_reward
from hts.measurement.physics_steps import in_physics_steps
from hts.measurement.proxy import proxy_of
from hts.measurement.reward import reward_of
from hts.rl.deferred import DeferrableTransform
from hts.rl.task_env import ReplacedState

if TYPE_CHECKING:
    from hts.contracts import Objective


class Measured(DeferrableTransform):
    """What both transforms share: what they read and write, and their specs."""

    def __init__(self, inputs: tuple[str, ...], outputs: tuple[tuple[str, str], ...]) -> None:
        super().__init__(in_keys=[("channels", name) for name in inputs], out_keys=list(outputs))
        self.inputs = tuple(inputs)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        batch, device = observation_spec.shape, observation_spec.device
        groups = set(observation_spec.keys())
        known = set(observation_spec["channels"].keys()) if "channels" in groups else set()
        for name in self.inputs:
            if name not in known:
                raise self._lacks(name, known)
        for group, name in self.out_keys:
            if group not in groups:
                observation_spec[group] = Composite(shape=batch, device=device)
                groups.add(group)
            observation_spec[group, name] = Unbounded((*batch, 1), device=device)
        return observation_spec

    @property
    def _who(self) -> str:
        """Who reads the channels, at the beginning of a message."""
        return f"{type(self).__name__} of '{self.out_keys[0][1]}'"

    def _lacks(self, name: str, known: Iterable[str]) -> SimulationError:
        return SimulationError(f"{self._who}: " + unknown_name("channel of the env", name, known))

    def forget(self, ended: Tensor) -> None:
        """Nothing is remembered."""

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        raise SimulationError(f"{type(self).__name__} works inside an env only: its memory belongs to env instances.")


def channels_read(rewards: Iterable[Measured]) -> tuple[str, ...]:
    """Sim channels that these read, each once."""
    return tuple(dict.fromkeys(name for one in rewards for name in one.inputs))


class MeasurementTransform(Measured):
    """Predicts the objective's target in every env instance at every step, and turns it into r_real.

    model: one for all candidates, moved to the env's device; reward: z-scored prediction -> r_real, any shape. A model
    that knows how far it may be wrong may be looked at from its worse side, see `measurement.pessimism`.
    The memory, (P·N, ...), is emptied where an episode begins; it is part of `state_dict()`, so a run resumes in
    mid-episode. The model's weights are not: they have their own file (`measurement.files`).
    """

    def __init__(self, model: MeasurementModel, reward: Callable[[Tensor], Tensor], name: str) -> None:
        target, names = model.signals.target.name, model.signals.names
        self._in_steps = model.settles and model.settles_in_physics_steps
        inputs = in_physics_steps(names, f"The model of '{target}'") if self._in_steps else names
        super().__init__(inputs, (("measured", target), ("real_reward", name), ("outside", target)))
        # In a tuple, so that the model is not a submodule: its weights would be saved with every checkpoint.
        self._model = (model,)
        self.reward = partial(reward_of, name, reward)
        self.memory: Tensor | None
        self.register_buffer("memory", None)

    @property
    def model(self) -> MeasurementModel:
        return self._model[0]

    @classmethod
    def of(cls, objective: Objective, model: MeasurementModel) -> MeasurementTransform:
        """The transform of an objective with its fitted model."""
        return cls(model, objective.reward, objective.name)

    def prepare(self, instances: int, device: torch.device) -> None:
        """Model and memory on the device: before the first step, since models are fitted on the CPU, and after loading
        a state saved on another device."""
        if self.model.device != device:
            self.model.to(device)
        if self.memory is None:
            begun = guarded(f"{self._who}: initial_state()", partial(self.model.initial_state, instances))
            self.memory = self._as_memory("initial_state", begun, None)
        elif self.memory.device != device:
            self.memory = self.memory.to(device)

    def replaced_state(self) -> list[ReplacedState]:
        return [ReplacedState(self, ("memory",))]

    def record(self, channels: Mapping[str, Tensor]) -> Tensor:
        """The model's inputs, (P·N, F). Raises SimulationError for a channel that is not there, or is of another size
        than the model was made for: the others would take its place."""
        for name in self.inputs:
            if name not in channels:
                raise self._lacks(name, channels.keys())
        worlds = channels[self.inputs[0]].shape[:2].numel()
        for name, size in () if self._in_steps else zip(self.inputs, self.model.signals.sizes, strict=True):
            if channels[name].numel() != worlds * size:
                raise SimulationError(
                    f"{self._who} was made for {size} numbers of '{name}' in each world, the env writes "
                    f"{channels[name].numel() / worlds:g}. Fit it to recordings of this machine, or write the channel "
                    "as they have it."
                )
        return gather(channels, self.inputs, worlds)

    def evaluate(self, recorded: Tensor) -> dict[NestedKey, Tensor]:
        if self._in_steps:
            steps = recorded.unflatten(-1, (len(self.inputs), -1, self.model.signals.sizes[0]))
            inputs = steps.movedim(-2, -3).flatten(-2)  # (P·N, K, F)
            last = inputs[..., -1, :]
            return self._entries(self._told("settled_over", last, self.model.settled_over, inputs), last)
        if self.model.settles:
            return self._entries(self._told("settled", recorded, self.model.settled, recorded), recorded)
        return self._stepped("step", recorded, self.model.step, recorded, self.memory)

    def forget(self, ended: Tensor) -> None:
        if self.memory is not None:
            self.prepare(len(ended), ended.device)
            after = guarded(f"{self._who}: reset()", partial(self.model.reset, self.memory, ended))
            self.memory = self._as_memory("reset", after, self.memory)

    def forward_sequence(self, recorded: Tensor, ended: Tensor) -> dict[NestedKey, Tensor]:
        if self.model.settles:
            return super().forward_sequence(recorded, ended)
        return self._stepped("steps", recorded, self.model.steps, recorded, self.memory, ended)

    def source_of(self, key: NestedKey, outcome: TensorDictBase) -> str:
        measured, (_, objective), _ = self.out_keys
        if bool(outcome[measured].isfinite().all()):
            return f"reward() of objective '{objective}', given finite predictions of {self._named}"
        asked = ("settled_over" if self._in_steps else "settled") if self.model.settles else "step"
        return f"{asked}() of {self._named}, whose predictions are not finite"

    # Shapes and types alone are looked at below, never numbers: a GPU would be waited for.

    @property
    def _named(self) -> str:
        return f"measurement model '{self.model.name or type(self.model).__name__}'"

    @property
    def _who(self) -> str:
        return f"M{self._named[1:]}"

    def _stepped(self, name: str, inputs: Tensor, call: Callable[..., Any], *given: Any) -> dict[NestedKey, Tensor]:
        """What a call gives that goes on from the memory, which it renews."""
        found = guarded(f"{self._who}: {name}()", partial(call, *given))
        if not isinstance(found, tuple) or len(found) != 2 or not isinstance(found[0], Prediction):
            kinds = " and ".join(type(one).__name__ for one in found) if type(found) is tuple else type(found).__name__
            raise PluginError(f"{self._who}: {name}() gave {kinds}, expected a Prediction and the new state.")
        prediction = self._as_prediction(name, inputs, found[0])
        self.memory = self._as_memory(name, found[1], self.memory)
        return self._entries(prediction, inputs)

    def _told(self, name: str, inputs: Tensor, call: Callable[[Tensor], Prediction], given: Tensor) -> Prediction:
        return self._as_prediction(name, inputs, guarded(f"{self._who}: {name}()", partial(call, given)))

    def _as_prediction(self, name: str, inputs: Tensor, found: Any) -> Prediction:
        if not isinstance(found, Prediction):
            raise PluginError(f"{self._who}: {name}() gave {type(found).__name__}, expected a Prediction.")
        wanted = inputs.shape[:-1]
        for part, values in (("mean", found.mean), ("std", found.std)):
            if part == "std" and values is None:
                continue
            if not isinstance(values, Tensor) or values.shape != wanted:
                shown = tuple(values.shape) if isinstance(values, Tensor) else type(values).__name__
                raise PluginError(
                    f"{self._who}: {name}() gave a prediction whose {part} is {shown} for inputs of "
                    f"{tuple(inputs.shape)}; expected {tuple(wanted)}, one number for each world."
                )
        return found

    def _outside(self, inputs: Tensor) -> Tensor:
        found = guarded(f"{self._who}: outside()", partial(self.model.outside, inputs))
        if not isinstance(found, Tensor) or found.shape != inputs.shape[:-1]:
            shown = tuple(found.shape) if isinstance(found, Tensor) else type(found).__name__
            raise PluginError(
                f"{self._who}: outside() gave {shown} for inputs of {tuple(inputs.shape)}; expected "
                f"{tuple(inputs.shape[:-1])}, a share for each world."
            )
        return found

    def _as_memory(self, name: str, found: Any, before: Tensor | None) -> Tensor:
        if not isinstance(found, Tensor):
            raise PluginError(
                f"{self._who}: {name}() gave {type(found).__name__} as state, expected a tensor with worlds first; "
                "(W, 0) where nothing is remembered."
            )
        if before is not None and (found.shape != before.shape or found.dtype != before.dtype):
            told = (f"{str(one.dtype).removeprefix('torch.')} {tuple(one.shape)}" for one in (found, before))
            raise PluginError(f"{self._who}: {name}() gave a state of {next(told)}, expected {next(told)}, as before.")
        return found

    def _entries(self, prediction: Prediction, inputs: Tensor) -> dict[NestedKey, Tensor]:
        measured, real_reward, outside = self.out_keys
        prediction = Prediction(*(None if part is None else part.unsqueeze(-1) for part in prediction))
        return {
            measured: prediction.mean,
            real_reward: pessimistic_reward(self.reward, prediction, self.model.pessimism),
            outside: self._outside(inputs).unsqueeze(-1),
        }

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *args: Any, **kwargs: Any) -> None:
        saved = state_dict.get(prefix + "memory")
        own = self.model.initial_state(1).shape[1:]
        if saved is not None and saved.shape[1:] != own and saved.movedim(-1, 0).shape[1:] == own:
            saved = state_dict[prefix + "memory"] = saved.movedim(-1, 0)  # of an earlier version: worlds came last
        self.memory = None if saved is None else torch.empty_like(saved)
        super()._load_from_state_dict(state_dict, prefix, *args, **kwargs)


class ProxyTransform(Measured):
    """The analytic stand-in of the objective as the reward, for the baseline: r_real = reward(proxy).

    The proxy is in its own unit and not z-scored, which is why the baseline sweeps other weights.
    Writes ("measured", target) with the proxy and ("real_reward", objective), each [P, N, 1].
    """

    def __init__(self, objective: Objective) -> None:
        names = objective.inputs
        what = f"The stand-in of objective '{objective.name}'"
        inputs = in_physics_steps(names, what) if objective.proxy_in_physics_steps else names
        super().__init__(inputs, (("measured", objective.target.name), ("real_reward", objective.name)))
        self.objective = objective

    def record(self, channels: Mapping[str, Tensor]) -> Tensor:
        """The proxy, (P·N, 1); its mean over the physics steps where it is asked in each."""
        given = dict(zip(self.objective.inputs, (channels[name] for name in self.inputs), strict=True))
        in_steps = self.objective.proxy_in_physics_steps
        first = channels[self.inputs[0]]
        proxy = proxy_of(self.objective, given, first.shape[: 3 if in_steps else 2])
        if proxy is not None and in_steps:
            proxy = proxy.reshape(first.shape[:3]).mean(-1)
        if proxy is None:
            raise SimulationError(
                f"Objective '{self.objective.name}' has no analytic stand-in, so there is no baseline to train."
            )
        return proxy.reshape(-1, 1)

    def source_of(self, key: NestedKey, outcome: TensorDictBase) -> str:
        method = "reward" if bool(outcome[self.out_keys[0]].isfinite().all()) else "proxy"
        return f"{method}() of objective '{self.objective.name}'"

    def evaluate(self, recorded: Tensor) -> dict[NestedKey, Tensor]:
        measured, real_reward = self.out_keys
        return {measured: recorded, real_reward: reward_of(self.objective.name, self.objective.reward, recorded)}

    def forward_sequence(self, recorded: Tensor, ended: Tensor) -> dict[NestedKey, Tensor]:
        return self.evaluate(recorded)
