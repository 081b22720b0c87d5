"""The velocity task as a TorchRL env of batch size [P, N]: P candidates, N instances each."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase

from hts.channels import HELD_CHANNELS, Channel
from hts.config import EnvConfig
from hts.contracts import RobotSpec
from hts.envs.commands import DRAWS, Commands, WalksAsTold
from hts.envs.constants import delays_and_offsets
from hts.envs.disturbances import DRAWS as DISTURBANCE_DRAWS
from hts.envs.disturbances import Disturbances
from hts.envs.episodes import time_outs
from hts.envs.observation import NOISE, critic_observation_size, observation_layout, observation_size
from hts.envs.physics_steps import SUBSTEPS, in_physics_steps
from hts.envs.pose import trunk_frame, yaw_of
from hts.envs.rewards import RewardInputs, resolve_weights, soft_range, stacked, total
from hts.envs.specs import make_specs
from hts.rl.random import PopulationRandom
from hts.rl.task_env import LaunchedSimulator, ReplacedState, SplitStepEnv
from hts.rl.tracing import any_or_tracing
from hts.sim.conventions import TRUNK_TOUCH, sensor_groups
from hts.sim.engine import Engine

# An episode ends below this share of the standing height or beyond this tilt (gravity's z in the
# trunk frame: -1 is upright).
FALL_HEIGHT, FALL_GRAVITY_Z = 0.55, -0.5

# Channel -> where the env keeps it, for those that it makes anew at every step.
CHANNEL_FIELDS = {
    "joint_position": "_joint_position",
    "joint_velocity": "_joint_velocity",
    "joint_target": "target",
    "angular_velocity": "_angular_velocity",
    "projected_gravity": "_gravity",
    "base_velocity": "_velocity",
}


class VelocityEnv(SplitStepEnv, WalksAsTold):
    """Follow a commanded velocity; see `hts.envs.rewards` for r_sim.

    Writes observation [P, N, 9 + 3 J], critic_observation [P, N, 9 + 3 J + 4 + F] (noise-free, with trunk velocity m/s,
    height m and contacts), reward [P, N, 1], done, terminated (fell), truncated (time-out) and
    ("channels", name) for the channels asked for.
    """

    batch_locked = True
    random: PopulationRandom

    def __init__(
        self,
        engine: Engine,
        spec: RobotSpec,
        num_candidates: int,
        num_envs: int,
        config: EnvConfig,
        channels: Mapping[str, Channel],
        seeds: Sequence[int],
    ) -> None:
        super().__init__(device=engine.device, batch_size=torch.Size([num_candidates, num_envs]))
        self.engine, self.robot_spec, self.config = engine, spec, config
        self.shape2 = (num_candidates, num_envs)
        self.channel_specs = dict(channels)
        self.dt = spec.physics_dt * spec.substeps
        self.max_steps = round(config.episode_seconds / self.dt)
        self.time_out = time_outs(config, self.dt, self.shape2, engine.device)  # steps of the episode that goes on
        self.weights = resolve_weights(config.reward_weights)
        self.random = PopulationRandom(seeds, engine.device)
        joints, feet, device = spec.num_joints, len(spec.foot_sites), engine.device
        self.default_pose = torch.tensor(spec.default_pose, device=device)
        self._pose_range = soft_range(spec.position_limit, spec.default_pose, config.soft_joint_range, device)
        self.action_scale = torch.tensor(spec.action_scale, device=device)
        torques, touch, foot_velocity = sensor_groups(spec).values()
        self._torques, self._touch = self._sensor_block(torques), self._sensor_block(touch)
        self._foot_velocity = self._sensor_block(foot_velocity)
        self._trunk_touch = engine.sensor(TRUNK_TOUCH)
        self.observation_layout = observation_layout(joints)
        self._draw_constants()
        shape = self.shape2
        self.commands = Commands(config.commands, shape, self.dt, device, channels)
        self.disturbances = Disturbances(config.randomisation, shape, self.dt, engine)
        zeros = torch.zeros
        self.action = zeros(*shape, joints, device=device)
        self.last_joint_velocity = zeros(*shape, joints, device=device)
        self.target = self.default_pose.expand(*shape, joints).clone()
        self.air_time = zeros(*shape, feet, device=device)
        self.was_contact = zeros(*shape, feet, dtype=torch.bool, device=device)
        self.steps = zeros(shape, device=device)
        self.falls = zeros(shape, device=device)  # since the env was made
        self.breakdowns = zeros(shape, device=device)  # of the physics, since the env was made
        self._substep = torch.arange(spec.substeps, device=device).view(-1, 1, 1, 1)
        noise = [
            torch.full((int(part["size"]),), NOISE.get(str(part["name"]), 0.0)) for part in self.observation_layout
        ]
        self._noise = torch.cat(noise).to(device) * config.observation_noise
        self._twice_noise = 2 * self._noise
        self._noisy = bool(self._noise.any())
        self._down = torch.tensor((0.0, 0.0, -1.0), device=device).expand(*shape, 3)
        # Which of a step's uniform numbers are whose. The two in between are nobody's: a seed gives what it gave.
        self._command_draws, start = slice(0, DRAWS), DRAWS + DISTURBANCE_DRAWS + 2
        self._disturbance_draws = slice(DRAWS, DRAWS + DISTURBANCE_DRAWS)
        self._start_draws = slice(start, start + 6 + joints + 1)
        self._noise_draws = slice(self._start_draws.stop, None)
        sizes = {"observation": observation_size(joints), "critic_observation": critic_observation_size(joints, feet)}
        self._observation = zeros(*shape, sizes["observation"], device=device)
        self._critic_observation = zeros(*shape, sizes["critic_observation"], device=device)
        make_specs(self, sizes, self.channel_specs or None, joints)

    def __setattr__(self, name: str, value: object) -> None:
        # A step replaces some twenty tensors; EnvBase looks at length whether each is a submodule or a spec.
        if isinstance(value, torch.Tensor):
            object.__setattr__(self, name, value)
        else:
            super().__setattr__(name, value)

    def _sensor_block(self, names: list[str]) -> slice:
        """One slice over sensors that lie side by side."""
        slices = [self.engine.sensor(name) for name in names]
        for left, right in itertools.pairwise(slices):
            assert left.stop == right.start, names  # a robot's author keeps them together; see docs
        return slice(slices[0].start, slices[-1].stop)

    def _draw_constants(self) -> None:
        """What stays as it is in each env instance; the same N for every candidate, whoever trains beside it."""
        count, device = self.shape2[1], self.engine.device
        delay, offset = delays_and_offsets(self.config, self.robot_spec, count)
        self.delay = torch.from_numpy(delay).to(device).view(1, 1, count, 1)
        self.joint_offset = torch.from_numpy(offset).float().to(device)

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.random.seed(seed)
            self.__dict__.pop("_draws", None)  # drawn with the old seed

    def begin_step(self, action: torch.Tensor) -> torch.Tensor:
        """Actions [P, N, J] -> actuator inputs (substeps, P·N, J)."""
        self._draws = self._draw()
        target = torch.addcmul(self.default_pose, self.action_scale, action)
        # An instance with delay d applies the previous target in its first d physics steps.
        late = self._substep < self.delay
        ctrl = torch.where(late, self.target, target) - self.joint_offset
        self.target = target
        return ctrl.view(self.robot_spec.substeps, -1, ctrl.shape[-1])

    def simulate(self, inputs: torch.Tensor) -> None:
        """The physics of a control step."""
        self.engine.step(inputs)

    def end_step(self, action: torch.Tensor) -> tuple[RewardInputs, dict[str, torch.Tensor]]:
        """What the reward looks at, and the flags."""
        seen = self._after_physics(action)
        return seen, self._prepare_next(seen)

    def rewards(self, steps: Sequence[RewardInputs]) -> torch.Tensor:
        """r_sim of steps that have ended, [T, P, N]."""
        return total(stacked(steps), self.weights)

    def _after_physics(self, action: torch.Tensor) -> RewardInputs:
        """Count the step, push some robots, and read what has become of all."""
        self.steps = self.steps + 1
        self.disturbances.act(self._draws[..., self._disturbance_draws])
        seen = self._read(action)
        broken = self.engine.diverged.view(self.shape2)
        if any_or_tracing(broken):
            seen.broken = broken.clone()
            self.breakdowns = self.breakdowns + broken
        return seen

    def _prepare_next(self, seen: RewardInputs) -> dict[str, torch.Tensor]:
        """Make the next command and observation, and say whose episode is over."""
        self.action, self.last_joint_velocity = seen.action, seen.joint_velocity
        terminated, truncated = seen.fell, (self.steps >= self.time_out) & ~seen.fell
        self.falls = self.falls + terminated
        self.commands.advance(self._draws[..., self._command_draws], self._yaw, seen.velocity[..., 0])
        self._observe(self._draws[..., self._noise_draws])
        if seen.broken is not None:  # it has fallen: its episode ends there, and none of its numbers is used
            broken = seen.broken.unsqueeze(-1)
            self._observation = self._observation.masked_fill(broken, 0.0)
            self._critic_observation = self._critic_observation.masked_fill(broken, 0.0)
        return {
            "terminated": terminated.unsqueeze(-1),
            "truncated": truncated.unsqueeze(-1),
            "done": (terminated | truncated).unsqueeze(-1),
        }

    def _draw(self) -> torch.Tensor:
        """The uniform numbers of a step [P, N, ...]."""
        return self.random.uniform(
            self.shape2[1], self._noise_draws.start + (self._noise.numel() if self._noisy else 0)
        )

    def channel_values(self) -> dict[str, torch.Tensor]:
        """The channels asked for, now; zeros where the physics broke and left numbers that are none."""
        values = {name: self._channel_value(name) for name in self.channel_specs}
        if values and not self.engine.finite_when_diverged:
            broken = self.engine.diverged.view(self.shape2)
            for name, value in values.items():
                values[name] = value.masked_fill(broken.view(*self.shape2, *(1,) * (value.ndim - 2)), 0.0)
        return values

    def observations(self) -> dict[str, torch.Tensor]:
        """What policy [P, N, O] and critic [P, N, O_c] see now."""
        return {"observation": self._observation, "critic_observation": self._critic_observation}

    # ---------------------------------------------------------------------------------------------- physics

    def start_episodes(self, mask: torch.Tensor) -> None:
        """Stand the robots of mask [P, N] up: joints near the default pose, a random heading and a small velocity."""
        if "_draws" not in vars(self):
            self._draws = self._draw()
        joints = self.robot_spec.num_joints
        draws = self._draws[..., self._start_draws]
        velocity, scale, yaw = draws[..., :6] - 0.5, 0.9 + 0.2 * draws[..., 6 : 6 + joints], draws[..., -1]
        qpos = torch.zeros(*self.shape2, 7 + joints, device=self.device)
        qpos[..., 2] = self.robot_spec.base_height + 0.02
        half = (2 * yaw - 1) * torch.pi / 2
        qpos[..., 3], qpos[..., 6] = half.cos(), half.sin()
        qpos[..., 7:] = self.default_pose * scale
        qvel = torch.zeros(*self.shape2, 6 + joints, device=self.device)
        qvel[..., :6] = velocity
        flat = mask.reshape(-1)
        self.engine.reset(flat, qpos.view(flat.numel(), -1), qvel.view(flat.numel(), -1))
        keep = ~mask.unsqueeze(-1)
        # `masked_fill` and not a product: an instance whose physics broke may hold NaN, and NaN x 0 is NaN.
        gone = ~keep
        self.action = self.action.masked_fill(gone, 0.0)
        self.last_joint_velocity = self.last_joint_velocity.masked_fill(gone, 0.0)
        self.target = torch.where(keep, self.target, self.default_pose)
        self.air_time = self.air_time * keep
        self.was_contact = self.was_contact & keep
        self.time_out = torch.where(mask & (self.steps > 0), float(self.max_steps), self.time_out)
        self.steps = self.steps * ~mask
        self.engine.sensordata.masked_fill_(gone.reshape(-1, 1), 0.0)  # sensors are read from the first step on
        old, old_critic = self._observation, self._critic_observation
        self._read_engine()
        self.commands.resample(mask, self._draws[..., self._command_draws], self._yaw)
        self.commands.steer(self._yaw)
        self._contact = self._sensors[..., self._touch] > 1.0
        self._observe(self._draws[..., self._noise_draws])
        self._observation = torch.where(keep, old, self._observation)
        self._critic_observation = torch.where(keep, old_critic, self._critic_observation)

    def walk_at(self, commands: torch.Tensor) -> None:
        self.commands.walk_at(commands)

    def _read_engine(self) -> None:
        """Pose, velocities in the trunk frame and sensors; copies, since the engine rewrites its own."""
        qpos, qvel = self.engine.qpos.view(*self.shape2, -1), self.engine.qvel.view(*self.shape2, -1).clone()
        self._sensors = self.engine.sensordata.view(*self.shape2, -1).clone()
        self._velocity, self._gravity = trunk_frame(qpos, qvel, self._down)
        self._yaw = yaw_of(qpos)
        self._height = qpos[..., 2:3]
        self._angular_velocity = qvel[..., 3:6]
        self._joint_position = qpos[..., 7:] + self.joint_offset  # as the encoders say
        self._pose_error = self._joint_position - self.default_pose
        self._joint_velocity = qvel[..., 6:]

    def _read(self, action: torch.Tensor) -> RewardInputs:
        """Look at the robots after a step."""
        self._read_engine()
        sensors = self._sensors
        force = sensors[..., self._touch]
        now = force > 1.0
        contact = now | self.was_contact  # or-ed with the last step, as released: one lost sample is not a flight
        landed = contact & (self.air_time > 0)
        air_time = self.air_time + self.dt
        foot_velocity = sensors[..., self._foot_velocity].unflatten(-1, (-1, 3))
        fell = (
            (self._height[..., 0] < FALL_HEIGHT * self.robot_spec.base_height)
            | (self._gravity[..., 2] > FALL_GRAVITY_Z)
            | (sensors[..., self._trunk_touch.start] > 1.0)
            | self.engine.diverged.view(self.shape2)
        )
        seen = RewardInputs(
            velocity=self._velocity,
            angular_velocity=self._angular_velocity,
            gravity=self._gravity,
            command=self.commands.value,
            torque=sensors[..., self._torques],
            joint_velocity=self._joint_velocity,
            last_joint_velocity=self.last_joint_velocity,
            pose_error=self._pose_error,
            action=action,
            last_action=self.action,
            air_time=air_time,
            landed=landed,
            contact=now,
            foot_speed_squared=foot_velocity[..., :2].square().sum(-1),
            fell=fell,
            dt=self.dt,
            tracking_sigma=self.config.tracking_sigma,
            pose_range=self._pose_range,
        )
        self.air_time = air_time * ~contact
        self.was_contact = now
        self._contact = now
        return seen

    def _observe(self, draws: torch.Tensor) -> None:
        body = (self._angular_velocity, self._gravity, self.commands.value)
        clean = torch.cat((*body, self._pose_error, self._joint_velocity, self.action), -1)
        # Uniform in +-noise: clean - noise + 2 noise u.
        self._observation = torch.addcmul(clean - self._noise, draws, self._twice_noise) if self._noisy else clean
        self._critic_observation = torch.cat((clean, self._velocity, self._height, self._contact.to(clean.dtype)), -1)

    def _channel_value(self, name: str) -> torch.Tensor:
        """One channel now."""
        if name in ("joint_torque", "foot_force"):
            return self._sensors[..., self._torques if name == "joint_torque" else self._touch]
        if name == "command":
            return self.commands.value
        if name in HELD_CHANNELS:  # a method of the commands each
            return getattr(self.commands, name)(self._velocity[..., 0], self.steps * self.dt)
        if name in SUBSTEPS:
            return in_physics_steps(name, self.engine, self._torques, self._touch).unflatten(0, self.shape2)
        return getattr(self, CHANNEL_FIELDS[name])

    # ------------------------------------------------------------------------------------- saving the whole state

    STATE = (
        "action",
        "last_joint_velocity",
        "target",
        "air_time",
        "was_contact",
        "steps",
        "time_out",
        "falls",
        "breakdowns",
        "_draws",
        "_observation",
        "_critic_observation",
    )

    def launched_simulator(self) -> LaunchedSimulator | None:
        """The engine, where its step is a launch."""
        return self.engine if isinstance(self.engine, LaunchedSimulator) else None

    def replaced_state(self) -> list[ReplacedState]:
        """What a step makes anew: the env's own buffers and the commands'."""
        return [ReplacedState(owner, owner.STATE) for owner in (self, self.commands, self.disturbances)]

    def check(self) -> None:
        """Raise SimulationError if a buffer of the engine overflowed."""
        self.engine.check()

    def full_state(self) -> TensorDict:
        """Physics, commands, buffers and random generators: everything to go on exactly from here."""
        parts = {
            "buffers": {name: getattr(self, name).clone() for name in self.STATE},
            "engine": self.engine.state_dict(),
            "commands": self.commands.state_dict(),
            "disturbances": {"pull": self.disturbances.pull.clone()},
            "random": self.random.state_dict(),
        }
        return TensorDict(parts, batch_size=[])

    def load_full_state(self, state: TensorDictBase) -> None:
        """Go on from `full_state`."""
        for name in set(self.STATE) - ({"time_out"} - set(state["buffers"].keys())):  # older checkpoints lack that one
            setattr(self, name, state["buffers", name].to(self.device).clone())
        self.engine.load_state_dict(state["engine"])
        self.commands.load_state_dict(state["commands"])
        self.random.load_state_dict(state["random"])
        if "disturbances" in state.keys():  # noqa: SIM118 - older checkpoints lack them
            self.disturbances.pull = state["disturbances", "pull"].to(self.device).clone()
        self._read_engine()

    def close(self, **kwargs: Any) -> None:
        self.engine.close()
        super().close(**kwargs)
