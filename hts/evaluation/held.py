"""Speed that is held: what a run asks of its world, and whether two policies really walked at one speed.

Walking slower saves without being better. So the command of each policy is trimmed by the measured speed before its
blocks and then frozen (`World.hold_speed`). Two things can go wrong, and both are refused: a command that reached the
end of its range, and mean speeds that are apart all the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hts.config import EvaluationConfig, RunConfig
from hts.contracts import FollowVelocity, HoldSpeed, Robot, World
from hts.errors import ConfigError, EvaluationError, RecordingError
from hts.evaluation.balance import Balance
from hts.evaluation.segments import Segments
from hts.evaluation.sessions import interval_of

if TYPE_CHECKING:
    from hts.recordings.recording import Recording


NAMES = {"policy": "the policy", "reference": "the reference policy"}


class NotComparable(EvaluationError):
    """Nothing can be reported about the policy against the reference; `role` says because of which of them.

    numbers: asked `speed` and mean speed `walked` (None if unknown), m/s; `valid` share of the segments; `falls`;
    `reference_walked`, m/s, only where it is the policy, and the reference has too few segments as well.
    """

    def __init__(self, message: str, role: str = "policy", numbers: Mapping[str, float | None] | None = None) -> None:
        super().__init__(message)  # the message alone: whoever adds to it raises one of the same kind
        self.role, self.numbers = role, numbers or {}


class SpeedNotHeld(NotComparable):
    """The two did not walk at one speed, though it was to be held."""


class CommandAtLimit(SpeedNotHeld):
    """A command was held back by the end of its range: trimming longer does not help."""


@dataclass(frozen=True)
class Commanded:
    """Mean commands sent to policy and reference, m/s; held: whether trimmed and frozen, or simply the asked speed."""

    policy: float
    reference: float
    held: bool


def hold_of(config: RunConfig) -> HoldSpeed | None:
    """How a run's world holds the speed; None if it does not."""
    evaluation = config.evaluation
    if not evaluation.hold_speed:
        return None
    return HoldSpeed(config.finetune.env.commands.vx, evaluation.trim_seconds, evaluation.held_tolerance)


def check_hold(config: RunConfig) -> None:
    """Raise ConfigError if a speed that is to be held lies outside the commands that may be sent."""
    hold = hold_of(config)
    if hold is None:
        return
    check_held("selection", config.selection.tested_speeds, hold)
    check_held("evaluation", config.evaluation.speeds, hold)


def not_held_in_training(config: RunConfig, robot: Robot) -> str | None:
    """What to tell of speeds that the run compares policies at and fine-tuning does not hold, since they lie below
    `finetune.env.commands.held_from`; None if there are none, or nothing is held. Of the velocity task."""
    commands = config.finetune.env.commands
    least = commands.held_from
    slow = sorted({speed for speed in (*config.selection.tested_speeds, *config.evaluation.speeds) if speed < least})
    holds = config.finetune.hold and robot.held_at_zero and isinstance(robot.task(), FollowVelocity)
    if not (holds and slow):
        return None
    standing = f" and stand_below={slow[0]:g}" if slow[0] < commands.stand_below else ""  # else nobody is told to walk
    return (
        f"{_listed(slow)} m/s: fine-tuning holds the speed from {least:g} m/s on, so "
        "candidates may walk such speeds slower or less steadily than the pretrained policy, which is no saving. "
        f"Hold them too: --set finetune.env.commands.held_from={slow[0]:g}{standing} or less."
    )


def not_tried(config: RunConfig, robot: Robot) -> str | None:
    """What to tell of speeds that the final is at and candidates are neither simulated nor tried at; None if there are
    none. Of the velocity task."""
    known = {*config.simulation_test.speeds, *config.selection.tested_speeds}
    new = sorted(set(config.evaluation.speeds) - known)
    if not (new and isinstance(robot.task(), FollowVelocity)):
        return None
    told = _listed(config.evaluation.speeds)
    return (
        f"{_listed(new)} m/s: only the final is at such a speed; candidates are judged and tried at {_listed(known)}. "
        f"What is to be reported is better tried: --set selection.speeds=[{told}] --set simulation_test.speeds=[{told}]"
    )


def _listed(speeds: Iterable[float]) -> str:
    return ", ".join(f"{speed:g}" for speed in sorted(speeds))


def check_held(where: str, speeds: Sequence[float], hold: HoldSpeed) -> None:
    """Raise ConfigError for a speed, m/s, that lies outside the commands that may be sent. where: it was asked for."""
    low, high = hold.commands
    widen = "" if where.startswith("--") else ", or widen finetune.env.commands.vx"  # a run that is over is trained
    for speed in speeds:
        if not low < speed < high:
            raise ConfigError(
                f"{where}: {speed:g} m/s cannot be held with commands from {low:g} to {high:g} m/s, the range that "
                f"is trained. Ask for a speed inside{widen}."
            )


def ask_to_hold(world: World, hold: HoldSpeed | None) -> None:
    """`World.hold_speed`. Raises ConfigError if the world cannot."""
    if world.hold_speed(hold) or hold is None:
        return
    raise ConfigError(
        f"World '{world.name}' cannot hold a speed: it does not trim commands. Choose another world, or compare at "
        "equal commands: --set evaluation.hold_speed=false"
    )


def commanded(recordings: Mapping[str, Sequence[Recording]], speed: float) -> Commanded:
    """What was sent in the blocks of the roles "policy" and "reference", which were asked for `speed`, m/s.

    Raises EvaluationError if some blocks held the speed and others did not.
    """
    notes = {role: [recording.notes for recording in recordings[role]] for role in ("policy", "reference")}
    every = [one for role in notes.values() for one in role]
    held = ["held_command" in one for one in every]
    if any(held) and not all(held):
        raise EvaluationError(
            f"Head-to-head at {speed:g} m/s: {sum(held)} of {len(held)} blocks held the speed, the others did not. "
            "Compare blocks that were recorded in one way."
        )
    if not any(held):
        return Commanded(speed, speed, False)
    mean = {role: float(np.mean([_command(one) for one in notes[role]])) for role in notes}
    return Commanded(mean["policy"], mean["reference"], True)


def check_range(segments: Mapping[str, Segments], speed: float, sent: Commanded) -> None:
    """Raise SpeedNotHeld if a command was held back by the end of its range."""
    for role, name in NAMES.items() if sent.held else ():
        if any(recording.notes.get("held_saturated") == "true" for recording in segments[role].recordings):
            raise CommandAtLimit(
                f"Head-to-head at {speed:g} m/s: {name} cannot be held there, its command reached the end of the range "
                f"({getattr(sent, role):.2f} m/s{_walked(segments[role])}). Nothing is reported: ask for a speed that "
                "it reaches, or widen finetune.env.commands.vx.",
                role,
                refusal(segments[role], speed),
            )


def check_apart(
    segments: Mapping[str, Segments], speed: float, sent: Commanded, config: EvaluationConfig, seed: int
) -> None:
    """Raise SpeedNotHeld if held speeds are apart.

    Apart: the mean speeds over the valid segments, every block counting the same, differ by more than
    `config.held_tolerance` of the asked one, and by more than chance explains (the 95 % interval of the difference does
    not hold zero): a short test cannot tell a difference of 1 % from none, and a refusal must not be a throw of dice.
    """
    if not sent.held:
        return
    found = mean_speeds(segments["policy"], segments["reference"])
    means = dict(zip(("policy", "reference"), found, strict=True))
    apart = (means["policy"] - means["reference"]) / speed
    bounds = difference_interval(segments, speed, config.bootstrap, seed)
    if abs(apart) <= config.held_tolerance or bounds is None or bounds[0] <= 0.0 <= bounds[1]:
        return
    raise SpeedNotHeld(
        f"Head-to-head at {speed:g} m/s: the speeds are {abs(apart):.1%} apart (policy {means['policy']:.3f} m/s at "
        f"command {sent.policy:.3f}, reference {means['reference']:.3f} at {sent.reference:.3f}), at most "
        f"{config.held_tolerance:.0%} counts as one speed. Nothing is reported: trim longer (evaluation.trim_seconds).",
        "policy",
        refusal(segments["policy"], speed),
    )


def difference_interval(
    segments: Mapping[str, Segments], speed: float, resamples: int, seed: int
) -> tuple[float, float] | None:
    """95 % interval of (mean speed of the policy - mean speed of the reference) / asked speed, as of any other number;
    None if a single segment leaves nothing to tell it from."""
    return interval_of(
        lambda policy, reference: float(policy[0] - reference[0]) / speed,
        Balance.of(segments["policy"], segments["reference"]),
        segments["policy"].speed[:, None],
        segments["reference"].speed[:, None],
        resamples,
        seed,
    )


def mean_speeds(policy: Segments, reference: Segments) -> tuple[float, float]:
    """Of both over their valid segments, as `Balance` counts them, m/s; of another task what was achieved."""
    one, other = Balance.of(policy, reference).means(policy.speed[:, None], reference.speed[:, None])
    return float(one[0]), float(other[0])


def refusal(segments: Segments, speed: float) -> dict[str, float | None]:
    """The numbers of a `NotComparable`."""
    walked = None if math.isnan(segments.walked) else float(segments.walked)
    return {"speed": speed, "walked": walked, "valid": float(segments.valid), "falls": segments.falls}


def _walked(segments: Segments) -> str:
    return "" if math.isnan(segments.walked) else f", at which it went {segments.walked:.2f}"


def _command(notes: Mapping[str, str]) -> float:
    try:
        return float(notes["held_command"])
    except ValueError as error:
        raise RecordingError(
            f"A recording's note held_command is '{notes['held_command']}', expected a command in m/s."
        ) from error
