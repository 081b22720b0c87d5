"""What a log's mapping leaves open: the names of joints, and whether a temperature is a rise."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from two_joint_log import LogOnly, a_log, a_mapping, read

from hts.channels import Channel
from hts.errors import ConfigError, RecordingError


class Warm(LogOnly):
    """Its channel `motor_rise` is how much warmer a motor is than the air, K."""

    def channels(self) -> Any:
        return {**super().channels(), "motor_rise": Channel("motor_rise", "K")}


def test_a_rise_of_temperature_is_read_as_it_was_logged(tmp_path: Path) -> None:
    rise = {"columns": "amps", "unit": "delta_degC", "sign": -1, "scale": 0.001}
    channels = {**a_mapping()["channels"], "motor_rise": rise}
    del channels["draw"]
    warm = Warm(("hip", "knee"), torque=20.0)
    recording = read(a_log(tmp_path), a_mapping(channels=channels), warm)
    np.testing.assert_allclose(recording.values("motor_rise"), np.arange(10), atol=1e-5)
    channels["motor_rise"] = {**rise, "unit": "degC"}
    with pytest.raises(ConfigError, match="'motor_rise' is in K on robot 'logger', not degC: degC cannot be converted"):
        read(a_log(tmp_path), a_mapping(channels=channels), warm)


def test_a_unit_of_another_quantity_is_refused(tmp_path: Path) -> None:
    channels = {"joint_torque": {"columns": "{joint}_tau", "unit": "A"}}
    with pytest.raises(
        ConfigError, match=r"'joint_torque' is in N\*m on robot 'logger', not A: .*different quantities"
    ):
        read(a_log(tmp_path), a_mapping(channels=channels))


def test_a_pattern_without_joints_takes_the_robots_own_names(tmp_path: Path) -> None:
    log = a_log(tmp_path, header="t,knee_tau,hip_tau,amps")
    recording = read(log, a_mapping(joints=None))
    steps = np.arange(10)
    np.testing.assert_allclose(recording.values("joint_torque"), np.stack([-steps, steps], axis=1), atol=1e-5)


def test_where_the_robots_names_are_not_the_logs_it_says_what_to_write(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as refused:
        read(a_log(tmp_path), a_mapping(joints=None))
    said = "give `joints`: the robot's joint -> its name in the log, joints: {hip: …, knee: …}. Without it the robot's "
    assert said in str(refused.value)
    assert "log.csv: No column named 'hip_tau'." in str(refused.value)
    other = a_mapping(joints=None, time={"column": "stamp", "unit": "ms"})
    with pytest.raises(RecordingError, match="log.csv: No column named 'stamp'"):
        read(a_log(tmp_path, header="t,knee_tau,hip_tau,amps"), other)
