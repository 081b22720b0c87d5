"""The settings of `MeasurementModel.fit`, written once for the models that come with hts."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hts.contracts import MeasurementModel

if TYPE_CHECKING:
    from hts.contracts.measurement_model import Progress
    from hts.recordings.recording import Recording


@dataclass(frozen=True)
class FitSettings:
    """What `MeasurementModel.fit` is called with beside the recordings; see there."""

    seed: int = 0
    epochs: int = 20
    max_seconds: float = math.inf
    progress: Progress | None = None
    warm_start: MeasurementModel | None = None


class Learner(MeasurementModel):
    """A model that writes `learn` in place of `fit`: what every report holds, and the time taken, is put there here."""

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
        began = time.monotonic()
        report = self.learn(recordings, FitSettings(seed, epochs, max_seconds, progress, warm_start))
        return {"recordings": len(recordings), "seed": seed, **report, "seconds": time.monotonic() - began}

    def learn(self, recordings: Sequence[Recording], how: FitSettings) -> dict[str, Any]:
        """Fit to all the recordings, in place. The report, JSON values: samples, epochs, stopped, warm_started,
        validation_r2 (None if nothing varies there) and what else is worth telling; recordings, seed and seconds are
        added to it.
        Raises RecordingError."""
        raise NotImplementedError(f"{type(self).__name__} has neither `learn` nor `fit`.")
