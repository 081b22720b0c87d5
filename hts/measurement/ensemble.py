"""`ensemble`: several models of one kind, each fitted to its own sample of the recordings: mean and disagreement.

Each member sees as many recordings as there are, drawn with replacement (bootstrap), and starts from a seed of its own.
The spread over members says how much the prediction hangs on which recordings there happened to be: small where there
is data, large where a policy has left it. It does not hold the sensor's own scatter.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from hts.config import Config, Named
from hts.contracts import MeasurementModel, ModelContext, Prediction
from hts.errors import ConfigError
from hts.measurement.data import input_tensor, training_data
from hts.measurement.fit_settings import Learner
from hts.measurement.split import part

if TYPE_CHECKING:
    from hts.measurement.fit_settings import FitSettings
    from hts.recordings.recording import Recording

NAME = "ensemble"
LEAST_PARTS = 6  # recordings to draw from; fewer are cut, so that members differ


class EnsembleSettings(Config):
    """Settings of measurement model `ensemble`."""

    members: int = Field(5, ge=2, description="K")
    member: str | dict[str, Any] | None = Field(
        None, description="model of each member: a name, or a mapping of name and settings; null: the objective's own"
    )
    beta: float = Field(
        1.0, ge=0, description="β: the reward is that of the worse end of mean ± β standard deviations; 0: of the mean"
    )
    fitted: tuple[dict[str, Any], ...] | None = Field(
        None,
        description="written by the fit: settings of each member, where its fit wrote some down that differ from "
        "`member`, such as which torque it took; null: none did",
    )


def make(settings: Mapping[str, Any], context: ModelContext) -> MeasurementModel:
    """From plain settings. Raises ConfigError for a member that cannot be."""
    config = EnsembleSettings.model_validate(dict(settings))
    given = {"name": config.member} if isinstance(config.member, str) else config.member
    if given is not None and not isinstance(given.get("name"), str):
        raise ConfigError(f"ensemble: member: expected a mapping with the model's name, found {given}.")
    member = Named(**given) if given is not None else context.default
    if member is None:
        raise ConfigError("ensemble: member: say which model its members are, e.g. lstm.")
    if member.name == NAME:
        raise ConfigError("ensemble: member: an ensemble of ensembles is none. Name another model, e.g. lstm.")
    registry = context.registry
    if registry is None:
        raise ConfigError("ensemble: its members come from the registry. Make it with registry.make_measurement_model.")
    of_member = replace(context, physics_steps=0)  # it is asked once a control step, and so are they
    each = config.fitted or (member.settings,) * config.members
    if len(each) != config.members:
        raise ConfigError(f"ensemble: fitted: describes {len(each)} members of {config.members}. The fit writes it.")
    members = [registry.make_measurement_model(member.name, one, of_member) for one in each]
    return Ensemble(config, members)


class Ensemble(Learner):
    """K members of one kind. The memory of W worlds is (W, K, ...), a member's own along the second dimension.

    scale, shift: (K,): from each member's z-scores to the ensemble's, since each was scaled by the recordings it drew.
    """

    def __init__(self, config: EnsembleSettings, members: Sequence[MeasurementModel]) -> None:
        self.members, self.signals = tuple(members), members[0].signals
        named = {"name": members[0].name, **members[0].settings}
        self.config = config if config.fitted else config.model_copy(update={"member": named})
        self.pessimism = config.beta
        self._own = {
            "scale": torch.ones(len(members)),
            "shift": torch.zeros(len(members)),
            "target_mean": torch.tensor(0.0),
            "target_std": torch.tensor(1.0),
            "input_low": torch.full((self.signals.num_inputs,), -torch.inf),
            "input_high": torch.full((self.signals.num_inputs,), torch.inf),
        }

    @property
    def settings(self) -> Mapping[str, Any]:
        return self.config.model_dump(mode="json")

    @property
    def target_mean(self) -> Tensor:  # type: ignore[override]
        return self._own["target_mean"]

    @property
    def target_std(self) -> Tensor:  # type: ignore[override]
        return self._own["target_std"]

    @torch.no_grad()
    def learn(self, recordings: Sequence[Recording], how: FitSettings) -> dict[str, Any]:
        """Member by member; each gets an equal part of the time that is left.
        The report holds each one's own as `members`."""
        began = time.monotonic()
        pieces = training_data(self.signals, recordings)
        parts, rng, count = enough_parts(recordings), np.random.default_rng(how.seed), len(self.members)
        last = how.warm_start
        before = last.members if isinstance(last, Ensemble) and len(last.members) == count else None
        reports = []
        for index, member in enumerate(self.members):

            def share(epoch: int, all_epochs: int, error: float, index: int = index) -> None:
                if how.progress is not None:
                    how.progress(index * all_epochs + epoch, count * all_epochs, error)

            left = how.max_seconds - (time.monotonic() - began)
            drawn = [parts[i] for i in rng.integers(len(parts), size=len(parts))]
            with torch.enable_grad():
                report = member.fit(
                    drawn,
                    seed=how.seed + index,
                    epochs=how.epochs,
                    max_seconds=left / (count - index),
                    progress=share,
                    warm_start=before[index] if before is not None else None,
                )
            reports.append(report)
        found = tuple(dict(member.settings) for member in self.members)
        named = self.config.member if isinstance(self.config.member, dict) else {}
        asked = {name: value for name, value in named.items() if name != "name"}
        changed = any(one != asked for one in found)
        self.config = self.config.model_copy(update={"fitted": found if changed else None})
        self._scale(torch.cat([piece.inputs for piece in pieces]), torch.cat([piece.target for piece in pieces]))
        return {
            "samples": sum(len(piece.target) for piece in pieces),
            "epochs": max(report.get("epochs", how.epochs) for report in reports),
            "warm_started": all(bool(report.get("warm_started")) for report in reports),
            "members": reports,
        }

    def _scale(self, inputs: Tensor, target: Tensor) -> None:
        """Statistics of all the recordings, which give the ensemble its z-scores and its range."""
        mean, std = target.double().mean(), target.double().std()
        members = [(one.target_mean.double(), one.target_std.double()) for one in self.members]
        own = {
            "scale": torch.stack([s / std for _, s in members]),
            "shift": torch.stack([(m - mean) / std for m, _ in members]),
            "target_mean": mean,
            "target_std": std,
            "input_low": inputs.amin(0),
            "input_high": inputs.amax(0),
        }
        self._own = {name: value.float() for name, value in own.items()}

    # --------------------------------------------------------------------------------------------- running

    def initial_state(self, num_worlds: int) -> Tensor:
        return _together([member.initial_state(num_worlds) for member in self.members])

    def reset(self, state: Tensor, begun: Tensor) -> Tensor:
        pairs = zip(self.members, state.unbind(1), strict=True)
        return _together([member.reset(part, begun) for member, part in pairs])

    def sequence(self, inputs: Tensor, state: Tensor | None = None) -> tuple[Prediction, Tensor]:
        """inputs: (W, T, F), or (W, T, K, ...) of `inputs_along`, where each member has its own."""
        states = [None] * len(self.members) if state is None else state.unbind(1)
        each = inputs.unbind(2) if inputs.ndim > 3 else [inputs] * len(self.members)
        return self._joined(
            [one.sequence(own, part) for one, own, part in zip(self.members, each, states, strict=True)]
        )

    @torch.no_grad()
    def step(self, inputs: Tensor, state: Tensor) -> tuple[Prediction, Tensor]:
        pairs = zip(self.members, state.unbind(1), strict=True)
        return self._joined([member.step(inputs, part) for member, part in pairs])

    @torch.no_grad()
    def steps(self, inputs: Tensor, state: Tensor, ended: Tensor) -> tuple[Prediction, Tensor]:
        pairs = zip(self.members, state.unbind(1), strict=True)
        return self._joined([member.steps(inputs, part, ended) for member, part in pairs])

    def _joined(self, found: Sequence[tuple[Prediction, Tensor]]) -> tuple[Prediction, Tensor]:
        """Mean and standard deviation (a sample's, over K - 1) of the members' predictions, (...,), in the ensemble's
        z-scores."""
        scale, shift = self._own["scale"], self._own["shift"]
        each = torch.stack([scale[k] * one.mean + shift[k] for k, (one, _) in enumerate(found)])
        return Prediction(each.mean(0), each.std(0)), _together([state for _, state in found])

    def inputs_along(self, recording: Recording) -> Tensor | None:
        """What each member was fitted to, (T, K, ...): one may have taken computed torques, another those that were
        read. None where all take the channels as they are, or where members' inputs have different shapes."""
        own = [member.inputs_along(recording) for member in self.members]
        if all(inputs is None for inputs in own):
            return None
        read = input_tensor(self.signals, recording)
        each = [read if inputs is None else inputs for inputs in own]
        return torch.stack(each, 1) if len({one.shape for one in each}) == 1 else None

    def outside(self, inputs: Tensor) -> Tensor:
        outside = inputs.clamp(self._own["input_low"], self._own["input_high"]) != inputs
        return outside.mean(-1, dtype=torch.float32)

    # ---------------------------------------------------------------------------------------------- numbers

    def tensors(self) -> Mapping[str, Tensor]:
        found = dict(self._own)
        for index, member in enumerate(self.members):
            found |= {f"members.{index}.{name}": value for name, value in member.tensors().items()}
        return found

    def load_tensors(self, tensors: Mapping[str, Tensor]) -> None:
        self._own = {name: tensors[name].to(value.device) for name, value in self._own.items()}
        for index, member in enumerate(self.members):
            start = f"members.{index}."
            member.load_tensors({k.removeprefix(start): v for k, v in tensors.items() if k.startswith(start)})

    def to(self, device: torch.device | str) -> Ensemble:
        self._own = {name: value.to(device) for name, value in self._own.items()}
        for member in self.members:
            member.to(device)
        return self


def enough_parts(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings; if they are few, each cut into equal parts, so that there are enough to draw from."""
    cuts = math.ceil(LEAST_PARTS / len(recordings))
    if cuts == 1:
        return list(recordings)
    found = []
    for recording in recordings:
        edges = np.linspace(0, recording.num_samples, cuts + 1).round().astype(int)
        found += [part(recording, int(a), int(b)) for a, b in itertools.pairwise(edges)]
    return found


def _together(states: Sequence[Tensor]) -> Tensor:
    """Members' states (W, ...) as one (W, K, ...), laid out worlds last in memory, as a member that keeps its own so
    finds it."""
    return torch.stack([state.movedim(0, -1) for state in states]).movedim(-1, 0)
