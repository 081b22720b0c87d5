"""All that is looked at in a recording made of a log, in one order: what cannot be is refused, doubts become notes."""

from __future__ import annotations

from collections.abc import Mapping

from hts import units
from hts.contracts import Robot
from hts.recordings.attitude import still_notes
from hts.recordings.axes import axes_notes
from hts.recordings.base_speed import velocity_notes
from hts.recordings.checks import check
from hts.recordings.exchanged import exchanged_notes
from hts.recordings.factors import common_factor
from hts.recordings.feet import foot_notes
from hts.recordings.gravity import GRAVITY, check_upright
from hts.recordings.joint_work import work_notes
from hts.recordings.mapping import LogMapping, follows_joints
from hts.recordings.motion import check_motion
from hts.recordings.no_reading import check_no_reading
from hts.recordings.pd_torque import torque_notes
from hts.recordings.plausible import check_facts, check_idle, check_limits
from hts.recordings.recording import Recording, Series
from hts.recordings.repeated import repeated_notes
from hts.recordings.standard_units import in_standard_units
from hts.recordings.still_joints import check_still_joints
from hts.recordings.targets import check_targets
from hts.recordings.temperatures import temperature_notes
from hts.recordings.told_turn import check_told_turn
from hts.recordings.turning import check_turning
from hts.recordings.unread import check_read


def looked_over(
    recording: Recording, robot: Robot, log: LogMapping, where: str, slow: Mapping[str, tuple[float, float]]
) -> Recording:
    """The recording with a note for each doubt. where: begins messages; slow: of each held gauge, its period and for
    how long a reading holds, s.

    Raises RecordingError for what cannot be what the mapping says it is.
    """
    channels, rate_hz = recording.channels, log.rate_hz
    check_facts(recording, robot, where)
    per_joint = {name for name, one in log.channels.items() if follows_joints(name, one)}
    stated = _stated_limits(channels, log)
    check_limits(channels, robot.spec, where, per_joint=per_joint, stated=stated, real=recording.idle)
    check(recording, where)
    judged = recording.replace(channels=in_standard_units(channels, besides=recording.idle))
    check_still_joints(judged.channels, robot.spec, rate_hz, where, stated)
    check_motion(judged.channels, robot.spec, rate_hz, where, stated)
    levels = {name: level for name, level in recording.idle.items() if name not in stated}
    check_idle(judged.channels, levels, where)
    turned = GRAVITY in log.channels and common_factor(log.channels[GRAVITY]) < 0
    check_upright(judged, where, stated, turned)
    check_turning(judged.channels, rate_hz, where, stated)
    check_told_turn(judged, where, stated)
    check_targets(judged, robot.spec, where, stated)
    check_no_reading(channels, list(recording.idle), where, stated)
    check_read(judged.channels, rate_hz, list(recording.idle), where, slow, log.frozen_real_seconds)
    doubts = torque_notes(judged, robot.spec, where, stated) | velocity_notes(judged, robot, where, stated)
    doubts |= repeated_notes(judged.channels, rate_hz) | work_notes(judged, stated) | still_notes(judged, stated)
    doubts |= foot_notes(judged, robot, stated) | axes_notes(judged.channels, rate_hz, stated)
    doubts |= temperature_notes(channels, {name: one.unit for name, one in log.channels.items()}, stated)
    doubts |= exchanged_notes(channels, rate_hz, stated)
    return recording.replace(notes={**recording.notes, **doubts}) if doubts else recording


def _stated_limits(channels: Mapping[str, Series], log: LogMapping) -> dict[str, tuple[float, float]]:
    """Limits that the mapping gives, in the unit of the channel."""
    stated = {}
    for name, one in log.channels.items():
        if one.limits is not None:
            scale, offset = units.conversion(one.unit, channels[name].channel.unit)
            low, high = one.limits
            stated[name] = (scale * low + offset, scale * high + offset)
    return stated
