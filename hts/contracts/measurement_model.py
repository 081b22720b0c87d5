"""A measurement model f: sim channels → real channel. Fitted to recordings, then run inside the training env.

What an author gets to write: `fit`, `sequence`, `step`, `initial_state`, and how the numbers go in and out
(`tensors`, `load_tensors`, `to`). `hts.measurement.torch_model.TorchModel` does the second half for a
`torch.nn.Module`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from hts.channels import Channel
from hts.config import Named
from hts.errors import ConfigError, unknown_name

if TYPE_CHECKING:
    import torch

    from hts.contracts.installed import Installed
    from hts.contracts.objective import Objective
    from hts.contracts.robot import Robot
    from hts.recordings.recording import Recording

Progress = Callable[[int, int, float], None]
"""progress(epoch, epochs, error): after each pass over the data;
error: mean squared, in z-scores, on data not fitted to."""


class Prediction(NamedTuple):
    """mean: the target in standard deviations of its training data (z-scores); std: of that mean, same shape and scale,
    None from a model that does not know how far it may be wrong."""

    mean: torch.Tensor
    std: torch.Tensor | None = None


def several_numbers(target: Channel) -> str:
    """What is wrong with a target of more than one number a sample, and what to do."""
    return (
        f"Target '{target.name}' has shape {target.shape}, {math.prod(target.shape)} numbers a sample; "
        "a model predicts one. Let the log or the instrument give one, such as the sum over the motors (`sum: true` of "
        "a mapping) or the largest (`max: true`); all of them may stand beside it in the objective's also_measured."
    )


@dataclass(frozen=True)
class Signals:
    """What a model reads and predicts.

    inputs: sim channels, in order; target: the real channel; rate_hz: of both, Hz.

    F, below, is the count of numbers per sample over all inputs, side by side in this order.

    units_known: False for a file of format 1, which holds no units: all of them are then "1".

    Raises ConfigError for a target of more than one number per sample, or one that is an input too.
    """

    inputs: tuple[Channel, ...]
    target: Channel
    rate_hz: float
    units_known: bool = True

    def __post_init__(self) -> None:
        target = self.target
        if math.prod(target.shape) != 1:
            raise ConfigError(several_numbers(target))
        if target.name in self.names:
            raise ConfigError(
                f"Target '{target.name}' is among the inputs ({', '.join(self.names)}), so nothing is left to predict. "
                "Leave it out of the inputs, or name another target."
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Of the inputs, in order."""
        return tuple(channel.name for channel in self.inputs)

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers per sample of each input."""
        return tuple(math.prod(channel.shape) for channel in self.inputs)

    @property
    def num_inputs(self) -> int:
        """F."""
        return sum(self.sizes)


@dataclass(frozen=True)
class ModelContext:
    """What a factory of measurement models gets beside the settings.

    signals: what the model will read and predict; default: the model that the objective uses where nobody chose
    another, None when a model is read from its file; registry: everything that is installed, for models made of other
    models; physics_steps: in how many of them the robot's training env takes a control step and tells what they were
    like (`hts.channels.substep_channels`), 0 for one that does not, None where no robot is known, as when a model is
    read from its file.
    """

    signals: Signals
    default: Named | None = None
    registry: Installed | None = None
    physics_steps: int | None = None


class MeasurementModel(ABC):
    """f, with an explicit memory: of recordings in `sequence`, of a batch of worlds, one sample at a time, in `step`.

    A fresh model is unfitted; its tensors have their final names and shapes already, so that a file can be read into
    it. Predictions are z-scores of the target: an objective's reward and λ count in standard deviations of the data.

    `step` runs inside the training env at every control step, on a GPU as part of a captured CUDA graph, or written
    down operation by operation and compiled. So it does not wait for the device (no `.item()`, no `bool(tensor)`, no
    numpy), does not branch on values, gives the same shapes each time, draws no random numbers, needs no gradients, and
    changes neither its inputs nor its state in place. A world's prediction depends on that world alone. A NaN or
    infinite input never becomes a finite prediction: the reward is minus a cost, and 0 would be the best there is.

    name: as registered (the registry writes it); signals: what it was made for;
    target_mean, target_std: of the data it was fitted to, in the target's unit, 0-dimensional tensors;
    pessimism: β, by how many of its own standard deviations the reward looks at the worse side
    (`hts.measurement.pessimism`).
    """

    name: str = ""
    signals: Signals
    target_mean: torch.Tensor
    target_std: torch.Tensor
    pessimism: float = 0.0

    @property
    @abstractmethod
    def settings(self) -> Mapping[str, Any]:
        """All settings, defaults included, as JSON values: with the name and the signals they make this model again."""

    @abstractmethod
    def fit(
        self,
        recordings: Sequence[Recording],
        *,
        seed: int = 0,
        epochs: int = 20,
        max_seconds: float = math.inf,
        progress: Progress | None = None,
        warm_start: MeasurementModel | None = None,
    ) -> dict[str, Any]:
        """Fit to all the recordings, in place; what is held out stays with the caller. Returns a report of JSON values.

        epochs, max_seconds: at most so much work, for models that learn by passes over the data; warm_start: a fitted
        model to go on from, used if it is of the same make. The same recordings and seed give the same model, unless
        time ran out; the global random generator is left alone. Raises RecordingError for recordings that cannot be
        learned from (`hts.measurement.data.training_data` reads them and does).
        """

    @abstractmethod
    def sequence(self, inputs: torch.Tensor, state: torch.Tensor | None = None) -> tuple[Prediction, torch.Tensor]:
        """Along recordings: inputs (B, T, F) in channel units -> predictions (B, T), and the state after them (B, ...).

        state: that before them, as a sequence or steps before these left it; None: as `initial_state`. The predictions,
        mean and std, are those of `step` sample after sample: it is `step` that rewards, and this that is reported.
        """

    @abstractmethod
    def step(self, inputs: torch.Tensor, state: torch.Tensor) -> tuple[Prediction, torch.Tensor]:
        """One sample of W worlds: inputs (W, F) in channel units -> predictions (W,) and the new state (W, ...)."""

    @abstractmethod
    def initial_state(self, num_worlds: int) -> torch.Tensor:
        """The memory of W worlds that have just begun, (W, ...), on the model's device;
        (W, 0) for a model without memory.

        Worlds lead in the shape, not necessarily in memory: a permuted view is as good.
        """

    def reset(self, state: torch.Tensor, begun: torch.Tensor) -> torch.Tensor:
        """The state with the worlds in begun, bool (W,), as `initial_state` has them;
        the others to the bit as they were."""
        import torch

        mask = begun.view(-1, *(1,) * (state.ndim - 1))
        return torch.where(mask, self.initial_state(len(begun)), state)

    def steps(self, inputs: torch.Tensor, state: torch.Tensor, ended: torch.Tensor) -> tuple[Prediction, torch.Tensor]:
        """`step` T times, then `reset` where an episode ended with the step:
        inputs (T, W, F), ended bool (T, W) -> (T, W).

        A model that can do it faster overrides this, to the same bits.
        """
        import torch

        found = []
        for now, over in zip(inputs, ended, strict=True):
            prediction, state = self.step(now, state)
            state = self.reset(state, over)
            found.append(prediction)
        means, spreads = [one.mean for one in found], [one.std for one in found]
        known = [spread for spread in spreads if spread is not None]
        return Prediction(torch.stack(means), torch.stack(known) if known else None), state

    @property
    def settles(self) -> bool:
        """Whether the reward in the env looks at `settled` instead of `step`. By default it does not."""
        return False

    def settled(self, inputs: torch.Tensor) -> Prediction:
        """What the target would settle at if these inputs stayed: inputs (W, F) in channel units -> (W,).

        For models that know which part of them is the sensor's own delay: the mean over time is that of `step`, but an
        action is paid for when it is taken. Under the same rules as `step`. Only asked where `settles` says so.
        """
        raise NotImplementedError(f"{type(self).__name__} does not tell its sensor's delay from what is measured.")

    @property
    def settles_in_physics_steps(self) -> bool:
        """Whether the reward in the env looks at `settled_over`, where `settles` says that it looks at `settled`: for a
        model that was fitted to what joints did between samples (`hts.measurement.physics_steps`). It reads torque and
        speed of joints alone, and its robot's env keeps physics steps (`ModelContext.physics_steps`)."""
        return False

    def settled_over(self, inputs: torch.Tensor) -> Prediction:
        """`settled` of a control step that was K physics steps: inputs (W, K, F) in channel units -> (W,). By default
        the means over them. Only asked where `settles_in_physics_steps` says so."""
        found = self.settled(inputs.flatten(0, 1))
        mean, std = (None if part is None else part.unflatten(0, inputs.shape[:2]).mean(1) for part in found)
        assert mean is not None
        return Prediction(mean, std)

    def inputs_along(self, recording: Recording) -> torch.Tensor | None:
        """What `sequence` takes of a recording, (T, ...), where that is more than its input channels, (T, F), as they
        are: for a model that was fitted to what joints did between samples. None: these channels."""
        return None

    def outside(self, inputs: torch.Tensor) -> torch.Tensor:
        """Share of the inputs (..., F) outside the range of the data it was fitted to, (...,); NaN is outside.

        0 from a model that does not keep the range.
        """
        return inputs.new_zeros(inputs.shape[:-1])

    def denormalise(self, prediction: torch.Tensor) -> torch.Tensor:
        """From z-scores to the target's unit, any shape."""
        return prediction * self.target_std + self.target_mean

    @abstractmethod
    def tensors(self) -> Mapping[str, torch.Tensor]:
        """All that was fitted, by name: what a file holds. Names and shapes follow from settings and signals."""

    @abstractmethod
    def load_tensors(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Take over what `tensors` gave; names and shapes have been checked.
        The model then predicts as that one did."""

    @abstractmethod
    def to(self, device: torch.device | str) -> MeasurementModel:
        """Move everything there, in place; returns self."""

    @property
    def device(self) -> torch.device:
        """Where its numbers are."""
        return self.target_mean.device


MODEL = "model"
"""The key under `objectives.NAME` that chooses a measurement model. The core reads it; the objective's own settings do
not have it."""


def own_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """What stands under `objectives.NAME`, without the choice of a model: what the objective's factory gets."""
    return {key: value for key, value in settings.items() if key != MODEL}


def chosen_model(objective: Objective, settings: Mapping[str, Any] | None = None) -> Named:
    """The model of an objective by name, with settings; settings: what stands under `objectives.NAME`.

    `model: NAME` or `model: {name: NAME, …}` choose one; settings without a name, or with that of the objective's own
    model, change the objective's choice. Without the key it is `objective.measurement_model()`. Raises ConfigError.
    """
    default, given = objective.measurement_model(), (settings or {}).get(MODEL)
    if given is None:
        return default
    values = {"name": given} if isinstance(given, str) else given
    if not isinstance(values, Mapping) or not isinstance(values.get("name", ""), str) or values.get("name") == "":
        raise ConfigError(
            f"objectives.{objective.name}.{MODEL}: expected the name of a measurement model, or its settings with the "
            f"name among them, found {given!r}. `hts plugins` lists the models."
        )
    if values.get("name", default.name) != default.name:
        return Named(**values)
    return Named(**{"name": default.name, **default.settings, **values})


def physics_steps_of(robot: Robot) -> int:
    """In how many physics steps a robot's training env takes a control step and tells what they were like, or 0."""
    return robot.spec.substeps if robot.keeps_physics_steps else 0


def robot_signals(objective: Objective, robot: Robot) -> Signals:
    """What a model of the objective reads and predicts, as the robot's channels have it. Raises ConfigError for one
    that it does not give."""
    known: Mapping[str, Channel] = robot.channels()
    for name in objective.inputs:
        if name not in known:
            raise ConfigError(
                f"Objective '{objective.name}' reads '{name}': "
                + unknown_name(f"channel of robot '{robot.spec.name}'", name, known)
            )
    return Signals(tuple(known[name] for name in objective.inputs), objective.target, robot.spec.control_rate_hz)
