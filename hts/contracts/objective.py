"""An objective: a measured quantity to improve, its reward and its score."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

from hts.config import Named

if TYPE_CHECKING:
    import numpy as np
    import torch

    from hts.channels import Channel
    from hts.evaluation.segments import Segments
    from hts.recordings.recording import Recording


@dataclass(frozen=True)
class Comparison:
    """A policy against a reference.

    improvement: the objective's primary score, larger is better, in `Objective.unit`;
    selection_score: what `hierarchical` ranks by (same unit); metrics: anything else worth reporting.
    """

    improvement: float
    selection_score: float
    metrics: Mapping[str, float] = field(default_factory=dict)


class Objective(ABC):
    """A real channel to improve.

    name: as registered; unit: of the improvement ("1" for a fraction); inputs: sim channels the model reads;
    target: the real channel that the model predicts, one number a sample; also_measured: further real channels that
    `score` reads, of any shape, such as a voltage beside a current: no model predicts them, but every log and recording
    must have them, and `predicted_channels` says what they would be beside a predicted target; weights: default
    sweep over λ; baseline_weights: the same for the analytic proxy, of `hts baseline`; proxy_weights: of a run that the
    proxy pays (`hts run --reward proxy`): as many as `weights`, so that it trains as much as one that the model pays;
    none: baseline_weights; metric_units: unit of what `score` gives and of metrics of `compare`, by name, for tables
    and figures ("1": a plain number of which ratios mean something). A metric whose name ends in _reduction, _share or
    _fraction needs none: it is shown as per cent.
    """

    name: str
    unit: str
    inputs: tuple[str, ...]
    target: Channel
    also_measured: tuple[Channel, ...] = ()
    weights: tuple[float, ...] = (0.5, 1.0, 5.0)
    baseline_weights: tuple[float, ...] = ()
    proxy_weights: tuple[float, ...] = ()
    metric_units: Mapping[str, str] = MappingProxyType({})
    instrument: str | None = None  # name of the instrument that measures the real channels on a twin

    @property
    def real_channels(self) -> tuple[Channel, ...]:
        """What only the robot gives and this objective needs: the target, then `also_measured`."""
        return (self.target, *self.also_measured)

    def measurement_model(self) -> Named:
        """The measurement model it uses where nobody chose another, by registered name, with settings.

        `objectives.NAME.model` in the configuration chooses; that key is the core's, so an objective's own settings
        have none of that name.
        """
        return Named(name="lstm")

    @abstractmethod
    def reward(self, prediction: torch.Tensor) -> torch.Tensor:
        """r_real of the predicted target in units of its training data's standard deviation
        (prediction is z-scored), per second; any shape in, same shape out."""

    @abstractmethod
    def score(self, segments: Segments) -> Mapping[str, np.ndarray]:
        """Quantities of each 1 s segment, each of shape (segments,)."""

    @abstractmethod
    def compare(self, policy: Mapping[str, float], reference: Mapping[str, float]) -> Comparison:
        """From the means of `score` over a policy's and its reference's segments to one comparison."""

    def weights_for(self, spread: float, recordings: Sequence[Recording]) -> tuple[float, ...]:
        """Its own λ, as many as `weights`, for a model that was just fitted; by default those. Not asked where the
        configuration's `sweep.weights` names them, nor for the analytic proxy.

        spread: standard deviation of the target, in its unit, in the data of the model, which is what λ counts in;
        recordings: that data. Sensors of one quantity show other standard deviations of it, as they average and as
        they are noisy: an objective that knows a measure which they do not change can give λ of one worth for all.
        """
        return self.weights

    def predicted_channels(self, target: np.ndarray, known: Sequence[Recording]) -> Mapping[str, np.ndarray]:
        """Real channels that `score` reads, from the predicted target: for the improvement that a model promises.

        target: in its unit, (S, n), and each channel that is given (S, n, ...); known: the recordings that the model
        was fitted to, from which a rule for further channels may be made. By default the target alone; an objective
        that scores more says how the rest follows.
        """
        return {self.target.name: target}

    @property
    def proxy_in_physics_steps(self) -> bool:
        """Whether `proxy` is asked in each physics step of a control step, and its mean paid: it reads torque and speed
        of joints, and the robot's env keeps physics steps (`Robot.keeps_physics_steps`). By default it is not."""
        return False

    def proxy(self, channels: Mapping[str, torch.Tensor]) -> torch.Tensor | None:
        """The analytic stand-in of the target from sim channels (..., J) -> (...,); None if there is none."""
        return None
