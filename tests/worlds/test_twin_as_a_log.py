"""A twin's recordings pass the checks of imported logs, although late, noisy and weakened; what is wrong does not."""

from __future__ import annotations

import numpy as np
import pytest

from hts.config import Command, ScheduleConfig
from hts.errors import RecordingError
from hts.recordings import Series
from hts.recordings.base_speed import velocity_notes
from hts.recordings.pd_torque import torque_notes
from hts.worlds.base import request_id, seed_sequence
from hts.worlds.twin.parameters import TwinSettings
from hts.worlds.twin.programme import Block, Session
from hts.worlds.twin.session import Batch

COMMANDS = (Command(seconds=2.0, vx=0.0), Command(seconds=4.0, vx=0.5), Command(seconds=4.0, vx=0.8, yaw_rate=0.3))
LATE_AND_NOISY = {
    "dynamics": {"actuation_delay": 0.03, "gain_scale": 0.8},
    "sensors": {"torque_noise": 1.0, "velocity_noise": 0.5, "position_noise": 0.01},
}


@pytest.mark.parametrize("settings", [{}, LATE_AND_NOISY], ids=["default", "late and noisy"])
def test_a_twins_torques_and_speeds_pass_and_reversed_ones_are_refused(robot, policy, settings):
    made = Batch(robot, TwinSettings(**settings), {}, 1, seed_sequence(0, request_id("test")))
    walked = Session(id="s", blocks=(Block(policy=str(policy), schedule=ScheduleConfig(commands=COMMANDS)),))
    recording = made.run([walked], "twin")[0][0]
    assert torque_notes(recording, robot.spec, "log") == {}
    torque = recording.channels["joint_torque"]
    wrong = {**recording.channels, "joint_torque": Series(torque.channel, -torque.values)}
    with pytest.raises(RecordingError, match="counted the other way"):
        torque_notes(recording.replace(channels=wrong), robot.spec, "log")
    smaller = {**recording.channels, "joint_torque": Series(torque.channel, torque.values / np.float32(6.33))}
    assert "joint_torque_scale" in torque_notes(recording.replace(channels=smaller), robot.spec, "log")
    assert velocity_notes(recording, robot, "log") == {}
    velocity = recording.channels["base_velocity"]
    wrong = {**recording.channels, "base_velocity": Series(velocity.channel, -velocity.values)}
    with pytest.raises(RecordingError, match="does not lie in the commanded direction"):
        velocity_notes(recording.replace(channels=wrong), robot, "log")
