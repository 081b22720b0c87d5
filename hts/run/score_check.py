"""The score of an objective, tried on made-up numbers before anything is spent: a misspelt channel shows at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.contracts import Objective, Robot
from hts.errors import PluginError, RecordingError
from hts.evaluation.segments import Segments
from hts.recordings.recording import Recording, Series

SEGMENTS = 3
MISTAKES = (RecordingError, LookupError, AttributeError, NameError, TypeError, ImportError)
"""What wrong names and types raise. Anything else may be the score's opinion of numbers that nobody measured."""


def check_score(objective: Objective, robot: Robot, package: str) -> None:
    """Raise PluginError for a score that reads a channel that no recording of this robot has, fails on a recording, or
    is not one number per segment."""
    what = f"Objective '{objective.name}' (from {package}): score"
    try:
        with np.errstate(all="ignore"):
            scores = objective.score(made_up_segments(robot, objective.real_channels))
    except MISTAKES as error:
        text = " ".join(str(error).split()).rstrip(".")
        raise PluginError(
            f"{what} fails on a recording of '{robot.spec.name}' with all that the robot and the objective name, "
            f"{type(error).__name__}: {text}. Correct it, or name the channel in `also_measured`."
        ) from error
    except Exception:  # noqa: BLE001 - it may refuse these numbers with reason
        return
    if not isinstance(scores, Mapping):
        raise PluginError(
            f"{what} gives a {type(scores).__name__}, expected names with arrays, one number per segment."
        )
    for name, values in scores.items():
        if np.shape(values) != (SEGMENTS,):
            raise PluginError(
                f"{what} '{name}' has shape {np.shape(values)} for {SEGMENTS} segments, expected one number for each."
            )


def made_up_segments(robot: Robot, measured: Sequence[Channel]) -> Segments:
    """SEGMENTS valid seconds of one recording: every sim channel of the robot and every measured one, between 0.5 and
    1.5 in the channel's unit, idle at 0.1."""
    spec, rng = robot.spec, np.random.default_rng(0)
    samples = round(spec.control_rate_hz)
    count = SEGMENTS * samples
    channels = {**robot.channels(), **{one.name: one for one in measured}}
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
        idle={one.name: 0.1 for one in measured},
        clock="simulated",
        time=np.arange(count) / spec.control_rate_hz,
        channels={name: Series(one, rng.uniform(0.5, 1.5, (count, *one.shape))) for name, one in channels.items()},
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
