"""Every number of the microphone, with unit, source and range.

`--set world.instruments.microphone.foot_modulus=12e6` makes another one.

Tags in the sources: A read in the named source, B arithmetic on A, C recalled from the literature, E estimate. No
absolute level of a walking robot of this kind was found, so levels are placeholders; differences between policies are
what counts.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, model_validator

from hts.contracts import parameter as number
from hts.contracts import parameters as numbers

MODES = (6, 10)  # how many
FREQUENCY = (60.0, 8000.0)  # Hz
DAMPING = (0.02, 0.10)


class MicrophoneParameters(BaseModel):
    """Footfalls, what they set ringing, drives, room, and the meter."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # ---- a foot strikes
    foot_modulus: float = number(8e6, 5e6, 20e6, "Pa", "E: rubber pad, soft to worn", "E*: of the foot on a hard floor")
    foot_radius: float = number(0.023, 0.01, 0.05, "m", "mujoco_menagerie, unitree_go1 (A)", "R_f: of the foot")
    restitution: float = number(0.25, 0.1, 0.4, "1", "E", "e: speed after over speed before")
    contact_newtons: float = number(
        1.0,
        0.1,
        10.0,
        "N",
        "by choice: a thirtieth of the weight on a foot",
        "force above which a foot touches",
        fixed="numerics, not a machine",
    )
    least_speed: float = number(
        0.01,
        0.0,
        0.05,
        "m/s",
        "by choice: a step at 0.01 m/s would peak at 21 dB(A), under any room (B)",
        "no strike below this",
        fixed="numerics, not a machine",
    )
    step_scatter: float = number(
        2.5,
        0.0,
        4.0,
        "dB",
        "E, from r = 0.42 of contact pressure and peak sound (Biomechanics 5(1) 7, 2025, A)",
        "sigma of a step's level, log-normal",
    )
    contact_scatter: float = number(
        0.15,
        0.0,
        0.3,
        "1",
        "E: a pad is struck at another spot and angle each time",
        "sigma of log contact time, from step to step",
    )

    # ---- what rings: two modes of the floor, three of the shank, three of the shells
    frequencies: tuple[float, ...] = numbers(
        (120.0, 200.0, 330.0, 540.0, 900.0, 1500.0, 2400.0, 4000.0),
        *FREQUENCY,
        "Hz",
        "E: 120 to 4000 Hz",
        "f_k",
        counts=MODES,
        drawn=(120.0, 4000.0),
        ascending=True,
    )
    dampings: tuple[float, ...] = numbers(
        (0.10, 0.08, 0.06, 0.05, 0.05, 0.04, 0.03, 0.03),
        *DAMPING,
        "1",
        "E: 0.02 to 0.10",
        "zeta_k: damping ratio",
        counts=MODES,
    )
    gain_slope: float = number(
        6.0,
        0.0,
        12.0,
        "dB/octave",
        "B: sound of a source smaller than a wavelength goes with its acceleration, f times its speed",
        "how G_k rises with f_k, before A-weighting",
    )
    step_level: float = number(
        67.5,
        60.0,
        75.0,
        "dB(A)",
        "E: 65 to 70 for such a step on tile; sets the scale of all G_k",
        "peak fast level at 1 m of a lone step of 0.4 m/s and 0.55 kg",
    )

    # ---- drives and room
    drive_level: float = number(45.0, 30.0, 55.0, "dB(A)", "E: 40 to 50", "level at 1 m of one drive at drive_speed")
    drive_speed: float = number(
        5.0, 1.0, 10.0, "rad/s", "by definition", "q'_r: joint speed that drive_level is of", fixed="a definition"
    )
    drive_exponent: float = number(2.0, 2.0, 2.5, "1", "gear noise rises 20-25 dB per decade of speed (C)", "a")
    drive_load: float = number(0.5, 0.3, 1.0, "1", "E", "kappa: what full torque adds")
    room_level: float = number(38.0, 30.0, 45.0, "dB(A)", "E", "p_b: the room and the robot's fan, motors idle")

    # ---- the meter
    distance: float = number(
        1.0,
        0.5,
        4.0,
        "m",
        "by choice; the microphone keeps its distance",
        "r: from the robot",
        fixed="whoever measures chooses it",
    )
    calibration_error: float = number(
        0.3, -1.0, 1.0, "dB", "E: within the tolerance of a class 2 meter (IEC 61672-1, C)", "what it shows too much"
    )
    reading_noise: float = number(0.3, 0.0, 2.0, "dB", "E", "sigma of a reading")
    resolution: float = number(0.1, 0.0, 1.0, "dB", "last digit of a meter (C)", "step of a reading; 0 leaves it out")

    @model_validator(mode="after")
    def _one_of_each_mode(self) -> MicrophoneParameters:
        if len(self.frequencies) != len(self.dampings):
            raise ValueError(
                f"{len(self.frequencies)} frequencies and {len(self.dampings)} dampings: every mode needs one of each"
            )
        for name, values, (low, high) in (
            ("frequencies", self.frequencies, FREQUENCY),
            ("dampings", self.dampings, DAMPING),
        ):
            for value in values:
                if not low <= value <= high:
                    raise ValueError(f"{name}: {value:g} is outside {low:g} to {high:g}")
        return self
