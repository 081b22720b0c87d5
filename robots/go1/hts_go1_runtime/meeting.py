"""First words with a robot, before it is told anything: whether it is fit to start."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.link import State
from hts_go1_runtime.loop import Loop
from hts_go1_runtime.posture import carried

WATCHED = 0.1  # s: of states for the mean torque of a joint
MOST_VOLTS = 40.0  # V: a full pack of a Go1 has 25.2 (User Manual V1.4), eight cells in a row, as in a Go2, have 33.6
G, REST, APART = 9.81, 2.0, 20.0  # m/s2, m/s2, degrees: an accelerometer of a phone's kind is off by one or two
LEAST_IDLE = (
    0.2  # A: a few watts, an order below what computers and drives of a Go1 take while the motors idle (estimate)
)


def meet(loop: Loop) -> list[State]:
    """The robot's first states, the first with nothing wrong with it; the robot lies or hangs. Raises RuntimeFault,
    Stopped."""
    state = loop.start()
    if state.voltage == 0 and state.current == 0:  # before an empty pack is seen in it
        raise RuntimeFault(
            "The robot's battery monitor gives 0 V and 0 A: it is not being read. Start the robot's own process that "
            "reads it, or restart the robot."
        )
    if state.voltage > MOST_VOLTS:
        raise RuntimeFault(
            f"The pack has {state.voltage:g} V, expected at most {MOST_VOLTS:g}: another unit, such as mV, and no "
            "empty pack would stop the robot. Correct it in the link (V); nothing has moved."
        )
    fault = loop.look_over(state)
    if fault:
        raise RuntimeFault(f"The robot is not fit to start: {fault[0]}, {fault[1]}.")
    states = [state, *loop.watch(WATCHED)]
    if all((one.temperature == 0).all() for one in states):
        raise RuntimeFault(
            "All motors give 0 degC: their temperature is not being read, and no heat would stop the robot. Correct it "
            "in the link or restart the robot; or leave NaN there if nobody measures it."
        )
    check_attitude(states)
    check_lies(states)
    return states


def unguarded(measured: Sequence[str]) -> str:
    """Which stops there are none of, because the robot does not give what they look at; "" if there are all."""
    missing = [stop for channel, stop in NEEDED.items() if channel not in measured]
    return f"Not measured, so that nothing stops the robot for it: {', '.join(missing)}. " if missing else ""


NEEDED = {
    "motor_temperature": "heat of the motors",
    "battery_voltage": "low voltage of the pack",
    "battery_current": "over-current of the pack",
}
"""Channel -> the stop that looks at it."""


def check_channels(wanted: Mapping[str, Any], measured: Sequence[str], external: Sequence[str]) -> None:
    """Raise RuntimeFault for a channel that only a robot gives and that this one does not: rows without it would be
    walked in vain. wanted: the manifest's; external: those that a sensor of its own logs."""
    for name in external:
        if name not in wanted:
            raise RuntimeFault(f"--external {name}: the bundle's channels are {', '.join(wanted)}.")
    missing = [
        name
        for name, one in wanted.items()
        if isinstance(one, Mapping) and one.get("real") and name not in measured and name not in external
    ]
    if missing:
        options = " ".join(f"--external {name}" for name in missing)
        raise RuntimeFault(
            f"The link gives no {', '.join(missing)}, for which the rows are walked. Start what reads it on the robot, "
            f"or, if a sensor of its own logs it beside: {options}."
        )


def check_draws(current: float) -> None:
    """Raise RuntimeFault for a current of the pack, A, that no robot draws whose motors idle; NaN: not measured."""
    if current <= 0:
        raise RuntimeFault(
            f"The pack's current is {current:.2f} A while the motors idle, expected above 0, which is drawn from it: "
            "the link counts the other way, or does not read it. Correct it in the link, or leave NaN there if nobody "
            "measures it; the robot has not stood up."
        )
    if current < LEAST_IDLE:
        raise RuntimeFault(
            f"The pack's current is {current:.2g} A while the motors idle, expected {LEAST_IDLE:g} or more, which the "
            "robot's computers alone draw: another unit, and no over-current would stop the robot. Correct it in the "
            "link (A); the robot has not stood up."
        )


def check_attitude(states: Sequence[State]) -> None:
    """Raise RuntimeFault where the accelerometer of a robot at rest shows another way down than its attitude: no tilt
    would be seen in that. An accelerometer that is not measured (NaN), or in another unit, says nothing."""
    push = np.mean([state.acc for state in states], axis=0)
    size, down = float(np.linalg.norm(push)), np.mean([state.gravity for state in states], axis=0)
    if not abs(size - G) <= REST:
        return
    apart = math.degrees(math.acos(min(1.0, abs(float(push @ down)) / (size * float(np.linalg.norm(down))))))
    if apart > APART:
        shown = ", ".join(f"{value:.1f}" for value in push)
        raise RuntimeFault(
            f"The attitude and the accelerometer ({shown} m/s2) of the robot at rest show directions down that are "
            f"{apart:.0f} degrees apart, expected {APART:g} or less: a quaternion in another order than (w, x, y, z), "
            "or axes of another frame, in which no tilt would be seen. Correct it in the link; nothing has moved."
        )


def check_lies(states: Sequence[State]) -> None:
    """Raise RuntimeFault if the robot stands on its legs: a visit begins with motors that idle."""
    how = carried(states)
    if how:
        raise RuntimeFault(
            f"The robot stands, its legs carry it: {how}. A visit begins with idle motors, which would drop it. Lay it "
            "down first, legs folded, or hang it up; nothing has moved."
        )
