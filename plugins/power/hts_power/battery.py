"""A battery pack with a bus capacitor across its terminals. W packs at once; SI units."""

from __future__ import annotations

import numpy as np

Values = float | np.ndarray
"""A number or an array; functions of numbers alone return a NumPy number, which has the methods of an array."""


def open_circuit_voltage(state_of_charge: Values, cells: int) -> np.ndarray:
    """(9) Of a pack of so many cells in series, V. state_of_charge s: 0 to 1.

    -1.031 e^(-35 s) + 3.685 + 0.2156 s - 0.1178 s^2 + 0.3201 s^3 per cell (Chen and Rincon-Mora 2006).
    """
    s = state_of_charge
    return cells * (-1.031 * np.exp(-35 * s) + 3.685 + 0.2156 * s - 0.1178 * s**2 + 0.3201 * s**3)


def steady_current(voltage: Values, resistance: float, power: Values) -> np.ndarray:
    """(8) Current at which a source behind a resistance delivers a power, A.

    I = [V - sqrt(V^2 - 4 R P)] / (2 R), voltage V before the resistance. Beyond V^2 / (4 R), the most that a
    source can give, the current stays at V / (2 R): the terminals are then at half of V, and a real robot resets.
    """
    return (voltage - np.sqrt(np.maximum(np.square(voltage) - 4 * resistance * power, 0))) / (2 * resistance)


class Battery:
    """Open-circuit voltage, ohmic sag, one RC element, charge, and the bus capacitor (items 7 to 9).

    All quantities are of shape (W,): state_of_charge 0 to 1, polarisation V, voltage at the terminals V, current A
    (positive when discharging).
    """

    def __init__(
        self,
        num: int,
        state_of_charge: Values,
        cells: int,
        capacity_coulomb: float,
        resistance: float,
        polarisation_resistance: float,
        polarisation_seconds: float,
        bus_capacitance: float,
        idle_power: float,
    ) -> None:
        self.cells, self.capacity, self.resistance = cells, capacity_coulomb, resistance
        self.polarisation_resistance, self.polarisation_seconds = polarisation_resistance, polarisation_seconds
        self.bus_capacitance = bus_capacitance
        self._response_of: tuple[int, float] | None = None
        self.state_of_charge = np.full(num, state_of_charge)
        source = open_circuit_voltage(self.state_of_charge, cells)
        # Has been on for a while: polarised by the idle current.
        self.current = steady_current(source, resistance + polarisation_resistance, np.full(num, idle_power))
        self.polarisation = polarisation_resistance * self.current
        self.voltage = source - self.polarisation - resistance * self.current

    def deliver(self, power: np.ndarray, dt: float) -> np.ndarray:
        """Give bus power (K, W), W, over K steps of dt; returns the current of each step (K, W), A.

        The capacitor makes the voltage follow V* (where the battery alone would deliver the power) with the time
        constant R_p C_b, 0.5 ms at nominal values; solved exactly over each step for a constant V*, since an
        explicit step of 1 ms would overshoot. Charge and polarisation move too slowly to change within K steps.
        """
        source = open_circuit_voltage(self.state_of_charge, self.cells) - self.polarisation
        settled = source - self.resistance * steady_current(source, self.resistance, power)
        decay, weights, powers = self._response(len(power), dt)
        before = weights @ settled + powers[:, None] * self.voltage  # at the start of each step
        mean = (1 - decay) * self.resistance * self.bus_capacitance / dt
        voltages = settled + mean * (before - settled)  # means over each step, which drive the mean current
        self.voltage = decay * before[-1] + (1 - decay) * settled[-1]
        currents = (source - voltages) / self.resistance
        self.current = np.add.reduce(currents) / len(power)
        seconds = len(power) * dt
        keep = np.exp(-seconds / self.polarisation_seconds)
        self.polarisation = self.polarisation * keep + self.polarisation_resistance * self.current * (1 - keep)
        self.state_of_charge = self.state_of_charge - self.current * seconds / self.capacity
        return currents

    def _response(self, steps: int, dt: float) -> tuple[float, np.ndarray, np.ndarray]:
        """d = exp(-dt / R C) and the recursion V' = d V + (1 - d) V* over K steps, written out: the voltage at the
        start of step k is sum_{i<k} (1 - d) d^(k-1-i) V*_i + d^k V_0, so weights (K, K) and powers of d (K,)."""
        if (steps, dt) != self._response_of:
            decay = float(np.exp(-dt / (self.resistance * self.bus_capacitance)))
            powers = decay ** np.arange(steps)
            lag = np.subtract.outer(np.arange(steps), np.arange(steps)) - 1
            weights = np.where(lag >= 0, (1 - decay) * decay ** np.maximum(lag, 0), 0.0)
            self._response_of, self._response_is = (steps, dt), (decay, weights, powers)
        return self._response_is

    def settle(self, current: np.ndarray) -> None:
        """As polarised as after minutes of a mean current (W,), A. The charge stays."""
        self.polarisation = self.polarisation_resistance * np.asarray(current, dtype=float)
