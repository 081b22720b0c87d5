"""The exact measurement as reward in the training simulation: what a measurement model that never errs would pay.

The reality's own instruments look at the simulation's channels, one physics sample a control step, and tell the real
channel without noise, filter and delay. Dynamics, floor and sensors are the simulation's, as in `hts run`; that is all
that such a model could know of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import torch
from tensordict.utils import NestedKey
from torch import Tensor

from hts.contracts import Instrument, MeasurementModel, Objective, PhysicsSample, RobotSpec
from hts.errors import UnfitWorldError, WorldError
from hts.measurement.data import gather
from hts.measurement.transform import Measured
from hts.worlds.oracle.sessions import SETTLE_SECONDS

CHANNELS = ("joint_torque", "joint_velocity", "foot_force")
"""Sim channels that a physics sample is made of."""

Make = Callable[[], Mapping[str, Instrument]]


class SimulatedInstruments:
    """A reality's instruments on W robots of the simulation. Heat becomes steady as in a session of the oracle.

    landing: stands for the speed (m/s) and mass (kg) of feet that touch down, which no channel tells.
    """

    def __init__(self, make: Make, spec: RobotSpec, worlds: int, landing: float = np.nan) -> None:
        self._made, self._joints, feet = make(), spec.num_joints, len(spec.foot_sites)
        self._landing = np.full((worlds, feet), landing)
        self._dt = 1 / spec.control_rate_hz
        self._steps = self._settled = 0
        for instrument in self._made.values():
            instrument.reset(worlds, np.random.default_rng(0))

    def see(self, recorded: Tensor) -> dict[str, np.ndarray]:
        """One control step, CHANNELS side by side (W, 2 J + F); returns the exact real channels, name -> (W, ...)."""
        torque, velocity, force = np.split(recorded.double().numpy(), (self._joints, 2 * self._joints), axis=1)
        sample = PhysicsSample(torque, velocity, force, self._landing, self._landing, self._dt)
        told: dict[str, np.ndarray] = {}
        for instrument in self._made.values():
            instrument.step(sample)
            told |= instrument.exact()
        self._steps += 1
        if self._settled < len(SETTLE_SECONDS) and self._steps * self._dt >= SETTLE_SECONDS[self._settled]:
            self._settled += 1
            self._settle()
        return told

    def _settle(self) -> None:
        for instrument in self._made.values():
            try:
                instrument.settle()
            except WorldError:  # it has no steady heat, and warms up as it goes
                self._settled = len(SETTLE_SECONDS)


class ExactMeasurement(Measured):
    """r_real = objective.reward(z), per second, z the exact target in the fitted model's mean and standard deviation.

    In the place of that model's `MeasurementTransform`: what it writes means the same, so λ, promises and whatever else
    was made for the model hold. On a CPU; heat and charge are not in its state dict.
    """

    def __init__(self, objective: Objective, model: MeasurementModel, make: Make, spec: RobotSpec) -> None:
        target = objective.target.name
        super().__init__(CHANNELS, (("measured", target), ("real_reward", objective.name)))
        self._objective, self._target = objective, target
        self._mean, self._std = float(model.target_mean), float(model.target_std)
        self._make, self._spec = make, spec
        self._instruments: SimulatedInstruments | None = None

    def prepare(self, instances: int, device: torch.device) -> None:
        if self._instruments is None:
            self._instruments = SimulatedInstruments(self._make, self._spec, instances)

    def record(self, channels: Mapping[str, Tensor]) -> Tensor:
        """CHANNELS side by side, (P·N, 2 J + F)."""
        return gather(channels, self.inputs, channels[self.inputs[0]].shape[:2].numel())

    def evaluate(self, recorded: Tensor) -> dict[NestedKey, Tensor]:
        self.prepare(len(recorded), recorded.device)
        assert self._instruments is not None
        told = torch.from_numpy(self._instruments.see(recorded)[self._target]).reshape(-1, 1)
        measured, real_reward = self.out_keys
        score = ((told - self._mean) / self._std).to(recorded)
        return {measured: score, real_reward: self._objective.reward(score)}


def check_exact(make: Make, spec: RobotSpec, objectives: Mapping[str, Objective]) -> None:
    """Raise UnfitWorldError for an objective whose channel no instrument tells exactly from CHANNELS alone."""
    feet = len(spec.foot_sites)
    hanging = torch.zeros(1, 2 * spec.num_joints + feet)
    landed = torch.cat((hanging[:, :-feet], torch.full((1, feet), 50.0)), 1)
    softly, hard = (
        [seen.see(channels) for channels in (hanging, landed, landed)]
        for seen in (SimulatedInstruments(make, spec, 1, landing) for landing in (0.1, 1.0))
    )
    for name, objective in objectives.items():
        target = objective.target.name
        if target not in softly[0]:
            raise UnfitWorldError(
                f"Objective '{name}': no instrument of this reality tells '{target}' exactly (`Instrument.exact`), so "
                "nothing can stand for a measurement model that never errs. Leave --in-simulation out, or take "
                "`hts run`."
            )
        if any(not np.array_equal(one[target], other[target]) for one, other in zip(softly, hard, strict=True)):
            raise UnfitWorldError(
                f"Objective '{name}': '{target}' depends on how feet land, and the training simulation tells only "
                f"{', '.join(CHANNELS)} at each control step. Train on the reality: leave --in-simulation out."
            )
