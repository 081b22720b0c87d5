"""A trunk that turns otherwise than it was told: a yaw rate in deg/s, a gyroscope in deg/s or of the other sign."""

from __future__ import annotations

import numpy as np
import pytest
from walker_recording import a_recording

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.errors import RecordingError
from hts.recordings import Series
from hts.recordings.told_turn import check_told_turn

SAMPLES = 500
TOLD = np.repeat([0.0, 0.4, -0.6], [100, 200, 200])
"""rad/s, of each sample at 50 Hz."""
NOISE = 0.05 * np.random.default_rng(1).standard_normal(SAMPLES)


def turning(asked: np.ndarray = TOLD, turned: np.ndarray = 0.85 * TOLD + NOISE, **changes: object):
    """A log of a trunk that was told to turn by `asked`, and turned by `turned`, rad/s."""
    ahead, still = np.full(SAMPLES, 0.5), np.zeros(SAMPLES)
    channels = {
        "command": Series(Channel("command", "1", (3,), may_be_constant=True), np.stack([ahead, still, asked], axis=1)),
        "angular_velocity": Series(
            Channel("angular_velocity", "rad/s", (3,)), np.stack([still, still, turned], axis=1)
        ),
    }
    return a_recording(SAMPLES).replace(**{"channels": channels, **changes})


def test_who_turns_about_as_it_was_told_is_taken_and_so_is_who_hardly_turns():
    for turned in (TOLD, 0.3 * TOLD, np.zeros(SAMPLES), 0.02 * TOLD, NOISE, -0.3 * TOLD, 3 * TOLD):
        check_told_turn(turning(turned=turned), "01.csv")


def test_a_yaw_rate_in_degrees_is_refused_with_what_to_do():
    with pytest.raises(RecordingError) as told:
        check_told_turn(turning(asked=np.degrees(TOLD), turned=0.85 * TOLD), "01.csv")
    assert str(told.value) == (
        "01.csv: told to turn by 29.2 rad/s, the trunk turns 0.015 times as fast ('angular_velocity' about z, 4 s in "
        "which that was told): the commanded yaw rate is probably in deg/s. Expected rad/s, 0.51 of them: convert it "
        "in the log, or in the schedule (the third number of 'command' has no unit of its own); if it is right, say so "
        "with `limits`."
    )
    slow = 0.2 * np.sign(TOLD)
    with pytest.raises(RecordingError, match="in deg/s"):
        check_told_turn(turning(asked=np.degrees(slow), turned=slow), "01.csv")


def test_a_stated_schedule_is_held_against_the_gyroscope_too():
    asked = ScheduleConfig(commands=(Command(seconds=10.0, vx=0.5, yaw_rate=15.0),))
    log = turning(turned=np.full(SAMPLES, 0.24), schedule=asked)
    only = {"angular_velocity": log.channels["angular_velocity"]}
    with pytest.raises(RecordingError, match="told to turn by 15 rad/s, .* probably in deg/s"):
        check_told_turn(log.replace(channels=only), "01.csv")
    check_told_turn(log.replace(channels=only, notes={"schedule": "not stated in the mapping"}), "01.csv")


@pytest.mark.parametrize(
    ("turned", "told"),
    [(-0.8 * TOLD, "one of the two is counted the other way"), (np.degrees(0.8 * TOLD), "is in another unit")],
)
def test_another_sign_and_a_gyroscope_in_degrees_are_refused(turned, told):
    with pytest.raises(RecordingError, match=told):
        check_told_turn(turning(turned=turned), "01.csv")


def test_nothing_is_said_of_a_fall_of_what_a_person_vouches_for_nor_of_a_heading_that_is_kept():
    wrong = turning(turned=-TOLD)
    check_told_turn(wrong.replace(fell=True), "01.csv")
    check_told_turn(wrong, "01.csv", stated={"angular_velocity"})
    check_told_turn(wrong, "01.csv", stated={"command"})
    kept = 0.5 * np.sin(np.arange(SAMPLES) / 10)
    check_told_turn(turning(asked=kept, turned=-kept), "01.csv")


@pytest.mark.parametrize("rate_hz", [50, 200])
def test_a_slalom_is_not_taken_for_one_command_however_fast_the_log_is(rate_hz):
    """The trunk comes a quarter of a period behind, so its mean over a second goes against what is told by then."""
    when = np.arange(20 * rate_hz) / rate_hz
    asked, still = 0.6 * np.sin(np.pi * when), np.zeros(len(when))
    turned = -0.6 * np.cos(np.pi * when)
    channels = {
        "command": Series(
            Channel("command", "1", (3,), may_be_constant=True), np.stack([still + 0.5, still, asked], axis=1)
        ),
        "angular_velocity": Series(
            Channel("angular_velocity", "rad/s", (3,)), np.stack([still, still, turned], axis=1)
        ),
    }
    check_told_turn(a_recording(len(when)).replace(channels=channels, rate_hz=float(rate_hz)), "01.csv")


def test_a_fast_turn_that_nobody_followed_is_no_command_in_degrees():
    check_told_turn(turning(asked=np.full(SAMPLES, 3.5), turned=np.full(SAMPLES, 0.05)), "01.csv")
