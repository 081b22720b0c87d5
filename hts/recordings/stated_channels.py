"""Whether the channels that a mapping states can be those of the robot, before any log is read."""

from __future__ import annotations

from collections.abc import Sequence

from hts.contracts import Robot
from hts.errors import ConfigError, unknown_name
from hts.recordings.mapping import ChannelMapping, LogMapping, follows_joints


def check_channels(log: LogMapping, robot: Robot) -> None:
    """Raise ConfigError for a channel that only the real robot measures and whose idle level is not given, for
    one that is both a sum and the largest, and for a sign, a scale or an offset of a joint that the robot has not."""
    own = robot.channels()
    for name, channel in log.channels.items():
        if channel.sum and channel.max:
            raise ConfigError(
                f"Mapping: channels.{name}: it is said to be the `sum` of its columns and the `max`, the largest of "
                "them. Keep one of the two."
            )
        if name not in own and channel.real and channel.idle is None:
            unknown = unknown_name(f"channel of robot '{robot.spec.name}'", name, own)
            raise ConfigError(
                f"Mapping: channels.{name} states no level. {unknown} If only the real robot measures it, give its "
                "`idle` level (electronics on, motors idle); if not, say real: false."
            )
        _check_factors(name, channel, robot.spec.joint_names if follows_joints(name, channel) else None)


def _check_factors(name: str, one: ChannelMapping, joints: Sequence[str] | None) -> None:
    """joints: of the robot; None where the channel has no number for each."""
    for key, said in (("sign", one.sign), ("scale", one.scale), ("offset", one.offset)):
        if not isinstance(said, dict):
            continue
        if joints is None:
            follow = "" if one.sum or one.max else ", or per_joint: true if its columns follow the joints"
            raise ConfigError(
                f"Mapping: channels.{name}.{key}: joints are named there, but '{name}' has no column for each joint. "
                f"Say one number{follow}."
            )
        for joint in said:
            if joint not in joints:
                raise ConfigError(
                    f"Mapping: channels.{name}.{key}: {unknown_name('joint of the robot', joint, joints)}"
                )
