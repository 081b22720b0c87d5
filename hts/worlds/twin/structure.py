"""What a twin may have beside other numbers: structures that are off by default, and sessions that differ.

Each structure of a reality is switched on by a coin of its own; then its numbers are drawn over the ranges given here.
Off, none of this changes a bit of the default twin, nor its hash. Tags in the sources as in parameters.py.
"""

from __future__ import annotations

from hts.config import Config
from hts.contracts import parameter, structural


class BodyStructure(Config):
    """Structures of body, drives, link and floor. 0 or false: not there."""

    # fmt: off
    torque_constant_spread: float = parameter(
        0.0, 0.0, 0.10, "1", "E: magnets and windings of one type differ by a few per cent; data sheets give 5-10 %",
        "K of each motor is off by up to +- this, uniform, fixed per machine",
        drawn=(0.02, 0.10), switch="motor_spread",
    )
    torque_saturation: float = parameter(
        0.0, 0.0, 0.30, "1", "E: iron saturates towards peak current; 5-25 % of the torque is lost there",
        "share of the torque lost at the torque limit; grows with the square of the current",
        drawn=(0.05, 0.25), switch="saturation",
    )
    stribeck_ratio: float = parameter(
        0.0, 0.0, 1.0, "1", "E: static friction of greased gears is 1.2 to 2 times the sliding one (Olsson 1998, C)",
        "dry friction at standstill, above the sliding one, as a share of it",
        drawn=(0.2, 1.0), switch="transmission",
    )
    stribeck_speed: float = parameter(
        0.0, 0.0, 1.0, "rad/s", "E: Stribeck speeds of joint drives, at the joint",
        "v_s: the extra friction falls as exp(-(q'/v_s)^2)",
        drawn=(0.05, 0.5), switch="transmission",
    )
    backlash: float = parameter(
        0.0, 0.0, 0.03, "rad", "E: planetary stages of this size have 10 to 60 arc minutes of play",
        "play between motor and joint; the encoder sits on the motor's side",
        drawn=(0.003, 0.018), switch="transmission",
    )
    torque_follows_supply: bool = structural(
        "sag", "B: the no-load speed of such a motor is proportional to the supply's voltage",
        "whether the no-load speed, and with it the torque limit, falls with the supply's voltage",
    )
    command_jitter: float = parameter(
        0.0, 0.0, 0.015, "s", "E: UDP and a scheduler without real time",
        "each target comes later by a time that is uniform from 0 to this",
        drawn=(0.001, 0.010), switch="link",
    )
    lost_packets: float = parameter(
        0.0, 0.0, 0.10, "1", "E: wireless or a busy link; no retransmission",
        "share of targets that never arrive; the old one stays",
        drawn=(0.001, 0.03), switch="link",
    )
    floor_roughness: float = parameter(
        0.0, 0.0, 0.01, "m", "E: paving, joints and worn concrete stand up to 1 cm; a step that a person sees is more",
        "height of the floor's bumps, +- this",
        drawn=(0.001, 0.01), switch="floor",
    )
    bump_length: float = parameter(
        0.0, 0.0, 2.0, "m", "E: paving, carpet edges, worn concrete",
        "shortest wavelength of the bumps; the longest is 2 m",
        drawn=(0.2, 1.0), switch="floor",
    )
    floor_slope: float = parameter(
        0.0, 0.0, 2.0, "deg", "E: floors of halls and yards drain at 1-2 % (about 1 degree), ramps are steeper",
        "steepest slope along any direction; which one differs from session to session",
        drawn=(0.0, 2.0), switch="floor",
    )
    payload_mass: float = parameter(
        0.0, 0.0, 3.0, "kg", "E: a lidar, camera or computer strapped on; data sheet 3.0 gives 12 +- 1.5 kg without",
        "mass on the trunk",
        drawn=(0.2, 2.0), switch="payload",
    )
    payload_x: float = parameter(
        0.0, -0.15, 0.15, "m", "E: on the trunk's deck of 0.38 m",
        "where it sits, forward of the trunk's origin",
        drawn=(-0.10, 0.10), switch="payload",
    )
    payload_y: float = parameter(
        0.0, -0.05, 0.05, "m", "E: on the trunk's deck of 0.09 m",
        "where it sits, to the left",
        drawn=(-0.03, 0.03), switch="payload",
    )
    payload_z: float = parameter(
        0.0, 0.0, 0.2, "m", "E: above the deck at 0.057 m",
        "where it sits, up",
        drawn=(0.06, 0.14), switch="payload",
    )
    wind_force: float = parameter(
        0.0, 0.0, 8.0, "N", "B: 0.5 rho c A v^2, c A = 0.2 m^2: 0.5 N at 2 m/s (a fan, a door), 6 N at 7 m/s (4 Bft)",
        "mean force of a wind from one side of the track; which side differs from session to session",
        drawn=(0.5, 6.0), switch="wind",
    )
    wind_gust: float = parameter(
        0.0, 0.0, 1.0, "1", "E: turbulence intensity of wind near the ground is 0.1 to 0.3; force goes with its square",
        "sigma of the gusts, as a share of the mean force; they last about 2 s",
        drawn=(0.2, 0.6), switch="wind",
    )
    # fmt: on


class SessionParameters(Config):
    """How sessions on one machine differ: drawn for each from the request. 0: they do not.

    Charge and ambient temperature of a session belong to the instrument that simulates them.
    """

    # fmt: off
    floor_friction_spread: float = parameter(
        0.0, 0.0, 0.3, "1", "E: dust, moisture, another spot",
        "floor friction of a session is off by up to +- this, uniform",
        drawn=(0.05, 0.20),
    )
    heading_gain_spread: float = parameter(
        0.0, 0.0, 0.8, "1", "E: another person, another day",
        "gain of the operator who keeps the heading is off by up to +- this, uniform",
        drawn=(0.1, 0.5),
    )
    heading_offset: float = parameter(
        0.0, 0.0, 0.2, "rad", "E: a person sees a heading to a few degrees",
        "the heading that the operator keeps is off by up to +- this, uniform",
        drawn=(0.01, 0.10),
    )
    # fmt: on
