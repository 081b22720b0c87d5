"""The measurement model inside a training env, as a TorchRL transform.

For an env of batch size [P, N] that writes ("channels", name), each control step adds

    ("measured", target)       [P, N, 1]  prediction, z-scored (`model.denormalise` gives the target's unit)
    ("real_reward", objective) [P, N, 1]  r_real = objective.reward(prediction), per second, not weighted, not centred
    ("outside", target)        [P, N, 1]  share of the inputs that lie outside the range the model was fitted on

All three are 0 where an episode has just begun: nothing has been measured yet. They are observations, not the
env's reward: whoever trains adds λ·dt·(r_real − centre) to r_sim. NaN stays NaN, so that it can be found.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs.transforms import Transform

from hts.contracts import MeasurementModel, Prediction
from hts.errors import SimulationError, unknown_name
from hts.measurement.data import gather
from hts.measurement.pessimism import pessimistic_reward

if TYPE_CHECKING:
    from hts.contracts import Objective


class Measured(Transform):
    """What both transforms share: what they read and write, and their specs. None waits for the device, so that a GPU's
    control step can be captured with them in it."""

    def __init__(self, inputs: tuple[str, ...], outputs: tuple[tuple[str, str], ...]) -> None:
        super().__init__(in_keys=[("channels", name) for name in inputs], out_keys=list(outputs))
        self.inputs = tuple(inputs)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        batch, device = observation_spec.shape, observation_spec.device
        groups = set(observation_spec.keys())
        known = set(observation_spec["channels"].keys()) if "channels" in groups else set()
        for name in self.inputs:
            if name not in known:
                raise SimulationError("Measurement model: " + unknown_name("channel of the env", name, known))
        for group, name in self.out_keys:
            if group not in groups:
                observation_spec[group] = Composite(shape=batch, device=device)
                groups.add(group)
            observation_spec[group, name] = Unbounded((*batch, 1), device=device)
        return observation_spec

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        for key in self.out_keys:
            tensordict_reset.set(key, torch.zeros(*tensordict_reset.batch_size, 1, device=tensordict_reset.device))
        return tensordict_reset

    def keep(self, channels: Mapping[str, Tensor]) -> Tensor:
        """What `follow` will want to know of a step; channels: name -> [P, N, ...], now."""
        raise NotImplementedError

    def follow(self, kept: Tensor, ended: Tensor) -> Tensor:
        """What `_step` and `_reset` do one after the other, for several steps at once: nobody needs r_real before.

        kept (T, ...): of each step; ended (T, P·N): episodes that ended with the step. Returns r_real, T·P·N numbers in that order.
        """
        raise NotImplementedError

    # An env that resets itself hands the same mask to the same work.
    def _reset_on_native_autoreset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._reset(tensordict, tensordict_reset)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        raise SimulationError(f"{type(self).__name__} works inside an env only: its memory belongs to worlds.")


class MeasurementTransform(Measured):
    """Predicts the objective's target in every world at every step, and turns it into r_real.

    model: one for all candidates, moved to the env's device; reward: z-scored prediction -> r_real, any shape. A model that
    knows how far it may be wrong may be looked at from its worse side, see `measurement.pessimism`.
    The memory, (P·N, ...), is emptied where an episode begins; it is part of `state_dict()`, so a
    run resumes in mid-episode. The model's weights are not: they have their own file (`measurement.files`).
    """

    STATE = ("memory",)

    def __init__(self, model: MeasurementModel, reward: Callable[[Tensor], Tensor], name: str) -> None:
        target = model.signals.target.name
        super().__init__(model.signals.names, (("measured", target), ("real_reward", name), ("outside", target)))
        # In a tuple, so that the model is not a submodule: its weights would be saved with every checkpoint.
        self._model = (model,)
        self.reward = reward
        self.memory: Tensor | None
        self.register_buffer("memory", None)

    @property
    def model(self) -> MeasurementModel:
        return self._model[0]

    @classmethod
    def of(cls, objective: Objective, model: MeasurementModel) -> MeasurementTransform:
        """The transform of an objective with its fitted model."""
        return cls(model, objective.reward, objective.name)

    def prepare(self, worlds: int, device: torch.device) -> None:
        """Model and memory on the device: before the first step, since models are fitted on the CPU, and after loading
        a state saved on another device."""
        model = self._model[0]
        if model.device != device:
            model.to(device)
        if self.memory is None:
            self.memory = model.initial_state(worlds)
        elif self.memory.device != device:
            self.memory = self.memory.to(device)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        shape = next_tensordict.batch_size
        worlds = shape.numel()
        model = self._model[0]
        inputs = gather(next_tensordict.get("channels"), self.inputs, worlds)
        self.prepare(worlds, inputs.device)
        prediction, self.memory = model.step(inputs, self.memory)
        prediction = Prediction(*(None if part is None else part.view(*shape, 1) for part in prediction))
        measured, real_reward, outside = self.out_keys
        next_tensordict.set(measured, prediction.mean)
        next_tensordict.set(real_reward, pessimistic_reward(self.reward, prediction, model.pessimism))
        next_tensordict.set(outside, model.outside(inputs).view(*shape, 1))
        return next_tensordict

    def keep(self, channels: Mapping[str, Tensor]) -> Tensor:
        worlds = channels[self.inputs[0]].shape[:2].numel()
        return gather(channels, self.inputs, worlds)

    def follow(self, kept: Tensor, ended: Tensor) -> Tensor:
        self.prepare(kept.shape[1], kept.device)
        model = self._model[0]
        prediction, self.memory = model.steps(kept, self.memory, ended)
        prediction = Prediction(*(None if part is None else part.unsqueeze(-1) for part in prediction))
        return pessimistic_reward(self.reward, prediction, model.pessimism)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        mask = tensordict.get("_reset", None)
        if self.memory is not None:
            model, worlds = self._model[0], len(self.memory)
            if mask is None:
                self.memory = model.initial_state(worlds)
            else:
                self.prepare(worlds, mask.device)
                self.memory = model.reset(self.memory, mask.reshape(-1))
        return super()._reset(tensordict, tensordict_reset)

    def _load_from_state_dict(self, state_dict, prefix, *args, **kwargs) -> None:
        saved = state_dict.get(prefix + "memory")
        own = self._model[0].initial_state(1).shape[1:]
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
        super().__init__(objective.inputs, (("measured", objective.target.name), ("real_reward", objective.name)))
        self.objective = objective

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        channels = next_tensordict.get("channels")
        proxy = self.keep(channels).unsqueeze(-1)
        measured, real_reward = self.out_keys
        next_tensordict.set(measured, proxy)
        next_tensordict.set(real_reward, self.objective.reward(proxy))
        return next_tensordict

    def keep(self, channels: Mapping[str, Tensor]) -> Tensor:
        proxy = self.objective.proxy({name: channels[name] for name in self.inputs})
        if proxy is None:
            raise SimulationError(
                f"Objective '{self.objective.name}' has no analytic stand-in, so there is no baseline to train."
            )
        return proxy

    def follow(self, kept: Tensor, ended: Tensor) -> Tensor:
        return self.objective.reward(kept)
