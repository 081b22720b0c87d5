"""What is to be predicted from a store: an objective's target from its inputs, or a channel from channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hts.config import Named
from hts.contracts import Comparison, Objective
from hts.errors import ConfigError, RecordingError, unknown_name

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from hts.channels import Channel
    from hts.evaluation.segments import Segments
    from hts.recordings.store import RecordingStore


@dataclass(frozen=True)
class Wanted:
    """What is predicted where no objective is named: `target` from `inputs`. robot: only its recordings."""

    target: str | None = None
    inputs: tuple[str, ...] = ()
    robot: str | None = None

    def name(self, objective: str | None) -> str:
        """Of what is predicted: the objective's, or the channel's. Raises ConfigError if neither is said, or both."""
        if objective is None and self.target is None:
            raise ConfigError("Say what to predict: --objective NAME, or --target CHANNEL with --input CHANNEL.")
        if objective is not None and (self.target is not None or self.inputs):
            raise ConfigError("--target and --input go without an objective: leave them out, or --objective.")
        if objective is None and not self.inputs:
            raise ConfigError(f"--target {self.target}: say what to predict it from, --input CHANNEL for each channel.")
        if twice := [name for number, name in enumerate(self.inputs) if name in self.inputs[:number]]:
            raise ConfigError(f"--input {twice[0]}: is there twice, expected each channel once. Leave one out.")
        return objective if objective is not None else str(self.target)


class Plain(Objective):
    """Predict `target` from `inputs`; called by the target's name. It has no score, so nothing can be run for it."""

    unit = "1"

    def __init__(self, target: Channel, inputs: Sequence[str]) -> None:
        self.name, self.target, self.inputs = target.name, target, tuple(inputs)

    def measurement_model(self) -> Named:
        return Named(name="linear")

    def reward(self, prediction: Tensor) -> Tensor:
        return -prediction

    def score(self, segments: Segments) -> Mapping[str, np.ndarray]:
        raise self._unscored()

    def compare(self, policy: Mapping[str, float], reference: Mapping[str, float]) -> Comparison:
        raise self._unscored()

    def _unscored(self) -> ConfigError:
        return ConfigError(
            f"'{self.name}' was named as a target alone, so nothing says what counts as better. `hts new objective` "
            "writes an objective that does."
        )


def without_objective(store: RecordingStore, wanted: Wanted) -> Plain:
    """What predicts the wanted channel, as the first recording that has it holds it. Raises RecordingError for a
    channel that none has."""
    known: set[str] = set()
    target = str(wanted.target)
    for recording_id in store.ids():
        arrays = set(store.attributes(recording_id)["arrays"]) - {"time"}
        known |= arrays
        if target in arrays:
            return Plain(store.read(recording_id, [target]).channels[target].channel, wanted.inputs)
    raise RecordingError(f"{store.path}: " + unknown_name("channel", target, known))
