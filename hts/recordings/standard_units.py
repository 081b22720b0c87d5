"""Joint quantities of a log in the units that robots' limits and gains are in.

An import converts a channel to the unit of the robot's own of that name. What the robot has no channel of keeps the
unit that the mapping states, such as the angles, in degrees, of a machine whose model reads torques alone.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

from hts import units
from hts.recordings.recording import Series

STANDARD = {"joint_position": "rad", "joint_target": "rad", "joint_velocity": "rad/s", "joint_torque": "N*m"}


def in_standard_units(channels: Mapping[str, Series], besides: Collection[str] = ()) -> dict[str, Series]:
    """The channels, those of STANDARD converted to rad, rad/s and N*m; as they are where that is another quantity, as
    of a joint that slides, m, and where `besides` names them."""
    return {name: one if name in besides else _converted(one, STANDARD.get(name)) for name, one in channels.items()}


def _converted(series: Series, unit: str | None) -> Series:
    own = series.channel.unit
    if unit is None or own == unit or not units.one_quantity(own, unit):
        return series
    scale, offset = units.conversion(own, unit)
    return Series(replace(series.channel, unit=unit), scale * series.values + offset)
