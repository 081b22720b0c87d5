"""The exact measurement as reward in the training simulation: what a measurement model that never errs would pay.

The reality's own instruments look at every physics step of the simulation and tell the real channel without noise,
filter and delay. What its motors make of their currents, and how far the firmware is off about that, is the reality's
too: a robot reports torque by its currents, so that is what a torque of the simulation stands for, as it does for a
fitted model. Dynamics, floor and sensors are the simulation's, as in `hts run`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from tensordict.utils import NestedKey
from torch import Tensor

from hts.channels import SUBSTEP_FORCE, SUBSTEP_TORQUE, SUBSTEP_VELOCITY
from hts.contracts import Instrument, MeasurementModel, Objective, PhysicsSample, Robot, RobotSpec, Settings
from hts.errors import UnfitWorldError, WorldError
from hts.guarded import guarded
from hts.measurement.data import gather
from hts.measurement.transform import Measured
from hts.plugins import Registry
from hts.worlds.twin.drives import Motors
from hts.worlds.twin.instruments import maker
from hts.worlds.twin.parameters import TwinSettings, resolved_settings

CHANNELS = (SUBSTEP_TORQUE, SUBSTEP_VELOCITY, SUBSTEP_FORCE)
"""What a physics sample is made of."""
SETTLE_SECONDS = 10.0
"""Then heat becomes that of the walk so far, once, as in the warm-up of a head-to-head: candidates are judged after so
long a trimming, and in training it goes on from there as it goes."""
TRIED = 3  # robots that instruments are tried on; no likely size of a channel, so that no shape fits by chance


@dataclass(frozen=True)
class Seeing:
    """What of a reality looks at the simulation. make: fresh instruments; strength: torque that is made for one that
    the firmware commands, with the common torque constant; motors: what they make of that."""

    make: Callable[[], Mapping[str, Instrument]]
    strength: float
    motors: Motors
    spec: RobotSpec

    @classmethod
    def of(cls, robot: Robot, world: Settings, objectives: Mapping[str, Settings], registry: Registry) -> Seeing:
        """Of the reality that a world's settings name. Raises ConfigError for settings that are wrong."""
        settings = resolved_settings(TwinSettings.model_validate(dict(world)), robot.spec.name)
        body = settings.dynamics
        strength = 1 + body.torque_constant_error
        motors = Motors.of(body.structure, body.machine, strength * np.array(robot.spec.torque_limit))
        return cls(maker(registry, robot, objectives, settings), strength, motors, robot.spec)


class SimulatedInstruments:
    """A reality's instruments on the W robots of one candidate. They draw the same for every candidate.

    landing: stands for the speed (m/s) and mass (kg) of feet that touch down, which no channel tells.
    """

    def __init__(self, seeing: Seeing, worlds: int, landing: float = np.nan) -> None:
        self._made, self._seeing, self._spec = seeing.make(), seeing, seeing.spec
        self._landing = np.full((self._spec.substeps, worlds, len(self._spec.foot_sites)), landing)
        self._period = self._spec.substeps * self._spec.physics_dt
        self._steps, self._settled = 0, False
        for name, instrument in self._made.items():
            guarded(f"Instrument '{name}'", partial(instrument.reset, worlds, np.random.default_rng(0)))

    def see(self, recorded: Tensor) -> dict[str, np.ndarray]:
        """One control step, CHANNELS side by side (W, K (2 J + F)); returns the exact real channels, name -> (W, ...),
        means over the step."""
        spec, rows = self._spec, recorded.cpu().double().numpy()
        joints = spec.substeps * spec.num_joints
        torque, velocity, force = (
            np.ascontiguousarray(part.reshape(len(rows), spec.substeps, -1).swapaxes(0, 1))
            for part in np.split(rows, (joints, 2 * joints), axis=1)
        )
        current = self._seeing.strength * torque
        made = self._seeing.motors.torque(current)
        sample = PhysicsSample(made, velocity, force, self._landing, self._landing, spec.physics_dt, current)
        told: dict[str, np.ndarray] = {}
        for name, instrument in self._made.items():
            told |= guarded(f"Instrument '{name}'", partial(_passed, instrument, sample))
        self._steps += 1
        if not self._settled and self._steps * self._period >= SETTLE_SECONDS:
            self._settled = True
            for instrument in self._made.values():
                with suppress(WorldError):  # it has no steady heat, and warms up as it goes
                    instrument.settle()
        return told


def _passed(instrument: Instrument, sample: PhysicsSample) -> Mapping[str, np.ndarray]:
    instrument.advance(sample)
    return instrument.exact()


class ExactMeasurement(Measured):
    """r_real = objective.reward(z), per second, z the exact target in the fitted model's mean and standard deviation.

    In the place of that model's `MeasurementTransform`: what it writes means the same, so λ, promises and whatever else
    was made for the model hold. Instruments compute on the host, so it waits for a GPU; heat and charge are in no state
    dict.
    """

    def __init__(self, objective: Objective, model: MeasurementModel, seeing: Seeing) -> None:
        target = objective.target.name
        super().__init__(CHANNELS, (("measured", target), ("real_reward", objective.name)))
        self._objective, self._target, self._seeing = objective, target, seeing
        self._mean, self._std = float(model.target_mean), float(model.target_std)
        self._candidates = 1
        self._instruments: list[SimulatedInstruments] = []

    @property
    def savable(self) -> bool:
        """False: instruments keep heat and charge to themselves."""
        return False

    def record(self, channels: Mapping[str, Tensor]) -> Tensor:
        """CHANNELS side by side, (P·N, K (2 J + F))."""
        shape = channels[self.inputs[0]].shape[:2]
        self._candidates = shape[0]
        return gather(channels, self.inputs, shape.numel())

    def evaluate(self, recorded: Tensor) -> dict[NestedKey, Tensor]:
        parts = recorded.chunk(self._candidates)
        if not self._instruments:
            self._instruments = [SimulatedInstruments(self._seeing, len(part)) for part in parts]
        found = [one.see(part)[self._target] for one, part in zip(self._instruments, parts, strict=True)]
        told = torch.from_numpy(np.concatenate(found)).reshape(-1, 1)
        measured, real_reward = self.out_keys
        score = ((told - self._mean) / self._std).to(recorded)
        return {measured: score, real_reward: self._objective.reward(score)}


def check_exact(seeing: Seeing, objectives: Mapping[str, Objective]) -> None:
    """Raise UnfitWorldError for an objective whose channel no instrument tells exactly from CHANNELS alone."""
    spec = seeing.spec
    hanging = torch.zeros(TRIED, spec.substeps * (2 * spec.num_joints + len(spec.foot_sites)))
    landed = hanging.clone()
    landed[:, 2 * spec.substeps * spec.num_joints :] = 50.0  # N under each foot
    softly, hard = (
        [seen.see(channels) for channels in (hanging, landed, landed)]
        for seen in (SimulatedInstruments(seeing, TRIED, landing) for landing in (0.1, 1.0))
    )
    for name, objective in objectives.items():
        target = objective.target.name
        if target not in softly[0]:
            raise UnfitWorldError(
                f"Objective '{name}': no instrument of this reality tells '{target}' exactly (`Instrument.exact`), so "
                "nothing can stand for a measurement model that never errs. `hts run` needs none, nor does `hts "
                "oracle` without --in-simulation."
            )
        for told in (one[target] for one in softly):
            if np.shape(told) != (TRIED,) or not np.isfinite(told).all():
                raise UnfitWorldError(
                    f"Objective '{name}': its instrument tells '{target}' exactly as {np.asarray(told).tolist()} for "
                    f"{TRIED} robots that stand still; expected a finite number for each. Correct its `exact`."
                )
        if any(not np.array_equal(one[target], other[target]) for one, other in zip(softly, hard, strict=True)):
            raise UnfitWorldError(
                f"Objective '{name}': '{target}' depends on how fast and with what mass feet land, which no channel of "
                "the training simulation tells. `hts oracle` without --in-simulation trains on the reality."
            )
