"""A two-joint machine of which only logs exist, and a mapping of its logs. Helpers are found beside the tests."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from hts.channels import Channel
from hts.contracts import LogOnlyRobot, RobotSpec
from hts.recordings import RecordingStore

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def two_joints() -> LogOnlyRobot:
    """Hip and knee: 20 N·m, 30 rad/s, ±3 rad."""
    spec = RobotSpec.log_only(
        "logger",
        ("hip", "knee"),
        torque_limit=(20.0, 20.0),
        velocity_limit=(30.0, 30.0),
        position_limit=((-3.0, 3.0), (-3.0, 3.0)),
        rate_hz=50.0,
    )
    units = {"joint_position": "rad", "joint_velocity": "rad/s", "joint_torque": "N*m"}
    return LogOnlyRobot(spec, [Channel(name, unit, (2,)) for name, unit in units.items()])


@pytest.fixture
def mapping() -> dict[str, Any]:
    """Columns t in ms, H_tau and K_tau in N·m, amps in A; 50 Hz."""
    return {
        "time": {"column": "t", "unit": "ms"},
        "rate_hz": 50,
        "joints": {"hip": "H", "knee": "K"},
        "channels": {
            "joint_torque": {"columns": "{joint}_tau", "unit": "N*m"},
            "draw": {"columns": "amps", "unit": "A", "idle": 1.5},
        },
    }


@pytest.fixture
def store(tmp_path: Path) -> RecordingStore:
    """An empty one."""
    return RecordingStore(tmp_path / "data.zarr", create=True)
