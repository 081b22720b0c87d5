"""The layout unitree_go/msg/LowState: a bag of it becomes a recording with battery and motor temperatures."""

from __future__ import annotations

import importlib.util
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import yaml

from hts.errors import ConfigError
from hts.plugins import load
from hts.recordings.mapping import load_mapping
from hts.recordings.ros_reader import load_definitions

MAPPING = Path(str(files("hts_go1"))) / "logs" / "lowstate.yaml"
STEPS = np.arange(60)
needs_ros = pytest.mark.skipif(
    importlib.util.find_spec("mcap_ros2") is None, reason="the extra hard-to-sim[ros] is not installed"
)


def low_state(step: int) -> dict:
    """Motor m: q = m / 100 beside a stance, dq = step / 10, tau = m / 4 + step / 100, 30 + m degrees; the pack gives
    2000 + step mA."""
    motors = [
        {
            "mode": 1,
            "q": (0.0, 0.9, -1.8)[m % 3] + m / 100,
            "dq": step / 10,
            "tau_est": m / 4 + step / 100,
            "temperature": 30 + m,
            "lost": 0,
        }
        | {"ddq": 0.0, "q_raw": 0.0, "dq_raw": 0.0, "ddq_raw": 0.0, "reserve": [0, 0]}
        for m in range(20)
    ]
    imu = {"quaternion": [1.0, 0, 0, 0], "gyroscope": [0.0] * 3, "accelerometer": [0.0] * 3, "rpy": [0.0] * 3}
    pack = {"version_high": 1, "version_low": 1, "status": 0, "soc": 81, "current": -(2000 + step), "cycle": 3}
    pack |= {"bq_ntc": [25, 25], "mcu_ntc": [30, 30], "cell_vol": [4000] * 15}
    whole = {"head": b"\xfe\xef", "level_flag": 0, "frame_reserve": 0, "sn": [0, 0], "version": [0, 0], "bandwidth": 0}
    whole |= {"imu_state": {**imu, "temperature": 60}, "motor_state": motors, "bms_state": pack}
    whole |= {"foot_force": [20] * 4, "foot_force_est": [0] * 4, "tick": 2 * step, "wireless_remote": bytes(40)}
    whole |= {
        "bit_flag": 0,
        "adc_reel": 0.0,
        "temperature_ntc1": 30,
        "temperature_ntc2": 30,
        "power_v": 29.5 + step / 1000,
    }
    return {**whole, "power_a": 2.0, "fan_frequency": [0] * 4, "reserve": 0, "crc": 0}


@pytest.fixture
def bag(tmp_path):
    """60 messages at 50 Hz."""
    from mcap_ros2.writer import Writer

    text = load_definitions("hts_go1:logs/unitree_go.msg")["unitree_go/msg/LowState"]
    with (tmp_path / "walk.mcap").open("wb") as file:
        writer = Writer(file)
        kind = writer.register_msgdef("unitree_go/msg/LowState", text)
        for step in STEPS.tolist():
            writer.write_message(
                "/lowstate", kind, low_state(step), log_time=1_763_000_000_000_000_000 + 20_000_000 * step
            )
        writer.finish()
    return tmp_path / "walk.mcap"


@needs_ros
def test_a_bag_becomes_a_recording_with_the_pack_and_motor_temperatures(bag):
    robot, given = load().make_robot("go1"), load_mapping(MAPPING)
    reader = load().make_log_reader("ros")
    with pytest.raises(ConfigError, match="channels.battery_current.idle"):
        reader.read([bag], given, robot)
    given["channels"]["battery_current"]["idle"] = 1.5
    recording = reader.read([bag], given, robot)
    order = recording.joint_names
    assert order[:3] == ("FR_hip_joint", "FR_thigh_joint", "FR_calf_joint") and order[-1] == "RL_calf_joint"
    stance = np.tile([0.0, 0.9, -1.8], 4)
    np.testing.assert_allclose(recording.values("joint_position")[0], stance + np.arange(12) / 100, atol=1e-6)
    np.testing.assert_allclose(recording.values("motor_temperature")[0], 30 + np.arange(12), atol=1e-5)
    np.testing.assert_allclose(recording.values("battery_current")[5:-5], 2 + STEPS[5:-5] / 1000, atol=5e-4)
    assert recording.channels["battery_current"].channel.unit == load().make_objective("power").target.unit
    assert recording.idle == {"battery_current": 1.5}
    np.testing.assert_allclose(recording.values("state_of_charge"), 81)


def test_the_mapping_names_every_joint_once_in_the_order_of_the_motors():
    given = yaml.safe_load(MAPPING.read_text())
    assert [given["joints"][joint] for joint in load().make_robot("go1").spec.joint_names] == [
        str(m) for m in range(12)
    ]
