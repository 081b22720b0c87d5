"""What a battery gauge's machine may have beside other numbers: structures that are off by default.

Off, none of this changes a bit of the gauge, nor the twin's hash. Tags in the sources as in gauge_parameters.py.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from hts.contracts import parameter, structural


class GaugeStructure(BaseModel):
    """Structures of drive train, bus and gauge, and what differs from session to session. 0 or false: not there."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # fmt: off
    resistance_spread: float = parameter(
        0.0, 0.0, 0.15, "1", "E: windings of one type differ by a few per cent; data sheets give 5-10 %",
        "R of each motor is off by up to +- this, uniform, fixed per machine",
        drawn=(0.02, 0.10), switch="motor_spread",
    )
    machine: int = parameter(
        1, 0, 2**31 - 1, "1", "by definition",
        "serial number: seeds what is fixed per machine",
        switch="motor_spread",
    )
    converter_share: float = parameter(
        0.0, 0.0, 0.10, "1", "E: converters of this size are 92 to 98 % efficient at their best point",
        "loss of each drive's converter per power that passes it, either way",
        drawn=(0.01, 0.06), switch="converter",
    )
    converter_square: float = parameter(
        0.0, 0.0, 1e-3, "1/W", "E: efficiency falls by another 1 to 10 points at 200 W",
        "what each converter loses on top per squared power",
        drawn=(5e-5, 5e-4), switch="converter",
    )
    own_regeneration: bool = structural(
        "own_regeneration", "Yang et al. 2022 bill each motor max(.., 0) (A); drives with a brake chopper do that",
        "whether each drive burns what it regenerates, instead of feeding the others over the shared bus",
    )
    idle_spread: float = parameter(
        0.0, 0.0, 0.3, "1", "E: computers draw 10-21 W, with their work and the fan",
        "sigma of the idle power's wandering, as a share of it",
        drawn=(0.02, 0.12), switch="idle_wander",
    )
    idle_seconds: float = parameter(
        0.0, 0.0, 120.0, "s", "E: from a burst of work to a fan's cycle",
        "time constant of the wandering",
        drawn=(2.0, 60.0), switch="idle_wander",
    )
    low_pass: bool = structural(
        "low_pass", "the window's range read as a time constant: a shunt amplifier's RC, or a fuel gauge's IIR (E)",
        "whether the gauge is a first-order low-pass with time constant W, instead of a mean over W",
    )
    least_charge: float = parameter(
        0.0, 0.0, 1.0, "1", "E: nobody starts a session with a pack that is nearly empty",
        "sessions start at a charge between this and s, uniform, drawn for each; 0: all at s",
        drawn=(0.3, 0.5),
    )
    ambient_spread: float = parameter(
        0.0, 0.0, 10.0, "K", "E: mornings and afternoons of one hall",
        "air of a session is off by up to +- this, uniform",
        drawn=(1.0, 5.0),
    )
    # fmt: on
