"""Dogs of two and of four joints, the robots of most of these tests."""

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

FOUR = RobotSpec(
    name="dog",
    joint_names=("FR_hip", "FR_calf", "FL_hip", "FL_calf"),
    default_pose=(0.0, -1.8, 0.0, -1.8),
    kp=(20.0,) * 4,
    kd=(0.5,) * 4,
    action_scale=(0.25,) * 4,
    torque_limit=(40.0,) * 4,
    velocity_limit=(30.0,) * 4,
    position_limit=((-3.0, 3.0),) * 4,
    control_rate_hz=50.0,
    physics_dt=0.005,
    substeps=4,
    base_height=0.3,
    foot_sites=("left_foot", "right_foot"),
)
"""Two legs of two joints: what the libraries of others name and order in ways of their own."""
