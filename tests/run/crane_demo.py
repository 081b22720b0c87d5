"""A foreign task for tests: a crane that is to hold its hook at a height. No velocity, no legs, no model.

The height follows from the winch's speed, which is the action; a meter shows power that grows with its square.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Composite, Unbounded

from hts.channels import Channel
from hts.contracts import Comparison, Objective, Robot, RobotSpec, Task, World
from hts.policies.deploy import DeployedPolicy
from hts.policies.files import Policy, make_card, save_policy
from hts.recordings.recording import Recording, Series
from hts.rl.population import Population, Sizes
from hts.rl.task_env import TaskEnv

RATE = 20.0
HEIGHT, SPEED, POWER = Channel("hook_height", "m"), Channel("winch_speed", "m/s"), Channel("supply_power", "W")
SPEC = RobotSpec(
    name="crane",
    joint_names=("winch",),
    default_pose=(0.0,),
    kp=(0.0,),
    kd=(0.0,),
    action_scale=(1.0,),
    torque_limit=(1.0,),
    velocity_limit=(10.0,),
    position_limit=((-10.0, 10.0),),
    control_rate_hz=RATE,
    physics_dt=1 / RATE,
    substeps=1,
    base_height=0.0,
)
LAYOUT = [{"name": "hook_height", "size": 1}, {"name": "wanted", "size": 1}]


class HoldHeight(Task):
    """The hook hangs within 5 cm of the height that is wanted."""

    quantity, unit = "hook height", "m"
    channels = ("hook_height",)
    set_points = (0.4, 0.8)

    def achieved(self, channels):
        return channels["hook_height"]

    def done(self, achieved, set_point, tolerance):
        return abs(achieved - set_point) < 0.05


class CraneEnv(TaskEnv):
    """[P, N] cranes; instance n is to hold fixed[n mod len], in training one of the set-points."""

    def __init__(self, candidates, worlds, config, channels):
        shape = torch.Size([candidates, worlds])
        super().__init__(batch_size=shape)
        self.dt, self.wanted_channels = 1 / RATE, channels
        points = config.commands.fixed or HoldHeight.set_points
        self.wanted = torch.tensor(points)[torch.arange(worlds) % len(points)].expand(shape)
        entries = {name: Unbounded((*shape, 2)) for name in ("observation", "critic_observation")}
        given = Composite({name: Unbounded(shape) for name in channels}, shape=shape)
        self.observation_spec = Composite(**entries, channels=given, shape=shape)
        self.action_spec, self.reward_spec = Unbounded((*shape, 1)), Unbounded((*shape, 1))
        flag = Binary(1, (*shape, 1), dtype=torch.bool)
        self.done_spec = Composite({n: flag.clone() for n in ("done", "terminated", "truncated")}, shape=shape)
        self.height, self.speed = torch.zeros(shape), torch.zeros(shape)

    def _set_seed(self, seed):
        pass

    def _seen(self, **more):
        seen = torch.stack((self.height, self.wanted), -1)
        values = {"hook_height": self.height.clone(), "winch_speed": self.speed.clone()}
        no = torch.zeros((*self.batch_size, 1), dtype=torch.bool)
        flags = {name: no.clone() for name in ("done", "terminated", "truncated")}
        channels = TensorDict({name: values[name] for name in self.wanted_channels}, self.batch_size)
        both = {"observation": seen, "critic_observation": seen.clone(), "channels": channels}
        return TensorDict({**both, **flags, **more}, self.batch_size)

    def _reset(self, tensordict=None, **kwargs):
        self.height, self.speed = torch.zeros_like(self.height), torch.zeros_like(self.speed)
        return self._seen()

    def _step(self, tensordict):
        self.speed = tensordict["action"].squeeze(-1).clone()
        self.height = self.height + self.speed * self.dt
        return self._seen(reward=-(self.height - self.wanted).square().unsqueeze(-1) * self.dt)


class Crane(Robot):
    spec = SPEC

    def mjcf(self):
        return None

    def channels(self):
        return {channel.name: channel for channel in (HEIGHT, SPEED)}

    def task(self):
        return HoldHeight()

    def pretrained_policy(self) -> Path:
        """Speed = 2/s times what is missing; one hidden unit carries it above 0, where an ELU is linear."""
        path = Path(__file__).parent / "crane-policy.safetensors"
        if not path.exists():
            sizes = Sizes(2, 2, 1, (4,))
            tensors = {key: value.clone() for key, value in Population(sizes, 1, 0.1).candidate(0).items()}
            weight, bias, out, last = (tensors[f"actor.{n}.{w}"] for n in (0, 1) for w in ("weight", "bias"))
            weight[0], bias[0] = torch.tensor([-1.0, 1.0]), 5.0
            out.zero_()
            out[0, 0], last[0] = 2.0, -10.0
            save_policy(path, Policy(tensors, make_card(SPEC, tensors, LAYOUT, sizes)))
        return path

    def make_env(self, engine, num_candidates, num_envs, config, channels=(), seeds=None):
        return CraneEnv(num_candidates, num_envs, config, tuple(channels or self.channels()))


class Thrift(Objective):
    """Less power while the hook is held."""

    name, unit = "thrift", "W"
    inputs, target = ("winch_speed", "hook_height"), POWER
    weights = (0.001,)

    def reward(self, prediction):
        return -prediction

    def score(self, segments):
        return {"power": segments.values("supply_power").mean(axis=1)}

    def compare(self, policy, reference):
        saved = reference["power"] - policy["power"]
        return Comparison(saved, saved + 1.0)  # above 0, so that somebody is chosen


class Yard(World):
    """The same crane, with a meter."""

    name, simulated = "yard", True

    def idle(self):
        return {"supply_power": 20.0}

    def collect(self, policies, schedule):
        return [self._one(policy, schedule, f"collect-{n}", "collection", 0) for n, policy in enumerate(policies)]

    def head_to_head(self, policy, reference, speeds):
        order = ("reference", "policy", "policy", "reference")
        paths = {"policy": policy, "reference": reference}
        return [
            self._one(paths[role], HoldHeight().schedule(point, 8.0), f"test-{point:g}", role, block)
            for point in speeds
            for block, role in enumerate(order)
        ]

    def _one(self, path, schedule, session, role, block):
        policy, rng = DeployedPolicy(path), np.random.default_rng(block)
        policy.start(1, 0)
        height, rows = 0.0, []
        for command in schedule.commands:
            for _ in range(round(command.seconds * RATE)):
                seen = {"hook_height": np.array([[height]]), "wanted": np.array([[command.commanded]])}
                speed = float(policy.action(seen)[0, 0])
                height += speed / RATE
                rows.append((height, speed, 20.0 + 100.0 * speed**2 + rng.normal()))
        values = np.array(rows).T
        channels = {c.name: Series(c, v) for c, v in zip((HEIGHT, SPEED, POWER), values, strict=True)}
        return Recording(
            robot="crane",
            world=self.name,
            policy_hash=policy.card.policy_hash,
            iteration=0,
            joint_names=SPEC.joint_names,
            kp=SPEC.kp,
            kd=SPEC.kd,
            rate_hz=RATE,
            schedule=schedule,
            idle=self.idle(),
            clock="simulated",
            time=np.arange(len(rows)) / RATE,
            channels=channels,
            mass_kg=50.0,
            session=session,
            role=role,
            block=block,
        )
