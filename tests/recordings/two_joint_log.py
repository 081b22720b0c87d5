"""A log of two joints, ten samples long, with its mapping and its robot."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hts.channels import Channel
from hts.contracts import Robot, RobotSpec
from hts.recordings.csv_reader import make


class LogOnly(Robot):
    """A machine of which only logs exist."""

    def __init__(self, joint_names: tuple[str, ...], torque: float | tuple[float, ...], speed: float = 30.0) -> None:
        count = len(joint_names)
        torques = torque if isinstance(torque, tuple) else (torque,) * count
        self.spec = RobotSpec(
            name="logger",
            joint_names=joint_names,
            default_pose=(0.0,) * count,
            kp=(20.0,) * count,
            kd=(0.5,) * count,
            action_scale=(0.25,) * count,
            torque_limit=torques,
            velocity_limit=(speed,) * count,
            position_limit=((-3.0, 3.0),) * count,
            control_rate_hz=50.0,
            physics_dt=0.005,
            substeps=4,
            base_height=0.3,
        )

    def mjcf(self) -> None:
        return None

    def pretrained_policy(self) -> None:
        return None

    def channels(self) -> Mapping[str, Channel]:
        shape = (self.spec.num_joints,)
        units = {"joint_position": "rad", "joint_velocity": "rad/s", "joint_torque": "N*m", "joint_target": "rad"}
        return {name: Channel(name, unit, shape) for name, unit in units.items()}


TWO_JOINTS = LogOnly(("hip", "knee"), torque=20.0)


def a_mapping(**changes: Any) -> dict[str, Any]:
    return {
        "time": {"column": "t", "unit": "ms"},
        "rate_hz": 50,
        "joints": {"hip": "H", "knee": "K"},
        "channels": {
            "joint_torque": {"columns": "{joint}_tau", "unit": "N*m"},
            "draw": {"columns": "amps", "unit": "A", "sign": -1, "scale": 0.001, "idle": 1.5},
        },
        **changes,
    }


def a_log(
    folder: Path, rows: list[str] | None = None, header: str = "t,K_tau,H_tau,amps", name: str = "log.csv"
) -> Path:
    """Ten samples at 50 Hz: K_tau = i, H_tau = -i, amps = -1000 * i (mA, discharge negative)."""
    file = folder / name
    lines = [f"{1000 + 20 * i},{i},{-i},{-1000 * i}" for i in range(10)] if rows is None else rows
    file.write_text("\n".join([header, *lines] if header else lines) + "\n")
    return file


def read(file: Path | list[Path], mapping: dict[str, Any], robot: Robot = TWO_JOINTS) -> Any:
    return make({}).read(file if isinstance(file, list) else [file], mapping, robot)
