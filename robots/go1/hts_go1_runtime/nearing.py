"""Heat and charge grow bad slowly: near the limits that let a robot fall it sits down, while it still can.

It also does where they no longer change at all: no limit is seen in a number that stands still. A pack's voltage moves
with each step that is taken; a motor that walks from cold warms by a degree in a minute, and of twelve in whole degrees
one turns to and fro even where all are as warm as they will be. (Chosen, measured on no robot.)
"""

from __future__ import annotations

import math

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.frozen import READ_AGAIN, Repeats
from hts_go1_runtime.link import State
from hts_go1_runtime.machine import JOINTS, Limits, first_of

# Chosen, measured on no robot: to stand still, sit down and be let go takes about 4 s, in which a motor warms by less.
DEGREES = 5.0  # below the temperature at which the robot is stopped, degC
VOLTS = 0.4  # above the voltage at which it is, V, in the mean
SECONDS = 1.0  # time constant of that mean: a step draws the pack down for tenths of a second
STILL_VOLTS, STILL_HEAT = 60.0, 300.0  # s of walking, in which the voltage, one of twelve temperatures has to change
PAUSE = 1.0  # s: a longer one between two steps, as while a person thinks, is no walking


class Nearing:
    """Looks at each step of a walk. period: of a step, s; still: s for which what only the robot gives may repeat
    itself, if that is longer; 0: for ever; None: not said. A number that is not measured (NaN) is not looked at."""

    def __init__(self, limits: Limits, period: float, still: float | None = None) -> None:
        volts, heat = (0.0 if still == 0 else max(least, still or 0.0) for least in (STILL_VOLTS, STILL_HEAT))
        of, so = "walking", "no limit of it would stop the robot"
        self._still_volts = Repeats("battery_voltage", volts, READ_AGAIN, of, so)
        self._still_heat = Repeats("motor_temperature", heat, READ_AGAIN, of, so)
        self._seen = math.inf
        self._hot, self._limits = limits.temperature - DEGREES, limits
        self._empty, self._share = limits.voltage + VOLTS, -math.expm1(-period / SECONDS)
        self._voltage = math.nan

    def see(self, state: State) -> None:
        """Raises RuntimeFault, at which a robot sits down, near a limit at which it would be damped, and where nobody
        would see it near."""
        walks, self._seen = 0.0 <= state.received - self._seen <= PAUSE, state.received
        self._still_volts.see(state.voltage, state.received, walks)
        self._still_heat.see(state.temperature, state.received, walks)
        if (joint := first_of(state.temperature >= self._hot)) is not None:
            raise RuntimeFault(
                f"{JOINTS[joint]} at {state.temperature[joint]:.0f} degC, and at {self._limits.temperature:g} the "
                "robot is let fall: the visit ends here. Let it cool down, then run the same again; rows that have a "
                "log stay."
            )
        if math.isnan(state.voltage):
            return
        if math.isnan(self._voltage):
            self._voltage = state.voltage
        self._voltage += self._share * (state.voltage - self._voltage)
        if self._voltage <= self._empty:
            raise RuntimeFault(
                f"{self._voltage:.2f} V at the pack in the mean of about {SECONDS:g} s, and at "
                f"{self._limits.voltage:g} the robot is let fall: the visit ends here. Charge or change the pack, then "
                "run the same again; rows that have a log stay."
            )
