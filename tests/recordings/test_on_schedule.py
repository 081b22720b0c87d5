"""Where on its schedule a recording is, whatever its clock says and however its stamps are rounded."""

from __future__ import annotations

import numpy as np
import pytest

from hts.config import Command, ScheduleConfig
from hts.evaluation.segments import cut
from hts.measurement.scoring import Trace, commanded_speed, policy_costs
from hts.recordings.on_schedule import command_at, samples_at
from hts.testing.made_up_recordings import known_recording
from hts.worlds.base import commands


def walked(*set_points: float, seconds: float = 2.0, **given):
    """A recording at 10 Hz that commands each in turn."""
    schedule = ScheduleConfig(commands=tuple(Command(seconds=seconds, vx=one) for one in set_points))
    return known_recording([1.0] * round(seconds * len(set_points)), schedule=schedule, **given)


def test_a_moment_is_compared_halfway_between_samples():
    recording = walked(0.5, 0.8)  # 40 samples
    assert samples_at(recording, [0.0, 0.04, 0.06, 2.0, 3.9, 9.0]).tolist() == [0, 0, 1, 20, 39, 40]
    late = recording.replace(time=recording.time + 0.03 * (np.arange(40) % 2))  # a clock that jitters
    assert samples_at(late, [2.0]).tolist() == [20]


def test_a_schedule_begins_with_the_first_sample_and_its_last_command_lasts():
    for start in (0.0, 7.3, 1.7e9):
        recording = walked(0.5, 0.8, start=start)
        assert command_at(recording).tolist() == [0] * 20 + [1] * 20
    whole = walked(0.5, 0.8)
    assert command_at(whole.replace(time=1.5 * whole.time))[-1] == 1  # samples beyond the schedule
    assert command_at(known_recording([1.0] * 2)).tolist() == [0] * 20


@pytest.mark.parametrize("seconds", [6.0, 12.0, 32.0])
def test_each_sample_is_of_the_command_that_a_world_sent_for_it_whenever_it_begins(seconds):
    recording = walked(0.3, 0.5, 0.8, 1.1, 1.3, seconds=seconds, rate_hz=50.0)
    sent = commands(recording.schedule, 50.0)[:, 0]
    for start in range(0, 3000, 13):  # stamps are control steps since switching on, so their differences are rounded
        begun = recording.replace(time=(start + np.arange(len(sent))) * 0.02)
        assert np.array_equal(commanded_speed(begun), sent)


def test_pieces_and_samples_agree_on_what_was_commanded():
    recording = walked(0.5, 0.8, seconds=6.0, speed=[0.5] * 6 + [0.8] * 6, start=2.2)
    found = cut([recording])
    assert len(found) == 8
    for start, commanded in zip(found.start, found.commanded, strict=True):
        assert (commanded_speed(recording)[start : start + found.samples] == commanded).all()


def test_set_points_that_differ_by_thousandths_are_two():
    recording = walked(0.002, 0.004)
    assert commanded_speed(recording).tolist() == [0.002] * 20 + [0.004] * 20
    traces = [
        Trace(known_recording([1.0] * 2, vx=vx).replace(policy_hash=policy), np.full(10, level), np.full(10, level))
        for policy, vx, level in (("a", 0.002, 1.0), ("b", 0.002, 2.0), ("a", 0.004, 9.0))
    ]
    assert [(cost.policy, cost.speed, cost.measured) for cost in policy_costs(traces)] == [
        ("a", 0.002, 1.0),
        ("b", 0.002, 2.0),
    ]
