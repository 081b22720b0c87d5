"""Trimming in the training simulation. Each env instance is a machine of its own, so each is trimmed by its own speed,
as a world trims its machine: what simulation judges and what a world that holds the speed measures are the same thing.
How far machines are apart at one command costs nothing in reality, and a machine that stands still does.

    u <- clip(u + k (v* - v) dt, limits)        once the start is over
    u* = mean(u) + (v* - mean(v))               over the last part
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, TransformedEnv

from hts.contracts import HoldSpeed
from hts.envs.commands import WalksAsTold
from hts.errors import ConfigError
from hts.rl.task_env import SplitStepEnv

SECONDS = 10.0  # half of what a world takes: simulation measures speed without a sensor's noise
SETTLING = 1.5  # s, the start from standing
BEGIN = 5.0  # s, from when on the command is taken
GAIN = 1.0  # k, 1/s

Act = Callable[[TensorDictBase], TensorDictBase]


@dataclass(frozen=True)
class Trimmed:
    """Where trimming left an env: commands [P, N], m/s, now told; what its last step returned, to go on from; and which
    instances fell on the way [P, N], whose commands mean nothing."""

    commands: torch.Tensor
    state: TensorDictBase
    fallen: torch.Tensor


def trim(env: EnvBase, act: Act, asked: torch.Tensor, hold: HoldSpeed, forward: Act) -> Trimmed:
    """Find the command of each instance at which it walks the asked speed; the env is left walking.

    env: of batch size [P, N]; act: the policies' actions; asked: speed of each instance, m/s, [N]; forward: the speed
    forward [P, N], m/s, in what a step returned. Raises ConfigError for an env that cannot be told other speeds.
    """
    walker = told(env)
    ranges = asked.new_tensor([hold.within(speed) for speed in asked.tolist()])
    low, high = ranges[:, 0], ranges[:, 1]
    asked = asked.expand(env.batch_size)
    command = asked.clamp(low, high)
    walker.walk_at(command)
    state = env.reset()
    fallen = torch.zeros(env.batch_size, dtype=torch.bool, device=env.device)
    sums, counted = torch.zeros(2, *command.shape, device=env.device), 0
    for step in range(round(SECONDS / env.dt)):
        data, state = env.step_and_maybe_reset(act(state))
        fallen |= data["next", "terminated"].squeeze(-1)
        walked = forward(data["next"])
        if step * env.dt >= BEGIN:
            sums, counted = sums + torch.stack((command, walked)), counted + 1
        if step * env.dt >= SETTLING:
            command = (command + GAIN * env.dt * (asked - walked)).clamp(low, high)
            walker.walk_at(command)
    sent, walked = sums / counted
    command = (sent + asked - walked).clamp(low, high)
    walker.walk_at(command)
    return Trimmed(command, state, fallen)


class _Together(WalksAsTold):
    """Groups of candidates, each told its own part."""

    def __init__(self, groups: Sequence[EnvBase]) -> None:
        self._groups = groups

    def walk_at(self, commands: torch.Tensor) -> None:
        parts = commands.split([group.batch_size[0] for group in self._groups])
        for group, part in zip(self._groups, parts, strict=True):
            assert isinstance(group, WalksAsTold)
            group.walk_at(part)


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
