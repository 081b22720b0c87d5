"""A gauge that counts in tenths of an ampere once a second is told from one that is no longer read."""

from __future__ import annotations

import numpy as np
import pytest

from hts.channels import Channel
from hts.errors import RecordingError
from hts.recordings import Series
from hts.recordings.logs import check_read, recording_from_columns

RATE = 50
STAYS = [5.0, 5.1, 5.1, 5.0, 5.0, 5.2, 5.0, 5.1, 5.0, 5.0, *[5.1] * 8, 5.0, 5.0, 5.1, 5.0]
"""A, one a second: of a walk at one pace; 5.1 stands for 8 s."""
VOLTS = [24.0 - 0.01 * (second % 3) for second in range(60)]


def passes(readings, speed=2.0, volts=None):
    """Whether such a log of a gauge, a reading a second, is taken. speed: of the joints, rad/s, one or one a second."""
    count = len(readings)
    walked = np.repeat(np.broadcast_to(np.asarray(speed, dtype=float), count), RATE)
    channels = {
        "joint_velocity": Series(Channel("joint_velocity", "rad/s", (2,)), np.tile(walked, (2, 1)).T),
        "draw": Series(Channel("draw", "A"), np.repeat(np.asarray(readings, dtype=float), RATE)),
    }
    if volts is not None:
        channels["pack"] = Series(Channel("pack", "V"), np.repeat(np.asarray(volts[:count], dtype=float), RATE))
    try:
        check_read(channels, RATE, ["draw"], "log.csv")
    except RecordingError:
        return False
    return True


def changed(*seconds, by=0.0, to=None):
    """STAYS with other readings in these seconds."""
    return [((one + by) if to is None else to) if at in seconds else one for at, one in enumerate(STAYS)]


def test_a_coarse_slow_gauge_on_a_steady_walk_is_taken_and_a_fine_one_that_stands_as_long_is_not():
    assert passes(STAYS)
    fine = [one if at in range(10, 18) else one + 0.013 * (at % 5) for at, one in enumerate(STAYS)]
    assert not passes(fine)
    assert not passes([0.01 * one for one in fine])


def test_readings_lie_on_a_grid_of_one_to_ten_percent():
    assert passes([one - 5.0 + 9.8 for one in STAYS]) and not passes([one - 5.0 + 10.5 for one in STAYS])
    assert passes([one - 5.0 + 1.2 for one in STAYS]) and not passes([one - 5.0 + 0.8 for one in STAYS])
    off = changed(3, by=0.05)  # 5.05 makes a grid of 0.05, which is a finer gauge than 1 %: 0.0098
    assert not passes(off) and passes(changed(3, by=0.2))
    assert not passes(changed(3, to=5.14))  # 5.0, 5.1, 5.14 and 5.2 lie on none


def test_one_that_changes_by_more_where_it_changes_is_frozen():
    """Nine in ten of the other readings at that pace that follow the first three seconds: of 11, one may be far."""
    assert passes(changed(4, by=0.4)) and not passes(changed(4, 6, by=0.4))


def test_one_that_goes_on_elsewhere_is_frozen():
    """The next reading, and the one before, lie within a step and a half."""
    assert passes(changed(9, 18, to=5.2)) and not passes(changed(18, to=5.3)) and not passes(changed(9, to=4.9))


def test_one_that_changes_far_more_often_is_frozen():
    """Readings stand for a second each elsewhere; 15 of them are a coarse gauge's luck, 17 are not."""

    def stands(seconds):
        return [5.0, 5.1] * 6 + [5.0] * seconds + [5.1, 5.0] * 6

    assert passes(stands(14)) and not passes(stands(17))


def test_a_robot_that_walks_faster_or_slower_meanwhile_draws_another_number():
    assert passes(STAYS, [2.0] * 12 + [2.3] * 10)
    assert not passes(STAYS, [2.0] * 14 + [3.0] * 8)


def test_what_is_drawn_at_another_pace_says_nothing():
    """Twice as fast it takes 8 A: then nothing is left by which the 8 s could be judged but what lies around them."""
    both = [8.0, 8.1] * 10 + STAYS
    assert passes(both, [4.0] * 20 + [2.0] * 22)


END = [*STAYS[:10], *[5.1] * 8]


def test_at_the_end_of_a_log_only_a_voltage_that_goes_on_tells():
    assert not passes(END)
    assert passes(END, volts=VOLTS)
    assert not passes(END, volts=[*VOLTS[:10], *[24.0] * 8])
    assert not passes(END, volts=[*VOLTS[:14], *[24.0] * 4])  # it stands for the last half of these 8 s
    assert not passes([2.5, 2.4, 5.0, *[5.1] * 15], [0.0] * 2 + [2.0] * 16, VOLTS)  # no other reading of this walk


def test_one_that_came_with_the_walk_and_went_with_it_is_taken():
    """Nobody measured while it walked at that pace, but that it changed when it began and when it stopped."""
    speed = [0.0] * 4 + [2.0] * 12 + [0.0] * 4
    walked = [2.5, 2.4, 2.5, 2.5, 4.8, 4.9, *[5.0] * 10, 2.5, 2.4, 2.5, 2.5]
    assert passes(walked, speed)
    assert not passes([2.5, 2.4, 2.5, *[2.5] * 13, 2.4, 2.4, 2.5, 2.5], speed)  # frozen since before it walked
    assert not passes([*walked[:6], *[5.0] * 14, *walked[:4]], [*speed, *[0.0] * 4])  # and long after it stopped
    assert not passes([5.0] * 12 + [2.5, 2.4, 2.5, 2.5], [2.0] * 12 + [0.0] * 4)  # it never came to that


def test_several_numbers_at_once_are_no_such_gauge():
    walked = np.full((len(STAYS) * RATE, 2), 2.0)
    values = np.repeat(np.array([STAYS, STAYS]).T, RATE, axis=0)
    channels = {
        "joint_velocity": Series(Channel("joint_velocity", "rad/s", (2,)), walked),
        "draw": Series(Channel("draw", "A", (2,)), values),
    }
    with pytest.raises(RecordingError, match="keeps the numbers of all its components"):
        check_read(channels, RATE, ["draw"], "log.csv")


@pytest.mark.parametrize("resample", ["hold", "interpolate"])
def test_an_import_takes_it(tmp_path, two_joints, mapping, resample):
    """Held by us, or repeated by the logger, where a sample may lie between two readings."""
    count = len(STAYS) * RATE
    time = 20.004 * np.arange(count)  # ms
    swing = 1.8 * np.sin(2 * np.pi * np.arange(count) / RATE)
    columns = {"t": time, "H_v": swing, "K_v": -swing, "H_tau": swing, "K_tau": swing}

    def shown(readings):
        amps = np.repeat(readings, RATE)
        blank = resample == "hold" and np.arange(count) % RATE > 0
        return lambda path: {**columns, "amps": np.where(blank, np.nan, amps)}

    if resample == "hold":
        mapping["channels"]["draw"]["resample"] = "hold"
    mapping["channels"]["joint_velocity"] = {"columns": "{joint}_v", "unit": "rad/s"}
    files = [tmp_path / "log"]
    assert recording_from_columns(files, mapping, two_joints, shown(STAYS)).num_samples > 1000
    with pytest.raises(RecordingError, match="the sensor was probably not being read"):
        recording_from_columns(files, mapping, two_joints, shown([*STAYS[:10], *[5.0] * 12]))
