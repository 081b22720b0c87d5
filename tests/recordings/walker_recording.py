"""A recording of a walker with two joints, every number exact in binary."""

from __future__ import annotations

import numpy as np

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.recordings import Recording, Series


def a_recording(samples: int = 50, **changes: object) -> Recording:
    """Two joints and one measured channel at 50 Hz, every number exact in binary."""
    steps = np.arange(samples)
    channels = {
        "joint_torque": Series(Channel("joint_torque", "N*m", (2,)), np.stack([steps / 4, -steps / 8], axis=1)),
        "command": Series(Channel("command", "1", (3,), may_be_constant=True), np.tile([0.5, 0.0, 0.0], (samples, 1))),
        "draw": Series(Channel("draw", "A"), 1.5 + (steps % 4) / 2),
        "warmth": Series(Channel("warmth", "degC", may_be_constant=True), np.full(samples, 40.0)),
    }
    recording = Recording(
        robot="walker",
        world="bench",
        policy_hash="abc",
        iteration=1,
        joint_names=("hip", "knee"),
        kp=(20.0, 20.0),
        kd=(0.5, 0.5),
        rate_hz=50.0,
        schedule=ScheduleConfig(commands=(Command(seconds=samples / 50, vx=0.5),)),
        idle={"draw": 1.25, "warmth": 25.0},
        clock="simulated",
        time=steps / 50,
        channels=channels,
        mass_kg=12.5,
        session="s1",
        block=2,
        role="policy",
        notes={"by": "hand"},
    )
    return recording.replace(**changes)
