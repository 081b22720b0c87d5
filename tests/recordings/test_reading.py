"""Mistakes of somebody who writes a log reader: each is one line that names file, reader and package."""

from __future__ import annotations

from pathlib import Path

import pytest

from hts.errors import HtsError, PluginError, RecordingError
from hts.hookspecs import API_VERSION
from hts.plugins import load
from hts.recordings.reading import read_log
from hts.testing.examples.robot.robot import Tiny

READER = """
from hts import hookimpl
from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.contracts import LogReader
import numpy as np

HTS_API = {api}
TIME = np.arange(10) / 50

class Mine(LogReader):
    def read(self, files, mapping, robot):
        from hts.recordings.recording import Recording, Series
        {body}

@hookimpl
def hts_log_readers(register):
    register("mine", lambda settings: Mine())
"""

GOOD = """
        spec, joints = robot.spec, robot.spec.num_joints
        torque = Series(Channel("joint_torque", UNIT, SHAPE), np.random.default_rng(0).normal(size=(10, *SHAPE)))
        return Recording(
            robot=spec.name, world="field", policy_hash="", iteration=0, joint_names=spec.joint_names, kp=spec.kp,
            kd=spec.kd, rate_hz=50.0, schedule=ScheduleConfig(commands=(Command(seconds=0.2, vx=0.0),)), idle={},
            clock="log", time=TIME, channels={"joint_torque": torque},
        )
"""


@pytest.fixture
def read(install):
    """read(body of the reader's method): the recording of walk.log."""

    def read(body: str):
        install("stranger", {"stranger": READER.format(api=API_VERSION, body=body)}, {"stranger": "stranger"})
        return read_log(load(), [Path("walk.log")], {"reader": "mine"}, Tiny())

    return read


def good(unit: str = "N*m", shape: str = "(joints,)") -> str:
    return GOOD.replace("UNIT", repr(unit)).replace("SHAPE", shape)


@pytest.fixture
def refusal(read):
    def refusal(kind: type[HtsError], body: str) -> str:
        with pytest.raises(kind) as caught:
            read(body)
        assert "\n" not in str(caught.value) and str(caught.value).startswith("walk.log: ")
        return str(caught.value)

    return refusal


def test_a_reader_without_a_mistake_gives_its_recording(read):
    assert read(good()).num_samples == 10


def test_a_column_that_is_not_there_is_told(refusal):
    text = refusal(PluginError, "return mapping['channels']['tau']")
    assert text.startswith("walk.log: log reader 'mine' (of stranger) failed, KeyError: 'channels'")


def test_a_schedule_with_a_wrong_key_is_answered_with_the_closest(refusal):
    text = refusal(PluginError, "return ScheduleConfig(comands=[])")
    assert "ScheduleConfig: comands: there is no key 'comands'. Did you mean 'commands'?" in text


def test_what_is_no_recording_is_told(refusal):
    assert "gives a dict, expected a" in refusal(PluginError, "return {}")


def test_a_channel_of_another_shape_than_the_robots_is_told(refusal):
    text = refusal(RecordingError, good(shape="(joints + 1,)"))
    assert "'joint_torque' is N*m" in text and f"robot '{Tiny().spec.name}' has it in N*m" in text


def test_a_channel_in_another_unit_than_the_robots_is_told(refusal):
    assert "'joint_torque' is A " in refusal(RecordingError, good(unit="A"))


def test_the_command_line_says_a_wrong_schedule_in_one_line():
    from pydantic import ValidationError

    from hts.cli.one_line import one_line
    from hts.config import ScheduleConfig

    with pytest.raises(ValidationError) as caught:
        ScheduleConfig(comands=[])
    line, status = one_line(caught.value) or ("", 0)
    assert status == 2 and "\n" not in line
    assert line.startswith("error: ScheduleConfig: comands: there is no key 'comands'. Did you mean 'commands'?")
