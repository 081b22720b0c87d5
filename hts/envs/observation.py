"""What a policy of the velocity task sees, and with what noise."""

from __future__ import annotations

# What the policy sees, in this order, all of it measurable on a robot. joint_position_offset = q - default pose.
OBSERVATION = (
    "angular_velocity",
    "projected_gravity",
    "command",
    "joint_position_offset",
    "joint_velocity",
    "last_action",
)
# Uniform sensor noise of training, +-, per observation entry (Rudin et al. 2022): rad/s, 1, rad, rad/s.
NOISE = {"angular_velocity": 0.2, "projected_gravity": 0.05, "joint_position_offset": 0.01, "joint_velocity": 1.5}


def observation_layout(num_joints: int) -> list[dict[str, int | str]]:
    """Names and sizes of the observation's parts, in order."""
    sizes = {"angular_velocity": 3, "projected_gravity": 3, "command": 3}
    return [{"name": name, "size": sizes.get(name, num_joints)} for name in OBSERVATION]


def observation_size(num_joints: int) -> int:
    """How many numbers that is."""
    return sum(int(part["size"]) for part in observation_layout(num_joints))


def critic_observation_size(num_joints: int, num_feet: int) -> int:
    """What the critic sees: the observation without noise, trunk velocity (3), height and foot contacts."""
    return observation_size(num_joints) + 4 + num_feet
