"""A target and inputs named on the command line, as an objective that can be fitted and no more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from hts.config import Named
from hts.contracts import Comparison, Objective
from hts.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from hts.channels import Channel
    from hts.evaluation.segments import Segments


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
