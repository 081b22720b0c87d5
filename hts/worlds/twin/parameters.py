"""Every number of the twin, with unit, source and range.

`--set world.dynamics.trunk_mass_scale=1.08` makes another robot.

Nothing here was chosen by looking at what a fine-tuned policy saves. Tags in the sources:
A read in the named source, B arithmetic on A, C recalled from the literature, E estimate (how is stated).
The numbers of an instrument (a simulated sensor) belong to the instrument's own plugin.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, SerializerFunctionWrapHandler, ValidationError, model_serializer, model_validator

from hts.config import Config
from hts.contracts import parameter
from hts.errors import ConfigError
from hts.explain import dotted, explain
from hts.worlds.twin import reality
from hts.worlds.twin.reality import REFERENCE
from hts.worlds.twin.structure import BodyStructure, SessionParameters

SERIALS = 2**31 - 1  # the largest serial number that is drawn


class DynamicsParameters(Config):
    """How the twin's body and drives differ from the training model."""

    # fmt: off
    physics_dt: float = parameter(
        0.001, 0.0005, 0.002, "s",
        "E: 1 kHz, five times finer than training, so that motor control and contact are resolved",
        "physics and motor-control step", fixed="numerics, not a machine",
    )
    trunk_mass_scale: float = parameter(
        1.04, 0.8, 1.3, "1",
        "E: +0.2 kg of cables, straps and a computer; data sheet 3.0 gives 12.0 +- 1.5 kg in all (A)",
        "factor on the trunk's mass and inertia",
    )
    com_shift_x: float = parameter(
        0.008, -0.03, 0.03, "m", "E: heavy parts and computer a little forward",
        "shift of the trunk's centre of mass forward",
    )
    com_shift_y: float = parameter(
        -0.003, -0.03, 0.03, "m", "E: parts loaded from the side",
        "shift of the trunk's centre of mass to the left",
    )
    com_shift_z: float = parameter(
        0.006, -0.03, 0.03, "m", "E: cables on top",
        "shift of the trunk's centre of mass up",
    )
    armature_scale: float = parameter(
        1.15, 0.9, 1.5, "1", "E: rotor inertia in the model leaves the gears out; planet and carrier add 10-20 %",
        "factor on reflected rotor inertia",
    )
    joint_friction: float = parameter(
        0.3, 0.2, 0.4, "N*m", "menagerie 0.2, playground 0.3, Mini Cheetah 0.2 (A)",
        "tau_c: dry friction of joints with the smallest gear ratio",
    )
    joint_friction_extra_stage: float = parameter(
        0.6, 0.3, 1.0, "N*m", "playground 1.0 (A), else E",
        "tau_c of joints with a larger gear ratio (a further stage or linkage)",
    )
    joint_damping: float = parameter(
        0.02, 0.01, 0.05, "N*m*s/rad", "Mini Cheetah 0.01 (A), E",
        "b: viscous joint friction",
    )
    gear_loss: float = parameter(
        0.05, 0.0, 0.10, "1", "planetary stage 92-97 % (trade page, A weak); 0.03-0.10, 0 switches it off",
        "mu: share of the motor torque lost as friction, joints with the smallest gear ratio",
    )
    gear_loss_extra_stage: float = parameter(
        0.07, 0.0, 0.10, "1", "as gear_loss, plus linkage (E)",
        "mu of joints with a larger gear ratio",
    )
    torque_constant_error: float = parameter(
        0.03, -0.1, 0.1, "1", "E: torque constants spread a few per cent by magnet and temperature",
        "a motor makes (1 + error) times the torque that its firmware believes",
    )
    full_torque_speed: float = parameter(
        0.5, 0.2, 1.0, "1", "E: voltage-limited motors lose torque above about half their no-load speed",
        "share of the no-load speed up to which a motor has its full torque; falls linearly to 0 at no-load speed",
    )
    actuation_delay: float = parameter(
        0.009, 0.0, 0.03, "s",
        "E: one 2 ms loop of a 500 Hz link each way, RS-485 to the drives, inference; "
        "walk-these-ways trains with 30 ms (A)",
        "from reading the sensors to the drives following the new target",
    )
    gain_scale: float = parameter(
        1.0, 0.8, 1.2, "1", "E: position gains are exact in firmware",
        "factor on kp and kd",
    )
    floor_friction: float = parameter(
        0.8, 0.3, 1.3, "1", "menagerie foot friction 0.8 (A)",
        "sliding friction of the floor",
    )
    contact_time: float = parameter(
        0.008, 0.004, 0.03, "s", "E: a rubber foot rings down in under 10 ms; training uses MuJoCo's 0.02",
        "time constant of contact (MuJoCo solref)",
    )
    contact_impratio: float = parameter(
        10.0, 1.0, 100.0, "1", "menagerie uses 100 (A); 10 keeps slip small at 1 ms",
        "ratio of friction to normal impedance",
    )
    encoder_offset: float = parameter(
        0.008, 0.0, 0.03, "rad", "E: half a degree of calibration error; walk-these-ways trains with 0.02 (A)",
        "zero error of the joint encoders, uniform within +- this, fixed per machine",
    )
    friction_spread: float = parameter(
        0.15, 0.0, 0.5, "1", "E: gears of one type differ by 10-20 %",
        "relative spread of dry friction from joint to joint, uniform within +- this, fixed per machine",
    )
    # fmt: on
    machine: int = Field(
        1,
        ge=0,
        description="serial number: seeds what is fixed per machine (offsets, spread), 1",
        json_schema_extra={"unit": "1", "source": "by definition", "range": [0, SERIALS]},
    )
    structure: BodyStructure = Field(default_factory=BodyStructure, description="structures, off by default")


class SensorParameters(Config):
    """How the robot's own sensors, the camera beside it and the scale see it."""

    # fmt: off
    position_noise: float = parameter(
        0.001, 0, 0.02, "rad", "E: encoder noise seen through gear play",
        "joint angle, sigma",
        drawn=(0.0002, 0.02),
    )
    velocity_noise: float = parameter(
        0.05, 0, 1.0, "rad/s", "E: differentiated encoder, filtered",
        "joint speed, sigma",
        drawn=(0.01, 1),
    )
    velocity_word: float = parameter(
        0.00123, 0, 0.1, "rad/s", "Q7 word at the rotor / 6.33 (actuator_sdk, B)",
        "step of the joint speed word; 0: none",
        drawn=(0.001, 0.1),
    )
    torque_noise: float = parameter(
        0.15, 0, 2.0, "N*m", "E: torque estimates from motor current are noisy (walk-these-ways issue 34, A)",
        "torque estimate, sigma",
        drawn=(0.02, 2),
    )
    torque_word: float = parameter(
        0.0247, 0, 0.5, "N*m", "Q8 word at the rotor x 6.33 (actuator_sdk, B)",
        "step of the torque word; 0: none",
        drawn=(0.005, 0.5),
    )
    gyro_noise: float = parameter(
        0.02, 0, 0.5, "rad/s", "E: consumer MEMS at 50 Hz with body vibration",
        "angular velocity, sigma",
        drawn=(0.005, 0.5),
    )
    gravity_noise: float = parameter(
        0.005, 0, 0.1, "1", "E: attitude filter, 0.3 degrees",
        "projected gravity, sigma per axis",
        drawn=(0.001, 0.1),
    )
    tilt_error: float = parameter(
        0.008, 0, 0.05, "rad", "E: mounting and attitude drift of half a degree (comm.h notes drift, A)",
        "constant roll and pitch error, uniform within +- this, fixed per machine",
    )
    foot_force_noise: float = parameter(
        3.0, 0, 20, "N", "E: raw air-bag sensor",
        "foot force, sigma",
        drawn=(0.2, 20),
    )
    foot_force_drift: float = parameter(
        0.3, 0, 5, "N/sqrt(s)", "E; drift is reported (legged_sdk issue 86, A)",
        "foot force, random walk",
        drawn=(0.05, 5),
    )
    foot_force_gain: float = parameter(
        0.05, 0, 0.3, "1", "E",
        "gain error of each foot sensor, uniform within +-, fixed per machine",
    )
    camera_speed_noise: float = parameter(
        0.03, 0, 0.3, "m/s", "E: motion capture, 0.4 mm between frames of 20 ms (sqrt 2 x 0.4 mm / 20 ms)",
        "base velocity, sigma per axis",
        drawn=(0.003, 0.3),
    )
    camera_scale_error: float = parameter(
        0.0, -0.02, 0.02, "1", "E: calibrated volume",
        "relative error of the base velocity",
    )
    scale_resolution: float = parameter(
        0.05, 0.001, 1.0, "kg", "E: a floor scale",
        "step of the weight someone reads off",
    )
    # fmt: on


MACHINE = ("dynamics", "sensors", "sessions", "instruments")  # what a reality says


class TwinSettings(Config):
    """A twin: its body, its sensors, its instruments, and how sessions on it go.

    With `reality`, the first three are what its file says, which only the twin's own process reads.
    """

    reality: Annotated[str | None, REFERENCE] = Field(
        None, description="a drawn twin: its name (`hts realities list`) or file; null: the twin of the settings below"
    )
    reality_sha256: str | None = Field(None, description="of the reality's file, filled in; another file is refused")
    dynamics: DynamicsParameters = Field(default_factory=DynamicsParameters, description="body and drives")
    sensors: SensorParameters = Field(default_factory=SensorParameters, description="what the robot sees of itself")
    sessions: SessionParameters = Field(default_factory=SessionParameters, description="how each session differs")
    instruments: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="name of an instrument -> its settings, validated by its own plugin"
    )
    warmup_seconds: float = Field(
        20.0, ge=1, description="walking with the reference before a head-to-head, s; heat then settles"
    )
    block_seconds: float = Field(80.0, gt=0, description="length of each of the four blocks of a head-to-head, s")
    unsteady_seconds: float = Field(2.0, ge=0, description="start of each block that evaluation should leave out, s")
    max_worlds: int = Field(6, ge=1, description="robots that one process simulates together, at most")
    processes: int = Field(0, ge=0, description="processes side by side; 0: one per core")

    @model_validator(mode="before")
    @classmethod
    def _named(cls, values: Any) -> Any:
        """The hash of the reality's file, and nothing beside it that would make it another machine."""
        if not isinstance(values, Mapping) or not isinstance(values.get("reality"), str):
            return values
        reference, expected = values["reality"], values.get("reality_sha256")
        beside = [name for name in MACHINE if values.get(name)]
        if beside:
            raise ConfigError(
                f"world.{beside[0]}: world.reality={reference} says all of the machine; leave one of the two out."
            )
        found = reality.sha256(reality.locate(reference))
        if expected is not None and found != expected:
            raise ConfigError(reality.changed(reference, found, expected))
        return {**values, "reality_sha256": found}

    @model_serializer(mode="wrap")
    def _referred(self, whole: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """With a reality, its name and hash stand for the machine."""
        content: dict[str, Any] = whole(self)
        hidden = MACHINE if self.reality is not None else ("reality", "reality_sha256")
        return {name: value for name, value in content.items() if name not in hidden}


def resolved_settings(settings: TwinSettings, robot: str) -> TwinSettings:
    """The settings with what the file of their reality says; themselves without one. Raises ConfigError.

    For the twin's own process; everybody else has the reality's name and hash.
    """
    if settings.reality is None:
        return settings
    content = reality.for_robot(reality.read(settings.reality, settings.reality_sha256), robot)
    try:
        machine = TwinSettings.model_validate({name: content.get(name, {}) for name in MACHINE})
    except ValidationError as error:
        raise ConfigError(
            explain(error, TwinSettings, lambda at: f"reality {settings.reality}: {dotted(at)}")
        ) from error
    return settings.model_copy(update={name: values for name, values in machine if name in MACHINE})


def parameters_hash(settings: TwinSettings, instruments: Mapping[str, Mapping[str, Any]]) -> str:
    """SHA-256 of everything that makes this twin the machine it is; not of how sessions on it go.

    instruments: name -> `Instrument.describe()` of each instrument that it carries.
    """
    return hashlib.sha256(json.dumps(resolved(settings, instruments), sort_keys=True).encode()).hexdigest()


def resolved(settings: TwinSettings, instruments: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """All parameters with their values, as they go into the hash and into docs/twin-calibration.json."""
    content: dict[str, Any] = {
        "dynamics": settings.dynamics.model_dump(mode="json"),
        "sensors": settings.sensors.model_dump(mode="json"),
        "instruments": {name: dict(values) for name, values in sorted(instruments.items())},
    }
    if settings.dynamics.structure == BodyStructure():
        del content["dynamics"]["structure"]  # off: it is the twin of before there were structures
    if settings.sessions != SessionParameters():
        content["sessions"] = settings.sessions.model_dump(mode="json")
    return content
