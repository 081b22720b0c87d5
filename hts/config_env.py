"""The part of a run's configuration that says what the training environment is like: worlds, commands, rewards."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field, NonNegativeFloat, field_validator

from hts.config_base import SEEDS, Config, Range

MOST_MODELS = 10_000  # 30 s and 5 GB for a robot with 12 joints
# m and rad. No trunk's centre of mass is a metre off, no encoder's zero 57 degrees: in mm and degrees they seem so.
MOST_SHIFT, MOST_OFFSET = 1.0, 1.0
MOST_THREADS = 1024  # each holds a state of the physics; no machine has as many cores
DELAY_STEPS = (0, 3)
Pulls = NonNegativeFloat | tuple[NonNegativeFloat, ...]


def within_a_step(steps: tuple[int, int], substeps: int) -> tuple[int, int]:
    """Actuation delay in physics steps as a robot has it whose control step is so many. The default ends with the
    control step where that is shorter, the longest delay that the env simulates; what somebody chose stays."""
    return (0, min(DELAY_STEPS[1], substeps)) if tuple(steps) == DELAY_STEPS else steps


def _several(value: Any) -> Any:
    """One number as a list of it."""
    return (value,) if isinstance(value, int | float) else value


def within(ends: tuple[float, float], most: float, unit: str, mistaken: str) -> tuple[float, float]:
    """Both ends of a range, if neither is further from 0 than `most`, which no machine is. Raises ValueError.
    mistaken: the unit that they then probably are in."""
    if max(map(abs, ends)) > most:
        raise ValueError(f"expected two numbers from {-most:g} to {most:g} {unit} (write {unit}, not {mistaken})")
    return ends


class RandomisationConfig(Config):
    """What differs between env instances; (low, high) of a uniform distribution."""

    enabled: bool = Field(True, description="false: every world is the nominal one")
    friction: Range = Field((0.4, 1.2), description="sliding friction of the floor, 1")
    added_mass: Range = Field((-1.0, 2.0), description="added to the trunk, kg")
    com_shift: Range = Field((-0.02, 0.02), description="of the trunk's centre of mass, each axis, m")
    strength: Range = Field((0.9, 1.1), description="factor on kp and kd, 1")
    joint_friction: Range = Field((0.7, 2.5), description="factor on dry joint friction, 1")
    joint_offset: Range = Field((-0.02, 0.02), description="encoder zero error, rad")
    push_speed: float = Field(0.5, ge=0, description="horizontal push, a jump of the velocity up to this, m/s; 0: none")
    push_interval: float = Field(8.0, allow_inf_nan=True, gt=0, description="mean time between pushes, s")
    pull: Annotated[tuple[NonNegativeFloat, ...], BeforeValidator(_several, json_schema_input_type=Pulls)] = Field(
        (0.0,),
        min_length=1,
        description="horizontal pull as of a slope, up to this on each axis, m/s²; 0: none; several: instance n gets "
        "pull[n mod len]",
    )
    pull_seconds: float = Field(3.0, allow_inf_nan=True, gt=0, description="mean time until it is another, s")
    delay_steps: tuple[int, int] = Field(
        DELAY_STEPS,
        description="actuation delay in physics steps, inclusive range; the default ends with the control step where "
        "that has fewer",
    )
    delay_share: tuple[Annotated[float, Field(ge=0, le=1)], Annotated[float, Field(ge=0, le=1)]] | None = Field(
        None, description="the same as shares of a control step, whatever the robot's physics step; null: `delay_steps`"
    )
    models: int = Field(
        32,
        ge=1,
        le=MOST_MODELS,
        description="size of the pool of randomised models that worlds share, on either engine",
    )

    @field_validator("strength")
    @classmethod
    def _above_zero(cls, ends: tuple[float, float]) -> tuple[float, float]:
        if not min(ends) > 0:
            raise ValueError("expected two numbers above 0")
        return ends

    @field_validator("friction", "joint_friction")
    @classmethod
    def _not_negative(cls, ends: tuple[float, float]) -> tuple[float, float]:
        if min(ends) < 0:
            raise ValueError("expected two numbers of at least 0")
        return ends

    @field_validator("com_shift")
    @classmethod
    def _metres(cls, ends: tuple[float, float]) -> tuple[float, float]:
        return within(ends, MOST_SHIFT, "m", "mm")

    @field_validator("joint_offset")
    @classmethod
    def _radians(cls, ends: tuple[float, float]) -> tuple[float, float]:
        return within(ends, MOST_OFFSET, "rad", "degrees")

    @field_validator("delay_steps", "delay_share")
    @classmethod
    def _in_order(cls, ends: tuple[float, float] | None) -> tuple[float, float] | None:
        if ends is not None and not 0 <= ends[0] <= ends[1]:
            raise ValueError("expected two numbers from 0 on, the smaller one first")
        return ends

    def delays(self, substeps: int) -> tuple[int, int]:
        """Actuation delay in physics steps, of which a control step has so many; inclusive range."""
        if self.delay_share is None:
            return within_a_step(self.delay_steps, substeps)
        least, most = (round(share * substeps) for share in self.delay_share)
        return least, most


class CommandConfig(Config):
    """What velocities are asked for in training; uniform ranges."""

    vx: Range = Field((-1.5, 1.5), description="forward velocity, m/s")
    vy: Range = Field((-0.5, 0.5), description="sideways velocity, m/s")
    yaw_rate: Range = Field((-1.0, 1.0), description="limits of the yaw rate, rad/s")
    heading: bool = Field(True, description="yaw rate = clip(gain · heading error), as Rudin et al. 2022")
    heading_gain: float = Field(0.5, ge=0, description="rad/s per rad")
    resample_seconds: float = Field(10.0, allow_inf_nan=True, gt=0, description="a new command every so often, s")
    straight: float = Field(
        0.3, ge=0, le=1, description="share of env instances with the command vy = 0 that keep their heading"
    )
    fixed: tuple[float, ...] = Field(
        (), description="test speeds, m/s: env instance n walks straight at fixed[n mod len], for good"
    )
    stand: float = Field(0.05, ge=0, le=1, description="share of env instances with the command to stand still")
    stand_below: float = Field(0.2, ge=0, description="a slower command, forward and sideways together, is 0, m/s")
    held_from: float = Field(
        0.3,
        gt=0,
        description="where fine-tuning holds the speed: slower forward commands are left out, since little is a large "
        "share of them, m/s",
    )


class EnvConfig(Config):
    """The training environment: commands, rewards, randomisation, time-out."""

    episode_seconds: float = Field(20.0, gt=0, description="time-out, s")
    stagger: bool = Field(
        False, description="first episodes end at times that are spread, so that not all instances start again together"
    )
    commands: CommandConfig = Field(default_factory=CommandConfig, description="what velocities are asked for")
    randomisation: RandomisationConfig = Field(
        default_factory=RandomisationConfig, description="what differs between env instances"
    )
    observation_noise: float = Field(1.0, ge=0, description="factor on the sensor noise of training, 1")
    tracking_sigma: float = Field(
        0.05, gt=0, description="width of the tracking terms exp(-error^2 / sigma), (m/s)^2 and (rad/s)^2"
    )
    reward_weights: dict[str, float] = Field(
        default_factory=dict, description="overrides of the task's reward weights, 1/s"
    )
    soft_joint_range: float = Field(
        0.9,
        gt=0,
        le=1,
        description="share of each joint's range, around its middle, outside of which the reward term `joint_range` "
        "counts, 1 (soft_dof_pos_limit of Rudin et al.)",
    )
    threads: int = Field(0, ge=0, le=MOST_THREADS, description="threads of the CPU engine; 0: one per core")
    seed: int = Field(0, ge=0, lt=SEEDS, description="of everything random in the env")
    contacts_per_world: int = Field(0, ge=0, description="contact buffer of the warp engine; 0: the robot's worst case")
    constraints_per_world: int = Field(0, ge=0, description="constraint rows of the warp engine; 0: the worst case")
    device: str = Field("auto", description="torch device of the env; auto: cpu for `mujoco`, cuda for `warp`")
