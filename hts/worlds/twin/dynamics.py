"""W robots at 1 kHz: actuation delay, position control, motor limits, gear friction, physics, instruments.

    tau_c   = clip(kp (target - q) - kd q', +-limit(q'))   what the firmware asks of the motor
    tau_m   = (1 + e) tau_c                                what the current makes, seen at the joint
    tau     = tau_m - clip(s q', +-mu |tau_m|)             after load-dependent gear friction; dry and viscous
                                                           friction and armature are in the MuJoCo model

The friction's slope s near zero speed is half of armature / dt: the steepest that an explicit step cannot
overshoot with, so it saturates below 0.3 rad/s at full load. All arrays are (W, J) unless stated.

A step is written down twice, with the same results to the last bit: compiled, in kernel.py, which is what runs; and
with numpy, in `_step`, for machines that cannot compile, and to hold the other against.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout

from hts.contracts import Instrument, PhysicsSample
from hts.worlds.twin import compiled
from hts.worlds.twin.drives import Drives, makes_a_difference
from hts.worlds.twin.ground import PERIOD, Conditions, Wind, gravity
from hts.worlds.twin.link import Link
from hts.worlds.twin.model import Machine
from hts.worlds.twin.parameters import DynamicsParameters
from hts.worlds.twin.structure import SessionParameters

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
CONTROL, FORCE = mujoco.mjtState.mjSTATE_CTRL.value, mujoco.mjtState.mjSTATE_QFRC_APPLIED.value


class Dynamics:
    """The bodies and drives of W equal robots, each on its own floor.

    conditions: how their sessions differ; None: not at all. rng: of jitter, lost packets and gusts.
    """

    def __init__(
        self,
        machine: Machine,
        parameters: DynamicsParameters,
        num_worlds: int,
        conditions: Conditions | None = None,
        rng: np.random.Generator | None = None,
    ) -> None:
        self.machine, self.num_worlds = machine, num_worlds
        model, spec = machine.model, machine.spec
        rng = rng if rng is not None else np.random.default_rng(0)
        conditions = conditions or Conditions.drawn(SessionParameters(), num_worlds, rng)
        self.structure = parameters.structure
        self.dt = parameters.physics_dt
        self._rollout = rollout.Rollout(nthread=0)  # on the calling thread
        self._models, self._data = [model] * num_worlds, [mujoco.MjData(model)]
        self.down: np.ndarray | None = None  # direction of gravity on a sloping floor, (W, 3)
        self._lie_of_the_land(conditions)

        size = mujoco.mj_stateSize(model, FULL)
        self._state = np.zeros((num_worlds, 1, size))
        flat = self._state.reshape(num_worlds, size)
        self.time = flat[:, 0]
        self.qpos = flat[:, 1 : 1 + model.nq]
        self.qvel = flat[:, 1 + model.nq : 1 + model.nq + model.nv]
        self._sensordata = np.zeros((num_worlds, 1, model.nsensordata))
        self._wind = Wind(self.structure, conditions.wind_direction, rng) if self.structure.wind_force > 0 else None
        self._spec = (CONTROL | FORCE) if self._wind else CONTROL  # a state is laid out in the order of mjtState
        self._inputs = np.zeros((num_worlds, 1, model.nu + (model.nv if self._wind else 0)))
        self._control, self._force = self._inputs[..., : model.nu], self._inputs[:, 0, model.nu :]
        self._acceleration = np.zeros((num_worlds, model.nv))  # of the last step: warm start of the contact solver
        self._before = np.zeros((num_worlds, model.nv))
        self.sensordata = sensors = self._sensordata.reshape(num_worlds, -1)
        self.foot_force, self._foot_velocity = sensors[:, machine.touch], sensors[:, machine.foot_velocity]

        joints = (num_worlds, spec.num_joints)
        # The motor's torque constant is off by a factor that the firmware does not know of: everything it commands,
        # gains and limits alike, comes out so much larger.
        self._strength = 1 + parameters.torque_constant_error
        self._gain_scale = parameters.gain_scale
        limit, no_load = self._strength * np.array(spec.torque_limit), np.array(spec.velocity_limit)
        # Motoring torque falls linearly from the knee speed to nothing at no-load speed: a - b q' forwards,
        # a + b q' backwards, at most the limit. Braking torque stays full.
        fall = np.maximum(1 - parameters.full_torque_speed, 1e-6)
        self._limit = limit
        self._limit_start = limit / fall
        self._rated_slope = np.stack([limit / (fall * no_load), -limit / (fall * no_load)])[:, None]  # (2, 1, J)
        self._limit_slope = np.tile(self._rated_slope, (1, num_worlds, 1))
        self._limits = np.zeros((2, *joints))
        serial = parameters.machine
        self._drives: Drives | None = None
        if makes_a_difference(self.structure):
            self._drives = Drives(machine, self.structure, serial, limit, self.dt, num_worlds)
        self._loss = machine.gear_loss
        self._loss_slope = 0.5 * model.dof_armature[machine.joint_dof] / self.dt
        self._motor, self._friction, self._scratch = np.zeros(joints), np.zeros(joints), np.zeros(joints)
        self._current = np.zeros(joints) if self._drives else self._motor  # torque that it would make, were K nominal
        self._target = np.tile(np.array(spec.default_pose), (num_worlds, 1))
        self._kp, self._kd, self._pull = np.zeros(joints), np.zeros(joints), np.zeros(joints)
        self.set_gains(np.array(spec.kp), np.array(spec.kd))
        self._clock = 0.0
        self._link = Link(round(parameters.actuation_delay / self.dt), self.structure, self.dt, num_worlds, rng)
        self._sample = PhysicsSample(
            motor_torque=self._motor,
            joint_velocity=self._before[:, machine.joint_dof],
            foot_force=self.foot_force,
            foot_speed=np.zeros((num_worlds, len(spec.foot_sites))),
            foot_mass=np.tile(machine.foot_mass, (num_worlds, 1)),
            dt=self.dt,
            current_torque=self._current if self._drives else None,
        )
        self._compiled = compiled.load()
        if self._compiled is not None:
            self._arguments = self._all_that_steps_take()
        self._samples: PhysicsSample | None = None
        self.stand(np.ones(num_worlds, dtype=bool))

    def set_gains(self, kp: np.ndarray, kd: np.ndarray) -> None:
        """Gains of the position control, N·m/rad and N·m·s/rad, (J,) or (W, J)."""
        scale = self._strength * self._gain_scale
        self._kp[:], self._kd[:] = kp * scale, kd * scale
        self._aim()

    def _aim(self) -> None:
        """kp (target - encoder offset), which changes with the target only."""
        np.multiply(self._kp, self._target - self.machine.encoder_offset, out=self._pull)

    @property
    def commanded_torque(self) -> np.ndarray:
        """What the firmware believes that its motors make, N·m."""
        return self._current / self._strength

    def set_supply(self, ratio: np.ndarray) -> None:
        """Voltage of the motors' supply as a share of the rated one (W,): no-load speed is proportional to it."""
        np.divide(self._rated_slope, np.maximum(ratio, 0.1)[:, None], out=self._limit_slope)

    def stand(self, mask: np.ndarray) -> None:
        """Stand the robots of the mask (W,) up in the default pose, keeping place and heading."""
        place, heading = self.qpos[mask, :2].copy(), self.heading()[mask]
        self.qpos[mask] = self.machine.standing
        self.qpos[mask, :2] = place
        self.qpos[mask, 3], self.qpos[mask, 6] = np.cos(heading / 2), np.sin(heading / 2)
        self.qpos[mask, 2] += self.structure.floor_roughness  # over the highest bump
        self.qvel[mask] = 0
        self.time[mask] = self._clock
        self._acceleration[mask] = 0
        self._motor[mask] = self._current[mask] = 0
        self._target[mask] = self.machine.spec.default_pose
        self._link.replace(mask, np.array(self.machine.spec.default_pose))
        if self._drives:
            self._drives.play[mask] = 0
        self._aim()

    def heading(self) -> np.ndarray:
        """Direction of the trunk's x axis seen from above, rad (W,)."""
        w, x, y, z = self.qpos[:, 3:7].T
        return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    def joint_position(self) -> np.ndarray:
        """As the encoders have it, with their zero error, rad."""
        seen = self.qpos[:, self.machine.joint_qpos] + self.machine.encoder_offset
        return seen + self._drives.play if self._drives else seen

    def joint_velocity(self) -> np.ndarray:
        return self.qvel[:, self.machine.joint_dof]

    def rotation(self) -> np.ndarray:
        """World to trunk, (W, 3, 3)."""
        if self._compiled is not None:
            rows = np.empty((9, self.num_worlds))
            self._compiled.rotate(self._state[:, 0], 4, rows)  # after time and place
            return rows.T.reshape(-1, 3, 3)
        w, x, y, z = self.qpos[:, 3:7].T
        rows = np.array([
            1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y),
            2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x),
            2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y),
        ])  # fmt: skip
        return rows.T.reshape(-1, 3, 3)

    def advance(self, targets: np.ndarray | None, steps: int, instruments: Sequence[Instrument]) -> None:
        """Send joint targets (W, J), rad, and let `steps` physics steps pass; targets act after the delay. None:
        nothing is sent, what was sent last holds.

        Instruments get a `PhysicsSample` of all the steps; its arrays are overwritten by the next.
        """
        if targets is not None:
            self._link.send(targets)
        if self._wind:
            self._force[:, :2] = self._wind.blow(steps * self.dt)
        if self._compiled is not None:
            self._run(self._compiled.advance, steps, instruments)
        else:
            for _ in range(steps):
                if self._link.receive(self._target):
                    self._aim()
                self._step(instruments)
        self._clock += steps * self.dt
        if self.structure.floor_roughness > 0:  # the bumps repeat
            place = self.qpos[:, :2]
            place -= PERIOD * np.rint(place / PERIOD)

    def diverged(self) -> np.ndarray:
        """Worlds (W,) whose physics broke down: the engine keeps them finite and stops their clock."""
        return self.time < self._clock - 0.5 * self.dt

    def close(self) -> None:
        """Let go of the engine's memory."""
        self._rollout.close()

    def _lie_of_the_land(self, conditions: Conditions) -> None:
        """Slope and grip of each robot's floor, where they differ from session to session."""
        sloping = self.structure.floor_slope > 0
        if not sloping and (conditions.friction == 1).all():
            return
        model = self.machine.model
        strength = float(np.linalg.norm(model.opt.gravity))
        floor = model.geom_bodyid == 0
        self._models = [copy.copy(model) for _ in range(self.num_worlds)]
        for own, grip, direction in zip(self._models, conditions.friction, conditions.slope_direction, strict=True):
            own.geom_friction[floor, 0] *= grip
            own.opt.gravity[:] = gravity(self.structure, direction, strength)
        if sloping:
            self.down = np.stack([own.opt.gravity / strength for own in self._models])

    def _run(self, advance: Callable[..., None], steps: int, instruments: Sequence[Instrument]) -> None:
        """So many physics steps, compiled."""
        samples, drives, link = self._room_for(steps), self._drives, self._link
        at_once = 1 if drives and drives.sticks else steps
        for first in range(0, steps, at_once):
            if drives and drives.sticks:
                self._stiction[:] = drives.stiction(self.joint_velocity())
            advance(first, first + at_once, link.now, self.dt, link.arrivals, link.sent, *self._arguments, *self._log)
        link.now += steps
        for instrument in instruments:
            instrument.advance(samples)

    def _room_for(self, steps: int) -> PhysicsSample:
        """What instruments see of so many steps, (K, W, J) and (K, W, F), for `advance` to write into."""
        if self._samples is None or len(self._samples.motor_torque) != steps:
            joints = (steps, *self._motor.shape)
            feet = (steps, *self._sample.foot_speed.shape)
            self._log = (*(np.zeros(joints) for _ in range(3)), *(np.zeros(feet) for _ in range(2)))
            motor, current, velocity, force, speed = self._log
            mass = np.broadcast_to(self._sample.foot_mass, feet)
            current_torque = current if self._drives else None
            self._samples = PhysicsSample(motor, velocity, force, speed, mass, self.dt, current_torque)
        return self._samples

    def _all_that_steps_take(self) -> tuple[Any, ...]:
        """Arguments of `kernel.advance` that are always the same arrays and numbers."""
        m, model, drives, data = self.machine, self.machine.model, self._drives, self._data[0]
        joints, nothing = np.zeros(m.spec.num_joints), np.zeros((0, 0))
        self._stiction = np.zeros_like(self._motor)
        of_drives: tuple[Any, ...] = (joints, joints, 0.0, 0.0, nothing)
        if drives:
            of_drives = (drives.motors.constant, drives.motors.saturation, drives.half, drives.rate, drives.play)
        state, inputs = self._state[:, 0], self._inputs[:, 0]
        places = [
            np.arange(width)[columns] + offset
            for width, columns, offset in (
                (model.nq, m.joint_qpos, 1),
                (model.nv, m.joint_dof, 1 + model.nq),
                (model.nsensordata, m.touch, 0),
                (model.nsensordata, m.foot_velocity, 0),
            )
        ]
        return (
            *(self._target, self._pull, m.encoder_offset),
            *(self._kp, self._kd, self._limit, self._limit_start, self._limit_slope),
            *(drives is not None, *of_drives, self._stiction),
            *(np.array(m.gear_loss), np.array(self._loss_slope), self._motor, self._current),
            np.array([own._address for own in self._models]),
            *(data._address, FULL, self._spec, data.qacc_warmstart, data.sensordata),
            *(state, inputs, self._acceleration, self.sensordata, 1 + model.nq, *places),
        )

    def _step(self, instruments: Sequence[Instrument]) -> None:
        """One physics step. Written for speed: every line costs about a microsecond for W = 6."""
        m, drives = self.machine, self._drives
        self._before[:] = self.qvel
        velocity, torque, scratch, limits = self._before[:, m.joint_dof], self._current, self._scratch, self._limits
        np.multiply(self.qpos[:, m.joint_qpos], self._kp, out=torque)
        np.subtract(self._pull, torque, out=torque)
        if drives:
            np.multiply(drives.play, self._kp, out=scratch)
            np.subtract(torque, scratch, out=torque)
        np.multiply(velocity, self._kd, out=scratch)
        np.subtract(torque, scratch, out=torque)
        np.multiply(velocity, self._limit_slope, out=limits)
        np.subtract(self._limit_start, limits, out=limits)
        np.minimum(limits, self._limit, out=limits)
        np.maximum(
            limits, 0, out=limits
        )  # past no-load speed a motor has no torque forwards; it does not brake by itself
        np.minimum(torque, limits[0], out=torque)
        np.negative(limits[1], out=scratch)
        np.maximum(torque, scratch, out=torque)

        if drives:
            self._motor[:] = drives.motors.torque(torque)
            torque = self._motor
            drives.cross(torque)
        np.abs(torque, out=scratch)
        np.multiply(scratch, self._loss, out=scratch)
        if drives:
            scratch += drives.stiction(velocity)
        np.multiply(velocity, self._loss_slope, out=self._friction)
        np.minimum(self._friction, scratch, out=self._friction)
        np.negative(scratch, out=scratch)
        np.maximum(self._friction, scratch, out=self._friction)
        np.subtract(torque, self._friction, out=self._control[:, 0])

        flat = self._state[:, 0]
        self._rollout.rollout(
            self._models,
            self._data,
            flat,
            self._inputs,
            control_spec=self._spec,
            skip_checks=True,
            nstep=1,
            initial_warmstart=self._acceleration,
            state=self._state,
            sensordata=self._sensordata,
        )
        np.subtract(self.qvel, self._before, out=self._acceleration)
        self._acceleration /= self.dt
        if instruments:
            sample = self._sample
            sample.joint_velocity = velocity
            np.negative(self._foot_velocity, out=sample.foot_speed)
            for instrument in instruments:
                instrument.step(sample)
