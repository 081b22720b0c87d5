"""A dog of two joints, the robot of most of these tests."""

from __future__ import annotations

from dataclasses import replace

from hts.contracts import RobotSpec

SPEC = RobotSpec(
    name="dog",
    joint_names=("left", "right"),
    default_pose=(0.1, -0.1),
    kp=(20.0, 20.0),
    kd=(0.5, 0.5),
    action_scale=(0.25, 0.25),
    torque_limit=(10.0, 10.0),
    velocity_limit=(20.0, 20.0),
    position_limit=((-1.0, 1.0), (-1.0, 1.0)),
    control_rate_hz=50.0,
    physics_dt=0.005,
    substeps=4,
    base_height=0.3,
    foot_sites=("left_foot", "right_foot"),
)
UNEVEN = replace(SPEC, action_scale=(0.25, 0.5), foot_sites=())
"""With joints that differ, so that a swapped order shows; and no feet."""
