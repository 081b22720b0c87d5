"""How policies do in the training simulation: mean action, straight walks at fixed speeds (or the set-points of another
task), one whole trial per env instance."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from hts.config import EnvConfig, SimulationTestConfig
from hts.contracts import VELOCITY, HoldSpeed, Task
from hts.errors import ConfigError, PluginError
from hts.evaluation.simulated_trimming import SECONDS, trim
from hts.rl.actor import PopulationActor
from hts.rl.population import Population
from hts.rl.threads import one_thread

SETTLE_SECONDS = 2.0  # the start of a trial is not judged


@dataclass(frozen=True)
class SimulatedTrial:
    """One policy at one asked speed over its env instances.

    speed, mean_speed: m/s, or of another task its set-point and what was achieved, in its unit; falls: instances that
    fell at least once; mean_speed is over those that did not; valid: share of the 1 s segments in which the task was
    done; rewards: mean r_real per objective, task_reward: mean of the task's
    own, both per second, after settling, over instances that did not fall;
    pieces: what was predicted of each target in the 1 s pieces of those instances, (S, n) as the model gives it, not
    yet in the target's unit; piece_speed: mean of what was achieved in each, as mean_speed (S,); commanded: what was
    sent, mean over those instances, the asked speed or set-point where none was held (NaN if not known).
    """

    speed: float
    worlds: int
    falls: int
    mean_speed: float
    valid: float
    rewards: dict[str, float] = field(default_factory=dict)
    task_reward: float = math.nan
    pieces: dict[str, np.ndarray] = field(default_factory=dict)
    piece_speed: np.ndarray = field(default_factory=lambda: np.empty(0))
    commanded: float = float("nan")


def test_config(base: EnvConfig, speeds: Sequence[float], seconds: float, seed: int) -> EnvConfig:
    """The training env with straight walks at `speeds` (or other set-points), no pushes or pulls, no time-out within
    the trial; its noise and variants stay."""
    commands = base.commands.model_copy(update={"fixed": tuple(speeds)})
    calm = base.randomisation.model_copy(update={"push_speed": 0.0, "pull": (0.0,)})
    changes = {
        "commands": commands,
        "randomisation": calm,
        "episode_seconds": seconds + 1.0,
        "stagger": False,
        "seed": seed,
    }
    return base.model_copy(update=changes)


def trial_seconds(test: SimulationTestConfig) -> float:
    """Simulated seconds of each env instance in `simulate`, trimming included; none is reset on the way."""
    return test.seconds + (SECONDS if test.hold_speed else 0.0)


def trial_steps(test: SimulationTestConfig, rate_hz: float) -> int:
    """Control steps of each env instance in `simulate`, at so many a second."""
    return round(trial_seconds(test) * rate_hz)


test_config.__test__ = False  # type: ignore[attr-defined]  # not a pytest test


@torch.no_grad()
@one_thread()
def simulate(
    env: EnvBase,
    population: Population,
    speeds: Sequence[float],
    seconds: float,
    tolerance: float,
    task: Task = VELOCITY,
    hold: HoldSpeed | None = None,
    watch: Callable[[torch.Tensor], None] | None = None,
) -> list[list[SimulatedTrial]]:
    """Trials of every policy (outer) at every speed (inner); env instance n walks at speeds[n mod len(speeds)].

    env: of batch size [P, N], made with `test_config`, writing the channels that the task is judged by;
    tolerance: relative speed error of a valid segment, see `Task.done`; hold: trim each instance's command first, and
    go on from there; watch: is given the observations [P, N, O] of each judged step. Raises ConfigError where a speed
    is to be held of a task that follows none.
    """
    if seconds < SETTLE_SECONDS + 1.0:
        raise ConfigError(
            f"A trial of {seconds} s has no segment to judge: {SETTLE_SECONDS} s to settle and 1 s at least. Make it "
            "longer."
        )
    if hold is not None:
        task.check_hold("simulation_test.hold_speed")
    act = PopulationActor(population, None)
    shape, per_segment = env.batch_size, round(1.0 / env.dt)
    at = torch.arange(shape[1], device=env.device) % len(speeds)  # which speed each instance walks at
    commanded = torch.tensor(speeds, device=env.device)[at]
    if hold is None:
        state, sent = env.reset(), commanded.expand(shape)
        fallen = torch.zeros(shape, dtype=torch.bool, device=env.device)
    else:
        trimmed = trim(env, act, commanded, hold, lambda after: _achieved(task, after, shape))
        state, sent, fallen = trimmed.state, trimmed.commands, trimmed.fallen
    segments: list[torch.Tensor] = []
    sums: dict[str, torch.Tensor] = {}
    predicted: dict[str, list[torch.Tensor]] = {}  # of each step
    steps, counted = round(seconds / env.dt), 0
    speed_sum = torch.zeros(shape, device=env.device)
    task_sum = torch.zeros(shape, device=env.device)
    for step in range(steps):
        if watch is not None and step * env.dt >= SETTLE_SECONDS - 1e-6:
            watch(state["observation"])
        data, state = env.step_and_maybe_reset(act(state))
        after = data["next"]
        fallen |= after["terminated"].squeeze(-1)
        if step * env.dt < SETTLE_SECONDS - 1e-6:
            continue
        counted += 1
        speed_sum += _achieved(task, after, shape)
        task_sum += after["reward"].squeeze(-1)
        if counted % per_segment == 0:
            segments.append(speed_sum / per_segment)
            speed_sum = torch.zeros_like(speed_sum)
        if "real_reward" in after.keys():  # noqa: SIM118 - a TensorDict
            for name, value in after["real_reward"].items():
                sums[name] = sums.get(name, 0.0) + value.squeeze(-1)
        if "measured" in after.keys():  # noqa: SIM118
            for name, value in after["measured"].items():
                predicted.setdefault(name, []).append(value.squeeze(-1))
    pieces = torch.stack(segments)
    walked = _Walked(
        sent,
        fallen,
        pieces,
        good=torch.as_tensor(task.done(pieces, commanded, tolerance), device=env.device).float().mean(0),
        rewards={name: total / counted for name, total in sums.items()},
        task_reward=task_sum,
        seconds=counted * env.dt,
        predicted={name: _in_pieces(steps, len(pieces), per_segment) for name, steps in predicted.items()},
    )
    return [
        [walked.trial(member, float(speed), at == index) for index, speed in enumerate(speeds)]
        for member in range(shape[0])
    ]


@dataclass(frozen=True)
class _Walked:
    """What all policies did in all env instances. sent: commands [P, N], m/s; fallen [P, N]; pieces: mean of what was
    achieved in each second (S, P, N); good: share of those in which the task was done [P, N]; rewards: mean r_real per
    second [P, N] by objective; task_reward: sum of the task's own [P, N]; seconds: that were judged; predicted: by
    target, (S, n, P, N), see `SimulatedTrial.pieces`."""

    sent: torch.Tensor
    fallen: torch.Tensor
    pieces: torch.Tensor
    good: torch.Tensor
    rewards: dict[str, torch.Tensor]
    task_reward: torch.Tensor
    seconds: float
    predicted: dict[str, torch.Tensor]

    def trial(self, member: int, speed: float, worlds: torch.Tensor) -> SimulatedTrial:
        """Of one policy in these env instances, [N], which walk at the same speed."""
        fallen = self.fallen[member]
        stood = worlds & ~fallen
        some = bool(stood.any())
        return SimulatedTrial(
            speed=speed,
            worlds=int(worlds.sum()),
            falls=int((worlds & fallen).sum()),
            mean_speed=float(self.pieces.mean(0)[member][stood].mean()) if some else float("nan"),
            valid=float(self.good[member][worlds].mean()),
            rewards={
                name: float(each[member][stood].mean()) if some else float("-inf")
                for name, each in self.rewards.items()
            },
            task_reward=float(self.task_reward[member][stood].mean()) / self.seconds if some else math.nan,
            pieces={
                name: values[:, :, member, stood.cpu()].permute(0, 2, 1).flatten(0, 1).numpy()
                for name, values in self.predicted.items()
            },
            piece_speed=self.pieces[:, member, stood].flatten().cpu().numpy(),
            commanded=float(self.sent[member][stood].mean()) if some else float("nan"),
        )


def _in_pieces(steps: Sequence[torch.Tensor], pieces: int, length: int) -> torch.Tensor:
    """Numbers of each step [P, N] as (pieces, length, P, N); what is left at the end is in none."""
    return torch.stack([*steps[: pieces * length]]).unflatten(0, (pieces, length)).cpu()


def _achieved(task: Task, after: TensorDictBase, shape: torch.Size) -> torch.Tensor:
    """What the task says of this step, [P, N], from the channels of any env that writes them."""
    found = torch.as_tensor(task.achieved({name: after["channels", name] for name in task.channels}))
    if found.shape != shape:
        raise PluginError(
            f"{type(task).__name__}.achieved gives shape {tuple(found.shape)} for [P, N] = {list(shape)}; expected one "
            "number per world."
        )
    return found
