"""Policies in simulation over varied dynamics, held against what their machine can bear: all at once, one rollout.

Judged from `SETTLING` on, but for falls, which count from the start: the drop with which a trial begins is the
simulation's and not the policy's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from hts.config import EnvConfig
from hts.config_gate import GateConfig
from hts.contracts import Robot, RobotSpec
from hts.envs.constants import delays_and_offsets
from hts.envs.velocity_robot import VelocityRobot
from hts.errors import SimulationError
from hts.evaluation.simulated_trimming import told
from hts.rl.actor import PopulationActor
from hts.rl.population import Population
from hts.rl.task_env import TaskEnv
from hts.rl.threads import one_thread
from hts.run.gate_checks import NEEDS, Worst, limits
from hts.sim.conventions import FLOOR
from hts.sim.models import check_added_mass, compile_model, variants

SETTLING = 1.0  # s
PACKETS = 9341  # so that losing them shares no random number with anything else of a seed


def varied(base: EnvConfig, gate: GateConfig, instances: int) -> EnvConfig:
    """The env's configuration with the dynamics that the gate tries, another in each env instance; sensor noise, centre
    of mass, joint friction and encoder errors stay as they are."""
    ranges = {
        "enabled": True,
        "friction": gate.friction,
        "added_mass": gate.payload,
        "strength": gate.gains,
        "delay_share": gate.latency,
        "models": instances,
    }
    return base.model_copy(update={"randomisation": base.randomisation.model_copy(update=ranges)})


def check_payload(robot: Robot, gate: GateConfig) -> None:
    """Raise ConfigError for a payload that would leave nothing of the trunk; of the velocity task alone it is known."""
    if isinstance(robot, VelocityRobot):
        check_added_mass(compile_model(robot), robot, gate.payload, "gate.payload")


class LostPackets:
    """Actions that never arrive: each env instance keeps the last one, with a probability of its own.

    An instance loses the same packets whoever walks in it.
    """

    def __init__(self, share: tuple[float, float], instances: int, seed: int) -> None:
        self._random = np.random.default_rng([seed, PACKETS])
        self.share = self._random.uniform(*share, size=instances)
        self._kept: torch.Tensor | None = None

    def __call__(self, action: torch.Tensor) -> torch.Tensor:
        """action [P, N, A]: as the policies sent it; returns what arrived."""
        lost = torch.from_numpy(self._random.random(len(self.share)) < self.share).to(action.device)
        self._kept = action if self._kept is None else torch.where(lost[:, None], self._kept, action)
        return self._kept


@torch.no_grad()
@one_thread()
def rollout(
    env: EnvBase,
    population: Population,
    spec: RobotSpec,
    checks: Sequence[str],
    gate: GateConfig,
    set_points: Sequence[float],
    lost: LostPackets,
    commands: torch.Tensor | None = None,
) -> list[dict[str, Worst]]:
    """Check -> the worst of each policy. env: of batch size [P, N], instance n at set_points[n mod S], its instances
    as `varied` says, writing the channels that the checks read; commands [P, S]: what is sent for each set-point, m/s,
    where that is another number. Raises SimulationError for numbers that are none."""
    act, shape = PopulationActor(population, None), env.batch_size
    seen = _Seen(env, spec, checks, gate)
    if commands is not None:
        told(env).walk_at(commands[:, torch.arange(shape[1]) % len(set_points)].to(env.device))
    own = _last_action(env)
    state = env.reset()
    for step in range(round(gate.seconds / env.dt)):
        state = act(state)
        sent = state["action"]
        state["action"] = lost(sent)
        data, state = env.step_and_maybe_reset(state)
        if own is not None:  # a policy remembers what it sent, not what arrived
            observation = state["observation"].clone()
            observation[..., own] = sent
            state["observation"] = observation
        seen.step(step, data["next"])
    return [seen.worst(member, set_points) for member in range(shape[0])]


def _last_action(env: EnvBase) -> slice | None:
    """Where the observation holds the last action, if it does."""
    begin = 0
    for part in (env.observation_layout or ()) if isinstance(env, TaskEnv) else ():
        if part["name"] == "last_action":
            return slice(begin, begin + int(part["size"]))
        begin += int(part["size"])
    return None


class _Seen:
    """What has been seen so far, per policy and env instance; nothing of an instance counts from its fall on."""

    def __init__(self, env: EnvBase, spec: RobotSpec, checks: Sequence[str], gate: GateConfig) -> None:
        shape, device = env.batch_size, env.device
        joints = (*shape, spec.num_joints)
        self.spec, self.checks, self.gate, self.dt = spec, checks, gate, env.dt
        low, high = zip(*spec.position_limit, strict=True)
        self.limit, self.low, self.high, self.velocity_limit = (
            torch.tensor(values, device=device) for values in (spec.torque_limit, low, high, spec.velocity_limit)
        )
        self.over, self.peak, self.rate = (torch.zeros(joints, device=device) for _ in range(3))
        self.inside = torch.full(joints, math.inf, device=device)
        self.target: torch.Tensor | None = None
        self.tilt, self.steps, self.fell = (torch.zeros(shape, device=device) for _ in range(3))
        self.when = {"joint_range": torch.zeros(joints, device=device), "tilt": torch.zeros(shape, device=device)}

    def step(self, number: int, after: TensorDictBase) -> None:
        """after: what the env returned of this step."""
        now = (number + 1) * self.dt
        fell = after["terminated"].squeeze(-1)
        self.fell = torch.where(fell & (self.fell == 0), now, self.fell)
        stood = self.fell == 0
        target = after["channels", NEEDS["action_rate"][0]] if "action_rate" in self.checks else None
        before, self.target = self.target, target
        if now <= SETTLING:
            return
        self.steps += stood
        counts = stood.unsqueeze(-1)
        if "torque" in self.checks:
            share = torch.where(counts, after["channels", NEEDS["torque"][0]].abs() / self.limit, 0.0)
            self.peak = torch.maximum(self.peak, share)
            self.over += share >= self.gate.torque_level
        if "joint_range" in self.checks:
            angle = after["channels", NEEDS["joint_range"][0]]
            inside = torch.where(counts, torch.minimum(angle - self.low, self.high - angle), math.inf)
            self.when["joint_range"] = torch.where(inside < self.inside, now, self.when["joint_range"])
            self.inside = torch.minimum(self.inside, inside)
        if "tilt" in self.checks:
            upright = -after["channels", NEEDS["tilt"][0]][..., 2]
            tilt = torch.where(stood, torch.rad2deg(torch.acos(upright.clamp(-1, 1))), 0.0)
            self.when["tilt"] = torch.where(tilt > self.tilt, now, self.when["tilt"])
            self.tilt = torch.maximum(self.tilt, tilt)
        if target is not None and before is not None:
            rate = (target - before) / self.dt / self.velocity_limit
            self.rate += torch.where(counts, rate.square(), 0.0)

    def worst(self, member: int, set_points: Sequence[float]) -> dict[str, Worst]:
        """Of one policy."""
        steps = self.steps[member].clamp_min(1).unsqueeze(-1)
        values = {  # larger is worse; [N, J or 1]
            "torque": self.over[member] / steps,
            "joint_range": -self.inside[member],
            "tilt": self.tilt[member].unsqueeze(-1),
            "action_rate": (self.rate[member] / steps).sqrt(),
            "falls": (self.fell[member] > 0).float().unsqueeze(-1),
        }
        allowed, found = limits(self.gate), {}
        for check in self.checks:
            value = values[check].cpu().numpy()
            if np.isnan(value).any() or (check == "torque" and bool(self.peak[member].isnan().any())):
                raise SimulationError(
                    f"The gate's check of {check} met NaN in the channel '{NEEDS[check][0]}' of robot "
                    f"'{self.spec.name}', in an env instance that had not fallen. Such a number can hold nothing back: "
                    "mend the env, or the policy."
                )
            instance, joint = (int(i) for i in np.unravel_index(int(np.argmax(value)), value.shape))
            when = self.when.get(check)
            second = None if when is None else round(float(when[member].reshape(len(value), -1)[instance, joint]), 2)
            if check == "falls" and value.any():
                second = round(float(self.fell[member, instance]), 2)
            most = float(value[instance, joint])
            found[check] = Worst(
                check,
                {"joint_range": -most, "falls": float(value.sum())}.get(check, most),
                allowed[check],
                self.spec.joint_names[joint] if value.shape[1] > 1 or check not in ("tilt", "falls") else None,
                float(set_points[instance % len(set_points)]),
                instance,
                second,
                float(self.peak[member].max()) if check == "torque" else None,
            )
        return found


def dynamics(robot: Robot, config: EnvConfig, lost: LostPackets, instance: int) -> dict[str, float]:
    """What an env instance was like: friction, payload kg, mean factor on the gains, latency s, share of packets lost.
    Of an env of the robot's own only the last is known."""
    found = {"lost_packets": float(lost.share[instance])}
    if not isinstance(robot, VelocityRobot):
        return found
    spec, nominal = robot.spec, compile_model(robot)
    pool = variants(robot, config.randomisation, config.seed)
    model, trunk = pool[instance % len(pool)], nominal.body(spec.trunk_body).id
    gains = model.actuator_gainprm[:, 0] / nominal.actuator_gainprm[:, 0]
    delays, _ = delays_and_offsets(config, spec, len(lost.share))
    return {
        "friction": float(model.geom(FLOOR).friction[0]),
        "payload": float(model.body_mass[trunk] - nominal.body_mass[trunk]),
        "gains": float(gains.mean()),
        "latency": float(delays[instance]) * spec.physics_dt,
        **found,
    }


def channels_of(checks: Sequence[str]) -> tuple[str, ...]:
    """The channels that these checks read."""
    return tuple(NEEDS[check][0] for check in checks if check in NEEDS)


def commands_of(
    trials: Mapping[str, Sequence[Mapping[str, Any]]], names: Sequence[str], set_points: Sequence[float]
) -> torch.Tensor | None:
    """Commands [P, S] that held the speed while these policies were judged, m/s; where one is not known, as of who fell
    in all instances there, the set-point itself, for that policy alone. None where none is known."""
    rows = [[_known(trial.get("commanded")) for trial in trials[name]] for name in names]
    if all(command is None for row in rows for command in row):
        return None
    return torch.tensor(
        [[at if command is None else command for command, at in zip(row, set_points, strict=True)] for row in rows]
    )


def _known(command: float | None) -> float | None:
    """JSON has no NaN: there nothing stands for it."""
    return None if command is None or math.isnan(command) else command
