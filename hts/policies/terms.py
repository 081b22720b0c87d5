"""What other libraries call the parts of an observation, and which of them a robot cannot measure."""

from __future__ import annotations

from pathlib import Path

from hts.errors import PolicyError

OURS = {
    name: ours
    for ours, names in {
        # mjlab and Isaac Lab, by the name of the term or of its function; mujoco_playground; legged_gym
        "angular_velocity": ("base_ang_vel", "imu_ang_vel", "gyro"),
        "projected_gravity": ("gravity",),
        "command": ("velocity_commands", "generated_commands", "commands"),
        "joint_position_offset": ("joint_pos", "joint_pos_rel", "dof_pos"),
        "joint_velocity": ("joint_vel", "joint_vel_rel", "dof_vel"),
        "last_action": ("actions", "last_act", "previous_actions"),
    }.items()
    for name in names
}
"""Another library's name -> ours, where both mean the same."""

ABSOLUTE = "joint_position"
"""The joint angles themselves, not their distance from the default pose: a part that a layout may name."""

SPEED = "the trunk's linear velocity"
NOT_MEASURED = {
    **dict.fromkeys(("base_lin_vel", "imu_lin_vel", "base_linear_velocity"), SPEED),
    **dict.fromkeys(("base_velocity", "linvel", "body_velocity"), SPEED),
    "base_pos": "the trunk's position",
    **dict.fromkeys(("base_pos_z", "base_height"), "the trunk's height"),
    **dict.fromkeys(("height_scan", "heights"), "the heights of the ground around it"),
    "foot_contact": "which feet touch the ground",
    "foot_contact_forces": "the forces under its feet",
    "foot_height": "the heights of its feet",
    "foot_air_time": "how long its feet have been in the air",
}
"""What no sensor of such a robot gives."""


def our_name(name: str) -> str:
    """Our name of a part that another library calls `name`; the name itself where we know no other."""
    return OURS.get(name, name)


def refuse_unmeasured(path: Path, name: str) -> None:
    """Raises PolicyError, with what to do, for a part that a robot cannot measure."""
    if name not in NOT_MEASURED:
        return
    what = NOT_MEASURED[name]
    held = ", or give it a constant that the policy was trained to walk with (hold: 0 in the layout)"
    if what == SPEED:
        held = ", or let the command or a constant stand in for it (stand_in: command, or hold: 0, in the layout)"
    raise PolicyError(
        f"{path}: it observes '{name}', {what}, which no sensor of the robot measures. Train it again without this "
        f"term (in mjlab and Isaac Lab: leave it out of the actor's observations, the critic may keep it){held}; then "
        "see whether it still walks."
    )
