"""The mass and the commanded speed that a mapping states are held against the robot: another unit is one line."""

from __future__ import annotations

import numpy as np
import pytest

from hts import plugins
from hts.contracts import LogOnlyRobot, RobotSpec
from hts.errors import RecordingError
from hts.recordings.logs import recording_from_columns
from hts.recordings.plausible import check_facts
from hts.schedules import Command, ScheduleConfig
from hts.testing.made_up_recordings import known_recording

pytest.importorskip("hts_go1", reason="a robot with a model is needed")


@pytest.fixture(scope="module")
def robot():
    return plugins.load().make_robot("go1")  # its model has 13.1 kg


def stated(mass_kg=12.7, **velocity):
    schedule = ScheduleConfig(commands=(Command(seconds=4.0, **{"vx": 0.8, **velocity}),))
    return known_recording([1.0] * 4).replace(mass_kg=mass_kg, schedule=schedule)


@pytest.mark.parametrize("mass", [3.0, 12.7, 60.0, None])
def test_a_mass_of_the_models_size_passes(robot, mass):
    check_facts(stated(mass), robot, "walk.csv")


@pytest.mark.parametrize(("mass", "shown"), [(12700, "12700"), (1e-300, "1e-300"), (0.0127, "0.0127"), (100, "100")])
def test_a_mass_in_another_unit_is_one_line(robot, mass, shown):
    with pytest.raises(RecordingError) as caught:
        check_facts(stated(mass), robot, "walk.csv")
    said = f"walk.csv: recording.mass_kg is {shown} kg, the model of 'go1' has 13.1 kg. It is probably in another unit"
    assert str(caught.value).startswith(said) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("velocity", "shown"),
    [
        ({"vx": 8e200}, "vx is 8e+200 m/s"),
        ({"vx": -800}, "vx is -800 m/s"),
        ({"vy": 30}, "vy is 30 m/s"),
        ({"yaw_rate": 57}, "yaw_rate is 57 rad/s"),
    ],
)
def test_a_commanded_velocity_in_another_unit_is_one_line(robot, velocity, shown):
    with pytest.raises(RecordingError) as caught:
        check_facts(stated(**velocity), robot, "walk.csv")
    assert str(caught.value).startswith(f"walk.csv: recording.schedule.commands.0.{shown}. Expected at most 20 ")


def test_a_robot_without_legs_may_be_fast_and_without_a_model_any_mass_is_believed():
    limits = {"torque_limit": (20.0,), "velocity_limit": (30.0,), "position_limit": ((-3.0, 3.0),)}
    car = LogOnlyRobot(RobotSpec.log_only("car", ("wheel",), **limits, rate_hz=50), [])
    check_facts(stated(1500, vx=40), car, "drive.csv")
    with pytest.raises(RecordingError, match="Expected at most 100 m/s"):
        check_facts(stated(vx=800), car, "drive.csv")


def test_an_import_looks_at_them(tmp_path, two_joints, mapping):
    mapping["recording"] = {"schedule": {"commands": [{"vx": 800.0}]}}
    count = np.arange(20)
    columns = {"t": 1000 + 20 * count, "H_tau": -count / 2, "K_tau": count / 2, "amps": 2 + count / 10}
    (tmp_path / "walk.x").touch()
    with pytest.raises(RecordingError, match=r"walk\.x: recording\.schedule\.commands\.0\.vx is 800 m/s"):
        recording_from_columns([tmp_path / "walk.x"], mapping, two_joints, lambda path: columns)
