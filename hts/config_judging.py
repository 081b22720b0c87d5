"""The part of a run's configuration that says how policies are judged: in simulation, in trials, and in the final."""

from __future__ import annotations

import math

from pydantic import Field, field_validator

from hts.config_base import Config, Named


def each_once(speeds: tuple[float, ...]) -> tuple[float, ...]:
    """The same speeds, m/s, or set-points. Raises ValueError for one that is no number or there twice."""
    for speed in speeds:
        if not math.isfinite(speed):
            raise ValueError(f"{speed} is not a finite number")
    if len(set(speeds)) < len(speeds):
        raise ValueError("a speed is there twice")
    return speeds


class SimulationTestConfig(Config):
    """How candidates are judged in simulation: mean action, no exploration noise, no pushes but measured ones."""

    num_envs: int = Field(32, ge=1, description="worlds per candidate and speed")
    seconds: float = Field(8.0, ge=3.0, description="length of each trial, s; its first 2 s are not judged")
    speeds: tuple[float, ...] = Field(
        (0.8,), min_length=1, description="m/s; set-points of a robot with another task, which brings its own"
    )
    speed_tolerance: float = Field(
        0.1, gt=0, description="largest relative error of the mean speed; another task has its own use for it"
    )
    hold_speed: bool = Field(
        False, description="trim each candidate's command at each speed first, then judge it at the asked mean speed"
    )
    measured_pull: bool = Field(
        False,
        description="judge under slow pulls as strong as it takes, in simulation, to make the pretrained policy's "
        "speed wander as it did in the trials so far; from the second iteration on, needs hold_speed",
    )
    min_valid: float = Field(
        0.0,
        ge=0,
        le=1,
        description="share of seconds in which a candidate must do its task at every speed to be tried before those "
        "that do it less; where none does, that of the best one",
    )

    _each_once = field_validator("speeds")(each_once)


class SelectionConfig(Config):
    """Elites and the best."""

    selector: Named = Field(
        default_factory=lambda: Named(name="hierarchical"), description="who is tested and who goes on"
    )
    elites: int = Field(6, ge=1, description="K: candidates tried in reality per iteration")
    speed: float = Field(
        0.8, description="speed of the head-to-head during iterations, m/s; set-point of a robot with another task"
    )
    speeds: tuple[float, ...] = Field(
        (),
        description="several speeds of it, m/s, or set-points: a candidate counts by its mean over them; empty: "
        "`speed` alone",
    )
    held_tolerance: float = Field(
        0.1,
        gt=0,
        lt=1,
        description="refuse an elite at held speeds further apart than this share; blocks are short here, a slower one "
        "counts by the way it goes, and the final is stricter (evaluation.held_tolerance)",
    )
    block_seconds: float | None = Field(
        None, ge=1, description="length of each of its blocks, s; null: that of the world"
    )
    min_valid: float | None = Field(
        None,
        ge=0,
        le=1,
        description="refuse an elite below this share of valid segments, where that is more than the final asks of "
        "both policies (evaluation.min_valid): a short trial flatters",
    )
    trims_again: int = Field(
        0,
        ge=0,
        description="how often a trial repeats a speed whose means ended apart, or far from what was asked, trimmed "
        "twice and then four times as long; within `max_real_samples`",
    )
    confirm: int = Field(
        0,
        ge=0,
        description="so many of the best of all iterations are tried once more before the final, at the speeds in "
        "reverse order, and the best over both trials goes to it; 0, or a single speed: the best of one trial does",
    )

    @property
    def tested_speeds(self) -> tuple[float, ...]:
        """Speeds at which elites are tried, m/s, or set-points of another task."""
        return self.speeds or (self.speed,)

    _each_once = field_validator("speeds")(each_once)


class EvaluationConfig(Config):
    """The final head-to-head, and how segments become numbers."""

    speeds: tuple[float, ...] = Field(
        (0.5, 0.8, 1.1), min_length=1, description="m/s; set-points of a robot with another task, which brings its own"
    )
    speed_tolerance: float = Field(
        0.1, gt=0, description="a 1 s segment counts within this relative speed error; another task has its own use"
    )
    min_valid: float = Field(0.5, ge=0, le=1, description="refuse to report below this share of valid segments")
    min_segments: int = Field(10, ge=1, description="refuse to report with fewer valid segments of either policy")
    bootstrap: int = Field(2000, ge=100, description="resamples of the interval")
    sessions: int = Field(
        1,
        ge=1,
        description="how often the final is made anew, motors warmed up and speed trimmed again; from two on the "
        "interval is over sessions",
    )
    finals: int = Field(
        1,
        ge=1,
        description="how many policies may get a final: where a speed is refused for what one does, or it falls, the "
        "next best of the trials gets one; what it saves decides nothing",
    )
    each_iteration: bool = Field(
        False,
        description="for benchmarks: the best so far is also measured like the final after each iteration; nothing "
        "learns from it, and its real samples are not counted",
    )
    hold_speed: bool = Field(
        False,
        description="trim the command of policy and reference by the measured speed before their blocks and freeze it",
    )
    trim_seconds: float = Field(12.0, ge=4, description="of each policy at each held speed, settling included, s")
    held_tolerance: float = Field(
        0.01, gt=0, lt=1, description="refuse held speeds whose means differ by more than this share"
    )
    trims_again: int = Field(
        4,
        ge=0,
        description="how often the final repeats a speed whose means ended apart, or far from what was asked, trimmed "
        "twice and then four times as long",
    )

    _each_once = field_validator("speeds")(each_once)
