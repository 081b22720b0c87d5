"""Temperatures in the other unit: degC that are called degF, or the other way round.

Both are plausible numbers, so nothing is refused. Motors of a machine that was just switched on are as warm as its
room, those of one that works hard some 80 degC (176 degF), where drives switch off. So what lies above 75 degC is
probably in degF, or such a machine hard at work; what is below 60 degF (16 degC), and would be an ordinary temperature
in degC, is probably that.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from hts import units
from hts.recordings.recording import Series

HOT_DEG_C = 75.0
COLD_DEG_F = (10.0, 60.0)
FAHRENHEIT = (1.8, 32.0)


def temperature_notes(
    channels: Mapping[str, Series], said: Mapping[str, str], stated: Collection[str] = ()
) -> dict[str, str]:
    """Notes of channels of a temperature that look as if they were in degF where degC is said, or the other way round.

    said: the unit of each channel's numbers in the log; stated: names of channels whose limits a mapping states, which
    is a person's word for them. The median of all components is looked at.
    """
    found = []
    for name, series in channels.items():
        unit = said.get(name, "")
        if name in stated or not units.known(unit) or not units.is_temperature(unit):
            continue
        scale, offset = units.conversion(series.channel.unit, "degC")
        median = scale * float(np.median(series.values)) + offset
        deg_c, in_deg_f = units.same_unit(unit, "degC"), FAHRENHEIT[0] * median + FAHRENHEIT[1]
        if deg_c and median > HOT_DEG_C:
            other = (median - FAHRENHEIT[1]) / FAHRENHEIT[0]
            found.append(
                f"{name} is {median:.3g} degC at the median, hotter than drives may get for long: does the log count "
                f"in degF (then it is {other:.3g} degC; say unit: degF)?"
            )
        elif not deg_c and COLD_DEG_F[0] < in_deg_f < COLD_DEG_F[1]:
            found.append(
                f"{name} is {in_deg_f:.3g} degF ({median:.3g} degC) at the median, colder than a room: does the log "
                "count in degC (say unit: degC)?"
            )
    return {"temperature_unit": " ".join(found)} if found else {}
