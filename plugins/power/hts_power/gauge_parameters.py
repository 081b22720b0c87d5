"""Every number of the battery gauge, with unit, source and range.

`--set world.instruments.battery_gauge.phase_resistance=0.15` makes another one.

Tags in the sources: A read in the named source, B arithmetic on A, C recalled from the literature, E estimate.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from hts.contracts import parameter as number
from hts_power.structure import GaugeStructure


class GaugeParameters(BaseModel):
    """Drive train, shared bus, battery, heat, and the gauge's own filter. Motor constants come from the robot."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    # ---- drives
    idle_power: float = number(
        30.0,
        22.0,
        45.0,
        "W",
        "calibrated on standing and the pretrained policy; E: sum of parts (computers 10-21, drives 6-12, rest 5-10) "
        "and standing minus copper loss",
        "P_idle: electronics on, motors idle",
    )
    phase_resistance: float = number(
        0.102,
        0.10,
        0.19,
        "ohm",
        "calibrated on standing and the pretrained policy; "
        "E: a Go2's standing log, and Mini Cheetah scaled by rotor mass",
        "R: per phase at 25 degC",
    )
    hysteresis: float = number(
        0.008,
        0.0032,
        0.016,
        "W*s",
        "E: 3 W at 190 rad/s, under the no-load draw of 0.2 A at 24 V",
        "k_h: iron loss per rotor speed",
    )
    eddy: float = number(4e-5, 1.6e-5, 8e-5, "W*s^2", "E: as k_h", "k_e: iron loss per squared rotor speed")
    switching_frequency: float = number(
        30e3, 20e3, 40e3, "Hz", "moteus 30 kHz, Katz loop 25 us (A)", "f_sw: of the inverter"
    )
    switching_seconds: float = number(100e-9, 50e-9, 200e-9, "s", "E", "t_r + t_f: rise and fall of a switch")
    dead_seconds: float = number(100e-9, 50e-9, 200e-9, "s", "Katz note 100 ns (A)", "t_d: dead time")
    diode_voltage: float = number(0.8, 0.6, 1.0, "V", "E: body diode of a MOSFET", "V_d: during dead time")
    switch_resistance: float = number(3e-3, 1.5e-3, 6e-3, "ohm", "E: 30-40 V MOSFET, warm", "R_ds: of a switch")

    # ---- bus and battery
    regeneration: float = number(
        0.90, 0.0, 0.95, "1", "E; the motor manual asks for a recuperating supply (A)", "eta_reg: 0 is blocked"
    )
    bus_capacitance: float = number(5e-3, 2e-3, 10e-3, "F", "E", "C_b: across the bus")
    cells: int = Field(6, ge=1, le=20, description="in series, 1. Source: 25.2 V charge / 4.2 V (manual 1.4, B)")
    capacity: float = number(
        6.0, 4.0, 6.3, "Ah", "manual 1.4: 6.0 in its table, 6.3 in its text (A)", "Q: of the pack, less with age"
    )
    state_of_charge: float = number(
        0.80,
        0.1,
        1.0,
        "1",
        "the state at which sessions start, by choice",
        "s: at the start",
        drawn=(0.8, 1.0),
    )
    pack_resistance: float = number(
        0.10,
        0.06,
        0.15,
        "ohm",
        "E: 6 x (20-25 mohm / 2 parallel) + 20-40 mohm of FETs, shunt and wires",
        "R_p: ohmic, of the pack",
    )
    polarisation_resistance: float = number(
        0.04, 0.0, 0.10, "ohm", "E: 18650/21700 cells, 6S2P", "R_1: of the RC element"
    )
    polarisation_seconds: float = number(30.0, 10.0, 60.0, "s", "E", "R_1 C_1: time constant")

    # ---- heat, per motor
    ambient: float = number(25.0, 5.0, 40.0, "degC", "manual 1.4: 5 to 40 degC (A)", "T_a: air")
    start_temperature: float = number(
        40.0,
        5.0,
        80.0,
        "degC",
        "a robot that walked a few minutes ago, by choice",
        "windings and housings at the start",
        drawn=(20.0, 60.0),
    )
    winding_capacity: float = number(40.0, 30.0, 60.0, "J/K", "E: about 100 g of copper", "C_w")
    winding_resistance: float = number(1.2, 0.8, 2.0, "K/W", "E: time constant about 50 s", "R_wh: winding to housing")
    housing_capacity: float = number(280.0, 200.0, 350.0, "J/K", "0.52 kg (data sheet 1.5, A) x 0.55 J/gK (E)", "C_h")
    housing_resistance: float = number(
        2.5, 2.0, 3.5, "K/W", "a Go2's log: 3-4.5 K/W in all (A)", "R_ha: housing to air"
    )

    # ---- the gauge
    window: float = number(
        0.250,
        0.003,
        0.500,
        "s",
        "TI bq769x2: CC1 250 ms, CC2 3 ms (A); the family is inferred",
        "W: moving average of the current",
    )
    update_rate: float = number(50.0, 4.0, 50.0, "Hz", "E", "f_u: how often the register changes")
    delay: float = number(0.040, 0.010, 0.150, "s", "E", "d: from average to log")
    resolution: float = number(
        0.008, 0.0, 0.05, "A", "7.6 uV over 1 mohm (B)", "LSB: 0 leaves it out", drawn=(0.001, 0.05)
    )
    noise: float = number(0.015, 0.0, 0.1, "A", "E", "n: sigma of a reading", drawn=(0.001, 0.1))
    cell_noise: float = number(
        0.001,
        0.0,
        0.01,
        "V",
        "E: one step of a cell's word",
        "sigma of a cell voltage, read in whole millivolts",
        drawn=(0.0001, 0.01),
    )
    gain_error: float = number(0.008, -0.015, 0.015, "1", "E: shunt tolerance", "g")
    offset: float = number(0.010, -0.020, 0.020, "A", "E", "o: positive reads less discharge")

    structure: GaugeStructure = Field(default_factory=GaugeStructure, description="structures, off by default")
