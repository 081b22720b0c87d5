"""What is to be predicted from a store: an objective's target from its inputs, or a channel from channels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hts.errors import ConfigError, RecordingError, unknown_name
from hts.measurement.plain import Plain

if TYPE_CHECKING:
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
        return objective if objective is not None else str(self.target)


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
