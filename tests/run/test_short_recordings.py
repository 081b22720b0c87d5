"""What is said of recordings that are accepted although they end early or late: a visit's logs may, by a tenth."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.recordings.commanded import excess, shortfall
from hts.recordings.recording import Recording, Series
from hts.run.job import Job


def walked(seconds: float, asked: float, name: str = "00.csv", fell: bool = False) -> Recording:
    time = np.arange(round(seconds * 50)) / 50
    return Recording(
        robot="walker",
        world="field",
        policy_hash="abc",
        iteration=0,
        joint_names=(),
        kp=(),
        kd=(),
        rate_hz=50.0,
        schedule=ScheduleConfig(commands=(Command(seconds=asked, vx=0.5),)),
        idle={},
        clock="monotonic",
        time=time,
        channels={"draw": Series(Channel("draw", "A"), time + 1.0)},
        fell=fell,
        notes={"source": name},
    )


def test_a_recording_that_ends_early_is_told_with_what_was_expected_and_found():
    said = "note: 00.csv ends before its schedule does: 73.50 s of 80 s. What is missing counts for nothing."
    assert shortfall([walked(73.5, 80.0)]) == said
    assert shortfall([replace(walked(73.5, 80.0), notes={})]) == said.replace("00.csv", "a recording")


def test_of_several_the_one_that_lacks_most_is_named():
    several = [walked(80.0, 80.0), walked(78.0, 80.0, "01.csv"), walked(9.0, 12.0, "02.csv")]
    assert shortfall(several) == (
        "note: 2 of 3 recordings end before their schedules do, most of all 02.csv: 9.00 s of 12 s. "
        "What is missing counts for nothing."
    )


def test_nothing_is_said_of_a_few_samples_of_a_longer_log_and_of_a_fall_that_is_known():
    assert shortfall([walked(79.9, 80.0), walked(81.0, 80.0), walked(30.0, 80.0, fell=True)]) is None


def test_of_a_recording_that_goes_on_after_its_schedule_it_is_said_how_long_and_what_becomes_of_it():
    several = [walked(80.1, 80.0), walked(87.5, 80.0, "01.csv"), walked(73.5, 80.0, "02.csv")]
    assert excess(several[1:2]) == (
        "note: 01.csv goes on after its schedule: 87.50 s for 80 s. What comes after counts in no comparison, but is "
        "learned from under the last command; cut it off if that had ended."
    )
    assert str(excess([*several, walked(80.2, 80.0)])).startswith(
        "note: 2 of 4 recordings go on after their schedules, longest 01.csv: 87.50 s for 80 s. "
    )
    assert excess([several[0], several[2]]) is None


def test_a_run_says_it_once_of_all_that_it_keeps_of_a_visit():
    said: list[str] = []
    job = SimpleNamespace(
        check_recordings=lambda recordings: None,
        say=said.append,
        store=SimpleNamespace(write=lambda recording: recording.notes["source"]),
    )
    assert Job.keep(job, [walked(80.0, 80.0), walked(73.5, 80.0, "01.csv")], 1) == ["00.csv", "01.csv"]
    assert Job.keep(job, [walked(80.0, 80.0)], 1) == ["00.csv"]
    assert len(said) == 1 and "1 of 2 recordings end" in said[0] and "01.csv: 73.50 s of 80 s" in said[0]
    assert Job.keep(job, [walked(87.5, 80.0)], 1) == ["00.csv"]
    assert len(said) == 2 and "00.csv goes on after its schedule: 87.50 s for 80 s" in said[1]
