"""Electrical power of a robot's joint drives from torque and speed. Functions of arrays; SI units.

Torques are those that the motor current makes, seen at the joint; so friction and acceleration of rotors are
already inside tau * q', and are not billed again. Numbers of the items are those of docs/twin.md.
"""

from __future__ import annotations

import numpy as np

COPPER_TEMPERATURE = 0.00393  # 1/K at 25 degC: annealed copper, IEC 60028 (0.00393 at 20 degC, the difference is 2 %)

Values = float | np.ndarray
"""A number or an array; functions of numbers alone return a NumPy number, which has the methods of an array."""


def copper_coefficient(phase_resistance: float, torque_constant: Values) -> np.ndarray:
    """c25 = 1.5 R / K^2, W per (N m)^2 at the joint and 25 degC.

    phase_resistance: ohm, per phase; torque_constant K: N m at the joint per peak ampere of the q axis.
    1.5 R i^2 is the heat of three phases that carry sinusoids of amplitude i.
    """
    return 1.5 * phase_resistance / np.square(torque_constant)


def copper_power(torque: Values, coefficient: Values, winding_temperature: Values) -> np.ndarray:
    """(2) Heat in the windings, W: c25 [1 + 0.00393 (T - 25)] tau^2. torque: N m; winding_temperature: degC."""
    return coefficient * (1 + COPPER_TEMPERATURE * (winding_temperature - 25.0)) * np.square(torque)


def iron_power(rotor_speed: Values, hysteresis: float, eddy: float) -> np.ndarray:
    """(3) Iron loss, W: k_h |w| + k_e w^2. rotor_speed w: rad/s; hysteresis: W s; eddy: W s^2.

    The constant-flux limit of Mellor, Wrobel and Holliday 2009.
    """
    return hysteresis * np.abs(rotor_speed) + eddy * np.square(rotor_speed)


def inverter_power(
    current: Values,
    bus_voltage: Values,
    switch_resistance: float,
    switching_seconds: float,
    dead_seconds: float,
    frequency: float,
    diode_voltage: float,
) -> np.ndarray:
    """(4) Loss of a three-phase bridge, W, for sinusoidal phase currents of amplitude `current`, A.

    conduction 1.5 R_ds i^2 (in each phase one switch always conducts);
    switching (3/pi) V i (t_r + t_f) f; dead time (12/pi) i V_d t_d f: |sin| has a mean of 2/pi in each of three phases.
    """
    conduction = 1.5 * switch_resistance * np.square(current)
    switching = 3 / np.pi * bus_voltage * current * switching_seconds * frequency
    dead = 12 / np.pi * current * diode_voltage * dead_seconds * frequency
    return conduction + switching + dead


def converter_power(power: Values, share: float, square: float) -> np.ndarray:
    """Loss of a drive's own converter, W: a |P| + b P^2, whichever way the power P, W, passes it. square b: 1/W.

    Its efficiency, P / (P + loss) = 1 / (1 + a + b P), falls with load; what it draws without load is idle power.
    """
    return share * np.abs(power) + square * np.square(power)


def bus_power(idle_power: Values, joint_powers: np.ndarray, regeneration: float) -> np.ndarray:
    """(6) What the shared bus asks of the battery, W. joint_powers: (..., J), may be negative.

    One joint's generated power feeds another with no further loss; only what is left over, a negative sum,
    meets the battery, at the efficiency `regeneration` (0: blocked).
    """
    power = idle_power + np.add.reduce(joint_powers, axis=-1)
    return np.where(power < 0, regeneration * power, power)


def steady_temperatures(
    torque_squared: Values,
    iron: Values,
    coefficient: Values,
    ambient: Values,
    winding_to_housing: float,
    housing_to_ambient: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Winding and housing temperature, degC, at which the heat of item (10) flows off as it comes in.

    torque_squared: mean tau^2, (N m)^2; iron: mean iron loss, W, half of which heats the winding;
    resistances in K/W. The copper loss grows with the temperature that it causes; with P = A + B T_w linear,
    T_w = T_a + R (A + B T_w) gives T_w = (T_a + R A) / (1 - R B). R B >= 1 has no steady state: nan.
    """
    total = winding_to_housing + housing_to_ambient
    slope = coefficient * COPPER_TEMPERATURE * torque_squared
    fixed = coefficient * (1 - 25.0 * COPPER_TEMPERATURE) * torque_squared + 0.5 * iron
    room = 1 - total * slope
    winding = np.where(room > 0, (ambient + total * fixed) / np.where(room > 0, room, 1), np.nan)
    heat = fixed + slope * winding
    return winding, ambient + housing_to_ambient * heat
