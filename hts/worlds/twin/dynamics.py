"""W robots at 1 kHz: actuation delay, position control, motor limits, gear friction, physics, instruments.

    tau_c   = kp (target - q) - kd q'                      what the firmware asks of the motor
    tau_m   = (1 + e) clip(tau_c, +-limit(q'))             what the current makes, seen at the joint
    tau     = tau_m - clip(s q', +-mu |tau_m|)             after load-dependent gear friction; dry and viscous
                                                           friction and armature are in the MuJoCo model

The friction's slope s near zero speed is half of armature / dt: the steepest that an explicit step cannot
overshoot with, so it saturates below 0.3 rad/s at full load. All arrays are (W, J) unless stated.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

import mujoco
import numpy as np
from mujoco import rollout

from hts.contracts import Instrument, PhysicsSample
from hts.worlds.twin.model import Machine
from hts.worlds.twin.parameters import DynamicsParameters

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS.value


class Dynamics:
    """The bodies and drives of W equal robots, each on its own floor."""

    def __init__(self, machine: Machine, parameters: DynamicsParameters, num_worlds: int, threads: int = 0) -> None:
        self.machine, self.num_worlds = machine, num_worlds
        model, spec = machine.model, machine.spec
        self.dt = parameters.physics_dt
        self.delay_steps = round(parameters.actuation_delay / self.dt)
        self._threads = min(threads or os.cpu_count() or 1, num_worlds)
        self._pool = rollout.Rollout(nthread=self._threads if self._threads > 1 else 0)
        self._models = [model] * num_worlds
        self._data = [mujoco.MjData(model) for _ in range(self._threads)]

        size = mujoco.mj_stateSize(model, FULL)
        self._state = np.zeros((num_worlds, 1, size))
        flat = self._state.reshape(num_worlds, size)
        self.time = flat[:, 0]
        self.qpos = flat[:, 1 : 1 + model.nq]
        self.qvel = flat[:, 1 + model.nq : 1 + model.nq + model.nv]
        self._sensordata = np.zeros((num_worlds, 1, model.nsensordata))
        self._control = np.zeros((num_worlds, 1, model.nu))
        self._acceleration = np.zeros((num_worlds, model.nv))  # of the last step: warm start of the contact solver
        self._before = np.zeros((num_worlds, model.nv))
        sensors = self._sensordata.reshape(num_worlds, -1)
        self.foot_force, self._foot_velocity = sensors[:, machine.touch], sensors[:, machine.foot_velocity]

        joints = (num_worlds, spec.num_joints)
        self._gain_scale = parameters.gain_scale
        self.set_gains(np.array(spec.kp), np.array(spec.kd))
        limit, no_load = np.array(spec.torque_limit), np.array(spec.velocity_limit)
        # Motoring torque falls linearly from the knee speed to nothing at no-load speed: limit = a - b |q'|.
        self._limit = limit
        fall = no_load * (1 - parameters.full_torque_speed)
        self._sloped = parameters.full_torque_speed < 1
        self._limit_slope = limit / np.where(fall > 0, fall, 1)
        self._limit_start = limit * np.where(fall > 0, no_load / np.where(fall > 0, fall, 1), 1)
        self._strength = 1 + parameters.torque_constant_error
        self._offset = machine.encoder_offset
        self._loss = machine.gear_loss
        self._loss_slope = 0.5 * model.dof_armature[machine.joint_dof] / self.dt
        self.commanded_torque = np.zeros(joints)  # what the firmware believes to make, N·m
        self._motor, self._friction = np.zeros(joints), np.zeros(joints)
        self._upper, self._lower, self._scratch = np.zeros(joints), np.zeros(joints), np.zeros(joints)
        self._target = np.tile(np.array(spec.default_pose), (num_worlds, 1))
        self._clock = 0.0
        self._arriving: list[tuple[int, np.ndarray]] = []
        self._sample = PhysicsSample(
            motor_torque=self._motor,
            joint_velocity=self._before[:, machine.joint_dof],
            foot_force=self.foot_force,
            foot_speed=np.zeros((num_worlds, len(spec.foot_sites))),
            foot_mass=np.tile(machine.foot_mass, (num_worlds, 1)),
            dt=self.dt,
        )
        self.stand(np.ones(num_worlds, dtype=bool))

    def set_gains(self, kp: np.ndarray, kd: np.ndarray) -> None:
        """Gains of the position control, N·m/rad and N·m·s/rad, (J,) or (W, J)."""
        shape = (self.num_worlds, self.machine.spec.num_joints)
        self._kp, self._kd = (np.array(np.broadcast_to(gain * self._gain_scale, shape)) for gain in (kp, kd))

    def stand(self, mask: np.ndarray) -> None:
        """Stand the robots of the mask (W,) up in the default pose, keeping place and heading."""
        place, heading = self.qpos[mask, :2].copy(), self.heading()[mask]
        self.qpos[mask] = self.machine.standing
        self.qpos[mask, :2] = place
        self.qpos[mask, 3], self.qpos[mask, 6] = np.cos(heading / 2), np.sin(heading / 2)
        self.qvel[mask] = 0
        self.time[mask] = self._clock
        self._acceleration[mask] = 0
        self.commanded_torque[mask] = 0
        self._target[mask] = self.machine.spec.default_pose
        for _, target in self._arriving:
            target[mask] = self.machine.spec.default_pose

    def heading(self) -> np.ndarray:
        """Direction of the trunk's x axis seen from above, rad (W,)."""
        w, x, y, z = self.qpos[:, 3:7].T
        return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))

    def joint_position(self) -> np.ndarray:
        """As the encoders have it, with their zero error, rad."""
        return self.qpos[:, self.machine.joint_qpos] + self._offset

    def joint_velocity(self) -> np.ndarray:
        return self.qvel[:, self.machine.joint_dof]

    def to_trunk(self, vectors: np.ndarray) -> np.ndarray:
        """World-frame vectors (W, 3) in the trunk frame."""
        w, x, y, z = self.qpos[:, 3:7].T
        rotation = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
            [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
            [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip
        return np.einsum("ijw,wj->wi", rotation, vectors)

    def advance(self, targets: np.ndarray, steps: int, instruments: Sequence[Instrument]) -> None:
        """Send joint targets (W, J), rad, and let `steps` physics steps pass; targets act after the delay.

        Instruments get one `PhysicsSample` per step; its arrays are overwritten by the next step.
        """
        self._arriving.append((self.delay_steps, np.array(targets, dtype=float)))
        for _ in range(steps):
            while self._arriving and self._arriving[0][0] <= 0:
                self._target[:] = self._arriving.pop(0)[1]
            self._arriving = [(left - 1, target) for left, target in self._arriving]
            self._step(instruments)
        self._clock += steps * self.dt

    def diverged(self) -> np.ndarray:
        """Worlds (W,) whose physics broke down: the engine keeps them finite and stops their clock."""
        return self.time < self._clock - 0.5 * self.dt

    def close(self) -> None:
        self._pool.close()

    def _step(self, instruments: Sequence[Instrument]) -> None:
        """One physics step. Written for speed: every line costs about a microsecond for W = 6."""
        m = self.machine
        self._before[:] = self.qvel
        velocity, torque, scratch = self._before[:, m.joint_dof], self.commanded_torque, self._scratch
        np.subtract(self._target, self.qpos[:, m.joint_qpos], out=torque)
        torque -= self._offset
        torque *= self._kp
        np.multiply(velocity, self._kd, out=scratch)
        torque -= scratch
        if self._sloped:
            np.multiply(velocity, self._limit_slope, out=scratch)
            np.subtract(self._limit_start, scratch, out=self._upper)
            np.add(self._limit_start, scratch, out=self._lower)
            np.negative(self._lower, out=self._lower)
            # Braking torque stays full; past no-load speed motoring torque is nothing, never a brake.
            np.minimum(torque, np.maximum(self._upper, 0, out=self._upper), out=torque)
            np.maximum(torque, np.minimum(self._lower, 0, out=self._lower), out=torque)
        np.minimum(torque, self._limit, out=torque)
        np.maximum(torque, -self._limit, out=torque)
        np.multiply(torque, self._strength, out=self._motor)

        np.abs(self._motor, out=scratch)
        scratch *= self._loss
        np.multiply(velocity, self._loss_slope, out=self._friction)
        np.minimum(self._friction, scratch, out=self._friction)
        np.negative(scratch, out=scratch)
        np.maximum(self._friction, scratch, out=self._friction)
        np.subtract(self._motor, self._friction, out=self._control[:, 0])

        flat = self._state[:, 0]
        self._pool.rollout(
            self._models, self._data, flat, self._control, skip_checks=True, nstep=1,
            initial_warmstart=self._acceleration, state=self._state, sensordata=self._sensordata,
        )  # fmt: skip
        np.subtract(self.qvel, self._before, out=self._acceleration)
        self._acceleration /= self.dt
        if instruments:
            sample = self._sample
            sample.joint_velocity = velocity
            np.negative(self._foot_velocity, out=sample.foot_speed)
            for instrument in instruments:
                instrument.step(sample)
