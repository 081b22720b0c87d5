"""The velocity task for one world in NumPy: what the CPU rivals of `compare_cpu.py` step, with gymnasium's methods.

The same MJCF, variants, physics steps, delay, observation, commands, pushes, reward terms and weights as
`hts.envs.velocity`; tests/bench/test_benchmarks.py steps both side by side. Written for speed: plain floats where
NumPy's overhead on short arrays would be paid, physics steps in one call where the target does not change.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from hts.config import EnvConfig
from hts.contracts import Robot
from hts.envs.observation import NOISE, observation_layout
from hts.envs.rewards import DEFAULT_WEIGHTS as W
from hts.envs.velocity import FALL_GRAVITY_Z, FALL_HEIGHT
from hts.sim.engine import sensor_slices
from hts.sim.models import variants


class OneWorld:
    """One robot that follows a commanded velocity; `index` chooses its model and its random numbers."""

    def __init__(self, robot: Robot, config: EnvConfig | None = None, index: int = 0):
        self.config = c = config or EnvConfig()
        spec = self.spec_ = robot.spec
        self.model = variants(robot, c.randomisation, seed=index, count=1)[0]
        self.data = mujoco.MjData(self.model)
        self.rng = np.random.default_rng(index)
        self.dt = spec.physics_dt * spec.substeps
        self.max_steps = round(c.episode_seconds / self.dt)
        self.default_pose = np.array(spec.default_pose)
        self.action_scale = np.array(spec.action_scale)
        at = sensor_slices(self.model)
        legs = [site.removesuffix("_foot") for site in spec.foot_sites]
        self.torques = slice(at[f"torque_{spec.joint_names[0]}"].start, at[f"torque_{spec.joint_names[-1]}"].stop)
        self.touch = slice(at[f"touch_{legs[0]}"].start, at[f"touch_{legs[-1]}"].stop)
        self.foot_velocity = slice(at[f"foot_velocity_{legs[0]}"].start, at[f"foot_velocity_{legs[-1]}"].stop)
        self.trunk_touch = at["trunk_touch"].start
        joints = spec.num_joints
        noise = [np.full(int(p["size"]), NOISE.get(str(p["name"]), 0.0)) for p in observation_layout(joints)]
        self.noise = np.concatenate(noise) * c.observation_noise
        on = c.randomisation.enabled
        self.delay = int(self.rng.integers(*c.randomisation.delays(spec.substeps), endpoint=True)) if on else 0
        self.joint_offset = self.rng.uniform(*c.randomisation.joint_offset, joints) if on else np.zeros(joints)
        self.observation_size, self.action_size = 9 + 3 * joints, joints
        self.command = np.zeros(3)

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Stand up near the default pose with a random heading and a small velocity."""
        if seed is not None:
            self.rng = np.random.default_rng(seed)
        joints, draws = self.spec_.num_joints, self.rng.random(7 + self.spec_.num_joints)
        mujoco.mj_resetData(self.model, self.data)
        half = (2 * draws[-1] - 1) * math.pi / 2
        self.data.qpos[:7] = (0, 0, self.spec_.base_height + 0.02, math.cos(half), 0, 0, math.sin(half))
        self.data.qpos[7:] = self.default_pose * (0.9 + 0.2 * draws[6 : 6 + joints])
        self.data.qvel[:6] = draws[:6] - 0.5
        self.begin()
        return self._observe(), {}

    def begin(self) -> None:
        """An episode starts from the state in `data`."""
        joints, feet = self.spec_.num_joints, len(self.spec_.foot_sites)
        self.action, self.last_velocity = np.zeros(joints), np.zeros(joints)
        self.target = self.default_pose
        self.air_time, self.was_contact, self.steps = np.zeros(feet), np.zeros(feet, bool), 0
        self._read_pose()
        self._new_command()
        self._steer()

    def step(self, action: np.ndarray):
        """One control step of `substeps` physics steps."""
        spec, data = self.spec_, self.data
        action = np.asarray(action, dtype=np.float64)
        target = self.default_pose + self.action_scale * action
        before = data.time
        if self.delay:
            data.ctrl[:] = self.target - self.joint_offset
            mujoco.mj_step(self.model, data, nstep=self.delay)
        data.ctrl[:] = target - self.joint_offset
        if self.delay < spec.substeps:
            mujoco.mj_step(self.model, data, nstep=spec.substeps - self.delay)
        broken = data.time - before < (spec.substeps - 0.5) * spec.physics_dt
        self.target = target
        self.steps += 1
        self._push()
        self._read_pose()
        reward, fell = self._reward(action)
        fell = fell or broken
        if broken:
            reward = W["termination"] * self.dt
        self.action, self.last_velocity = action, self.joint_velocity
        self.steps_left -= 1
        if self.steps_left <= 0:
            self._new_command()
        self._steer()
        return self._observe(), reward, fell, self.steps >= self.max_steps and not fell, {}

    # ------------------------------------------------------------------------------------------------- parts

    def _push(self) -> None:
        r = self.config.randomisation
        if r.enabled and r.push_speed and self.rng.random() < self.dt / r.push_interval:
            self.data.qvel[:2] += (2 * self.rng.random(2) - 1) * r.push_speed

    def _read_pose(self) -> None:
        qpos, qvel = self.data.qpos, self.data.qvel
        w, x, y, z = qpos[3:7].tolist()
        a, b, c = qvel[:3].tolist()
        # Columns of the rotation from the trunk to the world are the trunk's axes; the last row is gravity's.
        xx, xy, xz = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
        yx, yy, yz = 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)
        zx, zy, zz = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
        self.velocity = (a * xx + b * xy + c * xz, a * yx + b * yy + c * yz, a * zx + b * zy + c * zz)
        self.gravity = (-xz, -yz, -zz)
        self.yaw = math.atan2(w * z + x * y, 0.5 - (y * y + z * z))
        self.angular_velocity = qvel[3:6].copy()
        self.pose_error = qpos[7:] + self.joint_offset - self.default_pose
        self.joint_velocity = qvel[6:].copy()

    def _reward(self, action: np.ndarray) -> tuple[float, bool]:
        sensors, sigma = self.data.sensordata, self.config.tracking_sigma
        now = sensors[self.touch] > 1.0
        contact = now | self.was_contact
        landed = contact & (self.air_time > 0)
        air_time = self.air_time + self.dt
        vx, vy, vz = self.velocity
        cx, cy, cw = self.command.tolist()
        wx, wy, wz = self.angular_velocity.tolist()
        gx, gy, gz = self.gravity
        fell = bool(
            self.data.qpos[2] < FALL_HEIGHT * self.spec_.base_height
            or gz > FALL_GRAVITY_Z
            or sensors[self.trunk_touch] > 1.0
        )
        torque, change = sensors[self.torques], (self.joint_velocity - self.last_velocity) / self.dt
        action_change, pose = action - self.action, self.pose_error
        feet = sensors[self.foot_velocity].reshape(-1, 3)[:, :2]
        moving = cx * cx + cy * cy + cw * cw > 0.01
        total = (
            W["track_velocity"] * math.exp(((cx - vx) ** 2 + (cy - vy) ** 2) / -sigma)
            + W["track_yaw_rate"] * math.exp((cw - wz) ** 2 / -sigma)
            + W["vertical_velocity"] * vz * vz
            + W["roll_pitch_rate"] * (wx * wx + wy * wy)
            + W["orientation"] * (gx * gx + gy * gy)
            + W["torque"] * float(torque @ torque)
            + W["joint_acceleration"] * float(change @ change)
            + W["action_rate"] * float(action_change @ action_change)
            + W["pose"] * float(pose @ pose)
            + W["slip"] * float(((feet * feet).sum(1) * now).sum())
            + W["termination"] * fell
        )
        if moving:
            total += W["air_time"] * float((np.minimum(air_time - 0.1, 0.25) * landed).sum())
        else:
            total += W["stand_still"] * float(np.abs(pose).sum())
        self.air_time, self.was_contact = air_time * ~contact, now
        return total * self.dt, fell

    def _new_command(self) -> None:
        c, draws = self.config.commands, self.rng.random(7).tolist()
        vx, vy = (low + (high - low) * u for (low, high), u in ((c.vx, draws[0]), (c.vy, draws[1])))
        yaw_rate = c.yaw_rate[0] + (c.yaw_rate[1] - c.yaw_rate[0]) * draws[3]
        straight = draws[4] < c.straight
        vy = 0.0 if straight else vy
        stand = draws[5] < c.stand or vx * vx + vy * vy < 0.04
        self.heading = self.yaw if straight or stand else (2 * draws[2] - 1) * math.pi
        self.keeps_heading = c.heading or straight
        self.command = np.zeros(3) if stand else np.array((vx, vy, yaw_rate))
        self.steps_left = c.resample_seconds / self.dt * (0.5 + draws[6])

    def _steer(self) -> None:
        if self.keeps_heading:
            error = (self.heading - self.yaw + math.pi) % (2 * math.pi) - math.pi
            low, high = self.config.commands.yaw_rate
            self.command[2] = min(max(self.config.commands.heading_gain * error, low), high)

    def _observe(self) -> np.ndarray:
        clean = np.concatenate(
            (self.angular_velocity, self.gravity, self.command, self.pose_error, self.joint_velocity, self.action)
        )
        return (clean + (2 * self.rng.random(clean.size) - 1) * self.noise).astype(np.float32)
