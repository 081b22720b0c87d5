"""Commanded velocities of the env instances: resampling, heading control, fixed test speeds."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping

import torch

from hts.channels import MISSED_CHANNELS
from hts.config import CommandConfig
from hts.rl.tracing import any_or_tracing

SETTLING_SECONDS = 1.0  # after standing up
SMOOTHING_SECONDS = 1.0  # of the speed that may miss the command: about a second, as in the segments of a head-to-head
OWN_SECONDS = 4.0  # of an instance's own speed: longer than a push is felt, shorter than a command lasts
TRIMMED_AWAY = 0.25  # of the commanded speed: an own speed as far off as that is trimmed away where a speed is held
LARGEST_MISS = 1.0  # of the commanded speed: who stands misses it by that much, and no push counts for more
DRAWS = 7  # uniform numbers an env instance needs to resample: vx, vy, heading, yaw rate, straight?, stand?, when


class WalksAsTold(ABC):
    """An env whose instances walk straight at test speeds (`CommandConfig.fixed`) that can be changed on the way."""

    @abstractmethod
    def walk_at(self, commands: torch.Tensor) -> None:
        """From now on, also after a reset, the commanded forward velocity of each instance, m/s, [P, N]."""


class Commands:
    """The command [P, N, 3] (vx m/s, vy m/s, yaw rate rad/s) of each instance and what it follows from."""

    STATE = ("value", "heading", "keeps_heading", "steps_left", "told_seconds", "smoothed_error", "own_error")

    def __init__(
        self,
        config: CommandConfig,
        shape: tuple[int, int],
        dt: float,
        device: torch.device,
        channels: Iterable[str] = (),
    ) -> None:
        """channels: that the env writes, by name."""
        self.config, self.dt = config, dt
        self._watches = not {channel.name for channel in MISSED_CHANNELS}.isdisjoint(channels)
        self.value = torch.zeros(*shape, 3, device=device)
        self.heading = torch.zeros(shape, device=device)  # target, rad
        self.keeps_heading = torch.ones(shape, dtype=torch.bool, device=device)
        self.steps_left = torch.zeros(shape, device=device)
        self.told_seconds = torch.zeros(shape, device=device)  # since this command, or since it was stood up
        self.smoothed_error = torch.zeros(shape, device=device)  # relative, of the speed, from settling on
        self.own_error = torch.zeros(shape, device=device)  # the same over `OWN_SECONDS`
        if config.fixed:
            speeds = torch.tensor(config.fixed, device=device)
            self.fixed = speeds[torch.arange(shape[1], device=device) % len(config.fixed)].expand(shape)
        else:
            self.fixed = None

    def speed_error(self, forward: torch.Tensor, seconds: torch.Tensor) -> torch.Tensor:
        """Channel `speed_error`, [P, N]: robots that have just been stood up are still getting going.

        forward: velocity, m/s; seconds: since it was stood up; both [P, N].
        """
        asked = self.value[..., 0]
        counts = (asked.abs() >= self.config.held_from) & (seconds > SETTLING_SECONDS)
        error = forward / torch.where(counts, asked, 1.0) - 1.0
        return torch.where(counts, error, 0.0)

    def speed_error_trend(self, forward: torch.Tensor, seconds: torch.Tensor) -> torch.Tensor:
        """Channel `speed_error_trend`, [P, N]; as `speed_error`."""
        low, high = self._counted
        middle, half = (high + low) / 2, max((high - low) / 2, 1e-6)
        place = ((self.value[..., 0].abs() - middle) / half).clamp(-1.0, 1.0)
        return self.speed_error(forward, seconds) * place

    def speed_missed_slow(self, forward: torch.Tensor, seconds: torch.Tensor) -> torch.Tensor:
        """Channel `speed_missed_slow`, [P, N]: of what `watch` saw, once it has seen a whole second."""
        return self._missed(self.value[..., 0].abs() < self._middle)

    def speed_missed_fast(self, forward: torch.Tensor, seconds: torch.Tensor) -> torch.Tensor:
        """Channel `speed_missed_fast`, [P, N]; as `speed_missed_slow`."""
        return self._missed(self.value[..., 0].abs() >= self._middle)

    def _missed(self, where: torch.Tensor) -> torch.Tensor:
        seen = self.told_seconds - SETTLING_SECONDS
        counts = where & (self.value[..., 0].abs() >= self.config.held_from) & (seen > SMOOTHING_SECONDS)
        now, own = (
            error / (1.0 - torch.exp(-seen.clamp(min=self.dt) / seconds))  # of the average that has been filled
            for error, seconds in ((self.smoothed_error, SMOOTHING_SECONDS), (self.own_error, OWN_SECONDS))
        )
        missed = (now - own).abs() + (own.abs() - TRIMMED_AWAY).clamp(min=0.0)
        return torch.where(counts, missed.clamp(max=LARGEST_MISS), 0.0)

    @property
    def _middle(self) -> float:
        """Between slow and fast commands, m/s: as many times the slowest as the fastest is of it."""
        low, high = self._counted
        return math.sqrt(low * high)

    @property
    def _counted(self) -> tuple[float, float]:
        """Commands of which errors count, m/s."""
        least, high = self.config.held_from, max(abs(end) for end in self.config.vx)
        return max(least, min(self.config.vx)), max(high, least)

    def watch(self, forward: torch.Tensor) -> None:
        """One control step's velocity forward, m/s, [P, N], for the channels of how far it is missed."""
        asked = self.value[..., 0]
        error = forward / torch.where(asked.abs() >= self.config.held_from, asked, 1.0) - 1.0
        settled = self.told_seconds >= SETTLING_SECONDS
        moved = self.smoothed_error + self.dt / SMOOTHING_SECONDS * (error - self.smoothed_error)
        own = self.own_error + self.dt / OWN_SECONDS * (error - self.own_error)
        self.smoothed_error = torch.where(settled, moved, 0.0)
        self.own_error = torch.where(settled, own, 0.0)
        self.told_seconds = self.told_seconds + self.dt

    def resample(self, mask: torch.Tensor, draws: torch.Tensor, yaw: torch.Tensor) -> None:
        """New commands where mask [P, N]; draws [P, N, DRAWS] uniform in [0, 1); yaw [P, N] rad now."""
        c = self.config
        if self.fixed is not None:
            new = torch.stack((self.fixed, torch.zeros_like(yaw), torch.zeros_like(yaw)), -1)
            heading, keeps = yaw, torch.ones_like(mask)
            self.steps_left = torch.where(mask, math.inf, self.steps_left)
        else:
            vx, vy, yaw_rate = (
                low + (high - low) * draws[..., index] for index, (low, high) in ((0, c.vx), (1, c.vy), (3, c.yaw_rate))
            )
            straight = draws[..., 4] < c.straight
            vy = torch.where(straight, 0.0, vy)
            stand = (draws[..., 5] < c.stand) | (vx.square() + vy.square() < c.stand_below**2)
            heading = torch.where(straight | stand, yaw, (2 * draws[..., 2] - 1) * math.pi)
            keeps = torch.full_like(mask, c.heading) | straight
            new = torch.stack((vx, vy, yaw_rate), -1) * (~stand).unsqueeze(-1)
            steps = (
                c.resample_seconds / self.dt * (0.5 + draws[..., 6])
            )  # spread, so that instances do not resample together
            self.steps_left = torch.where(mask, steps, self.steps_left)
        self.value = torch.where(mask.unsqueeze(-1), new, self.value)
        self.told_seconds = self.told_seconds.masked_fill(mask, 0.0)
        self.smoothed_error = self.smoothed_error.masked_fill(mask, 0.0)
        self.own_error = self.own_error.masked_fill(mask, 0.0)
        self.heading = torch.where(mask, heading, self.heading)
        self.keeps_heading = torch.where(mask, keeps, self.keeps_heading)

    def walk_at(self, commands: torch.Tensor) -> None:
        """Other test speeds, m/s, [P, N], in place of `CommandConfig.fixed`."""
        self.fixed = commands
        self.value = torch.cat((commands.unsqueeze(-1), self.value[..., 1:]), -1)

    def advance(self, draws: torch.Tensor, yaw: torch.Tensor, forward: torch.Tensor) -> None:
        """One control step passes: resample where due, then steer towards the heading.

        draws: [P, N, DRAWS], uniform in [0, 1); yaw: heading now, rad; forward: velocity, m/s; both [P, N].
        """
        if self._watches:
            self.watch(forward)
        self.steps_left = self.steps_left - 1
        due = self.steps_left <= 0
        if any_or_tracing(due):
            self.resample(due, draws, yaw)
        self.steer(yaw)

    def steer(self, yaw: torch.Tensor) -> None:
        """yaw rate = clip(gain x heading error), Rudin et al. 2022, where an instance keeps a heading."""
        self._turn(self.heading - yaw, self.config.heading_gain)

    def _turn(self, error: torch.Tensor, gain: torch.Tensor | float) -> None:
        """`steer` by an error of the heading, rad, [P, N], and a gain, rad/s per rad."""
        error = torch.remainder(error + math.pi, 2 * math.pi) - math.pi
        low, high = self.config.yaw_rate
        wanted = (gain * error).clamp(low, high)
        yaw_rate = torch.where(self.keeps_heading, wanted, self.value[..., 2])
        self.value = torch.cat((self.value[..., :2], yaw_rate.unsqueeze(-1)), -1)  # the last one may be remembered

    def state_dict(self) -> dict[str, torch.Tensor]:
        return {name: getattr(self, name).clone() for name in self.STATE}

    def load_state_dict(self, state: Mapping[str, torch.Tensor]) -> None:
        for name in self.STATE:
            if name in state:  # checkpoints of before 0.2 do not watch the speed
                setattr(self, name, state[name].to(self.value.device).clone())
