"""Trimming in the training simulation: the command of each candidate at each speed that makes its env instances walk
the asked speed on average. So what is predicted and what a world that holds the speed measures are at one speed.

    u <- clip(u + k (v* - v) dt, limits)        v: mean over the instances that have not fallen
    u* = mean(u) + (v* - mean(v))               over the last part, as a world does it
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, TransformedEnv

from hts.contracts import HoldSpeed
from hts.envs.commands import WalksAsTold
from hts.errors import ConfigError
from hts.rl.task_env import SplitStepEnv

SECONDS = 6.0  # many instances at once: their mean is quieter than one robot's sensor
SETTLING = 1.5  # s, the start from standing
BEGIN = 4.0  # s, from when on the command is taken
GAIN = 1.0  # k, 1/s

Act = Callable[[TensorDictBase], TensorDictBase]


def trim(env: EnvBase, act: Act, speeds: Sequence[float], hold: HoldSpeed, forward: Act) -> torch.Tensor:
    """Commands [P, S], m/s; the env is left walking at them, wherever it is in its trials.

    env: of batch size [P, N], instance n walks at speeds[n mod S]; act: the policies' actions; forward: the speed
    forward [P, N], m/s, in what a step returned. Raises ConfigError for an env that cannot be told other speeds.
    """
    walker = told(env)
    low, high = hold.commands
    member = torch.arange(env.batch_size[1], device=env.device) % len(speeds)
    asked = torch.tensor(speeds, device=env.device).expand(env.batch_size[0], -1)  # [P, S]
    command = asked.clamp(low, high)
    walker.walk_at(command[:, member])
    state = env.reset()
    fallen = torch.zeros(env.batch_size, dtype=torch.bool, device=env.device)
    sums, counted = torch.zeros(2, *command.shape, device=env.device), 0
    for step in range(round(SECONDS / env.dt)):
        data, state = env.step_and_maybe_reset(act(state))
        fallen |= data["next", "terminated"].squeeze(-1)
        walked = _means(forward(data["next"]), fallen, member, asked)
        if step * env.dt >= BEGIN:
            sums, counted = sums + torch.stack((command, walked)), counted + 1
        if step * env.dt >= SETTLING:
            command = (command + GAIN * env.dt * (asked - walked)).clamp(low, high)
            walker.walk_at(command[:, member])
    sent, walked = sums / counted
    command = (sent + asked - walked).clamp(low, high)
    walker.walk_at(command[:, member])
    return command


class _Together(WalksAsTold):
    """Groups of candidates, each told its own part."""

    def __init__(self, groups: Sequence[EnvBase]) -> None:
        self._groups = groups

    def walk_at(self, commands: torch.Tensor) -> None:
        parts = commands.split([group.batch_size[0] for group in self._groups])
        for group, part in zip(self._groups, parts, strict=True):
            assert isinstance(group, WalksAsTold)
            group.walk_at(part)


def _means(speed: torch.Tensor, fallen: torch.Tensor, member: torch.Tensor, asked: torch.Tensor) -> torch.Tensor:
    """Mean speed [P, S] of the instances [P, N] at each speed that stand; the asked one where none does."""
    columns = []
    for index in range(asked.shape[1]):
        stood = (member == index) & ~fallen
        mean = (speed * stood).sum(1) / stood.sum(1).clamp_min(1)
        columns.append(torch.where(stood.any(1), mean, asked[:, index]))
    return torch.stack(columns, 1)


def told(env: EnvBase) -> WalksAsTold:
    """The env, under its transforms, as one that can be told other speeds. Raises ConfigError where it cannot."""
    base = env
    while isinstance(base, TransformedEnv):
        base = base.base_env
    if isinstance(base, WalksAsTold):
        return base
    groups = base.groups() if isinstance(base, SplitStepEnv) else ()
    if groups and all(isinstance(group, WalksAsTold) for group in groups):
        return _Together(groups)
    raise ConfigError(
        f"The env of this robot ({type(base).__name__}) takes no other speed while it runs, so none can be held in "
        "simulation. Leave it out: --set simulation_test.hold_speed=false"
    )
