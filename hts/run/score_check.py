"""The score and the comparison of an objective, tried on made-up numbers before anything is spent: a misspelt channel
shows at once."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.contracts import Comparison, Objective, Robot
from hts.errors import PluginError, RecordingError
from hts.evaluation.scoring import as_scores, plain
from hts.evaluation.segments import Segments
from hts.recordings.recording import Recording, Series

SEGMENTS = 3
MISTAKES = (RecordingError, LookupError, AttributeError, NameError, TypeError, ImportError)
"""What wrong names and types raise. Anything else may be the score's opinion of numbers that nobody measured."""
SHAPES = re.compile(r"broadcast|shape|dimension|reshape|not aligned|inhomogeneous|setting an array element")
"""Of what numpy says in a ValueError where arrays do not fit each other, whatever their numbers."""


def check_score(objective: Objective, robot: Robot, package: str) -> Comparison | None:
    """Raise PluginError for a score that reads a channel that no recording of this robot has, fails on a recording, or
    is not one number per segment, and for a comparison of such scores that fails or is no numbers. Gives that
    comparison; None where the objective has reason to make none of numbers that nobody measured."""
    who = f"Objective '{objective.name}' (from {package})"
    kind = f"on a recording of '{robot.spec.name}' with all that the robot and the objective name"
    segments = made_up_segments(robot, objective.real_channels)
    found, opinion = _tried(lambda: objective.score(segments), f"{who}: score fails {kind}")
    if opinion:
        return None
    means = {name: float(values.mean()) for name, values in as_scores(who, found, SEGMENTS).items()}
    found, opinion = _tried(
        lambda: objective.compare(dict(means), dict(means)), f"{who}: compare fails on what score gives, {means}"
    )
    return None if opinion else plain(objective, found)


def gain_of_less(objective: Objective, robot: Robot) -> float | None:
    """The improvement of a policy that shows a tenth less of the target than its reference, all else alike, of made-up
    numbers; None where the objective has reason to say nothing of these."""
    try:
        with np.errstate(all="ignore"):
            low, high = (
                {name: float(np.mean(values)) for name, values in objective.score(made_up).items()}
                for made_up in (made_up_segments(robot, objective.real_channels, share) for share in (0.9, 1.0))
            )
            found = float(objective.compare(low, high).improvement)
    except Exception:  # noqa: BLE001 - `check_score` tells a stranger's mistakes from opinions
        return None
    return found if np.isfinite(found) else None


def _tried(work: Callable[[], Any], what: str) -> tuple[Any, bool]:
    """What it gives, and whether it gave none, as it may with reason. Raises PluginError, beginning with `what`, for a
    mistake, which other numbers would not mend."""
    try:
        with np.errstate(all="ignore"):
            return work(), False
    except Exception as error:
        text = " ".join(str(error).split()).rstrip(".")
        mistaken = isinstance(error, MISTAKES) or (isinstance(error, ValueError) and SHAPES.search(text))
        if not mistaken:
            return None, True
        raise PluginError(
            f"{what}, {type(error).__name__}: {text}. Correct it, or name the channel in `also_measured`."
        ) from error


def made_up_segments(robot: Robot, measured: Sequence[Channel], share: float = 1.0) -> Segments:
    """SEGMENTS valid seconds of one recording: every sim channel of the robot and every measured one, between 0.5 and
    1.5 in the channel's unit, idle at 0.4, below all of them. share: of the first measured one, so much is left."""
    spec, rng = robot.spec, np.random.default_rng(0)
    samples = round(spec.control_rate_hz)
    count = SEGMENTS * samples
    channels = {**robot.channels(), **{one.name: one for one in measured}}
    values = {name: rng.uniform(0.5, 1.5, (count, *one.shape)) for name, one in channels.items()}
    values |= {one.name: values[one.name] * share for one in measured[:1]}
    recording = Recording(
        robot=spec.name,
        world="made-up",
        policy_hash="0" * 64,
        iteration=0,
        joint_names=spec.joint_names,
        kp=spec.kp,
        kd=spec.kd,
        rate_hz=spec.control_rate_hz,
        schedule=ScheduleConfig(commands=(Command(seconds=float(SEGMENTS), vx=1.0),)),
        idle={one.name: 0.4 for one in measured},
        clock="simulated",
        time=np.arange(count) / spec.control_rate_hz,
        channels={name: Series(one, values[name]) for name, one in channels.items()},
        mass_kg=10.0,
    )
    once = np.ones(SEGMENTS)
    return Segments(
        recordings=(recording,),
        samples=samples,
        recording=np.zeros(SEGMENTS, dtype=int),
        start=np.arange(SEGMENTS) * samples,
        speed=once,
        commanded=once,
        block=np.zeros(SEGMENTS, dtype=int),
        total=SEGMENTS,
        falls=0,
        walked=1.0,
    )
