"""A measured channel that keeps one number while the robot moves is refused with its times."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from two_joint_log import TWO_JOINTS

from hts.channels import Channel
from hts.errors import RecordingError
from hts.recordings.logs import recording_from_columns
from hts.recordings.needs import as_declared

RATE, SECONDS = 50, 20
TIMES = np.arange(RATE * SECONDS) / RATE
GAUGE = 5.0 + np.random.default_rng(3).standard_normal(len(TIMES))


def repeating(first: float, last: float, gauge: np.ndarray = GAUGE) -> np.ndarray:
    """The gauge with one number from first to last, s."""
    return np.where((first < TIMES) & (last >= TIMES), gauge[round(first * RATE)], gauge)


def imported(
    gauge: np.ndarray, moving: np.ndarray | float = 1.0, of_all: dict[str, object] | None = None, **settings: object
):
    """A log whose hip and knee swing at 2 and 2.6 Hz times `moving`, with a measured channel. of_all: keys of the
    mapping; settings: of the channel."""
    rates = 2 * np.pi * np.array([2.0, 2.6])
    velocity = np.asarray(moving).reshape(-1, 1) * 0.3 * rates * np.cos(TIMES[:, None] * rates)
    amps = gauge.reshape(len(TIMES), -1)
    columns = {"t": 1000 * TIMES, "amps": amps[:, 0], "amps2": amps[:, -1], "H": velocity[:, 0], "K": velocity[:, 1]}
    mapping = {
        "time": {"column": "t", "unit": "ms"},
        "rate_hz": RATE,
        **(of_all or {}),
        "joints": {"hip": "H", "knee": "K"},
        "channels": {
            "joint_velocity": {"columns": "{joint}", "unit": "rad/s"},
            "draw": {"columns": "amps", "unit": "A", "idle": 1.0, **settings},
        },
    }
    return recording_from_columns([Path("log.csv")], mapping, TWO_JOINTS, lambda path: columns)


def test_a_gauge_that_keeps_one_number_for_more_than_3_s_of_a_walk_is_refused_with_its_times():
    with pytest.raises(RecordingError) as told:
        imported(repeating(2.0, 20.0))
    assert str(told.value) == (
        f"log.csv: 'draw' is {GAUGE[100]:g} A from 2.00 to 19.98 s while the joints move for 18.0 s of that. Expected "
        "another number after at most 3 s: the sensor was probably not being read. Record again, or cut the log there; "
        "if 'draw' may honestly stand still for so long, say may_be_constant: true of it in the mapping, or for how "
        "long there: frozen_real_seconds."
    )


@pytest.mark.parametrize(
    ("own", "may", "found"),
    [
        ({}, True, {"may_be_constant": True}),
        ({"may_be_constant": False}, True, {"may_be_constant": False}),
        ({}, False, {}),
    ],
)
def test_what_an_objective_says_of_its_channel_is_said_in_the_mapping(own, may, found):
    drawn = Channel("draw", "A", may_be_constant=may)
    mapping = {"rate_hz": 50, "channels": {"draw": {"unit": "A", **own}, "speed": {"unit": "m/s"}}}
    declared = as_declared([SimpleNamespace(real_channels=(drawn,))], mapping)
    assert declared["channels"] == {"draw": {"unit": "A", **found}, "speed": {"unit": "m/s"}}
    assert "may_be_constant" not in mapping["channels"]["speed"] and as_declared([], {"rate_hz": 50}) == {"rate_hz": 50}


def test_a_channel_of_several_numbers_is_told_likewise():
    gauge = np.repeat(repeating(2.0, 20.0)[:, None], 2, axis=1)
    with pytest.raises(
        RecordingError, match="'draw' keeps the numbers of all its components from 2.00 to 19.98 s while"
    ):
        imported(gauge, columns=["amps", "amps2"])


def test_one_number_for_3_s_is_taken_and_so_is_more_where_the_mapping_says_that_it_may_be():
    imported(repeating(2.0, 5.0))
    imported(repeating(2.0, 20.0), may_be_constant=True)
    with pytest.raises(RecordingError, match="from 2.00 to 5.10 s"):
        imported(repeating(2.0, 5.1))


def test_a_mapping_may_say_for_how_long_one_number_is_taken_0_for_ever():
    five, six = repeating(2.0, 7.0), repeating(2.0, 8.0)
    imported(five, of_all={"frozen_real_seconds": 5.0})
    with pytest.raises(RecordingError, match="after at most 5 s: the sensor"):
        imported(six, of_all={"frozen_real_seconds": 5.0})
    with pytest.raises(RecordingError, match="after at most 1 s: the sensor"):
        imported(repeating(2.0, 3.5), of_all={"frozen_real_seconds": 1.0})
    imported(repeating(2.0, 20.0), of_all={"frozen_real_seconds": 0.0})


def test_limits_of_a_channel_do_not_make_it_one_that_is_read():
    with pytest.raises(RecordingError, match="not being read"):
        imported(repeating(2.0, 20.0), limits=[0, 60])


def test_a_robot_that_stands_may_draw_the_same_all_the_time_and_moving_is_counted_alone():
    imported(repeating(0.0, 15.0), moving=np.where(TIMES < 13.0, 0.0, 1.0))
    with pytest.raises(RecordingError, match=r"from 0.00 to 17.00 s while the joints move for 4\.\d s"):
        imported(repeating(0.0, 17.0), moving=np.where(TIMES < 13.0, 0.0, 1.0))


@pytest.mark.parametrize("every", [0.25, 1.0])
def test_a_slow_and_coarse_gauge_may_repeat_itself(every):
    held = GAUGE[(np.floor(TIMES / every) * every * RATE).astype(int)]
    imported(np.round(held))
    at = np.isclose(TIMES % every, 0.0, atol=1e-9) | np.isclose(TIMES % every, every, atol=1e-9)
    sparse = np.where(at, np.round(GAUGE), np.nan)
    imported(sparse, resample="hold")


def test_a_gauge_that_is_held_may_stand_for_as_long_as_the_mapping_says():
    at = np.isclose(TIMES % 1.0, 0.0, atol=1e-9) & ~((TIMES > 4.5) & (TIMES < 11.5))
    sparse = np.where(at, GAUGE, np.nan)
    imported(sparse, resample="hold", max_age_seconds=8.0)
    with pytest.raises(RecordingError, match="at most 4 s: the sensor"):
        imported(np.where(TIMES % 1.0 < 0.01, repeating(4.0, 11.0), np.nan), resample="hold")


def test_a_voltage_of_a_coarse_monitor_may_stay_as_it_is():
    volts = repeating(2.0, 20.0, np.round(22.0 + 0.1 * GAUGE, 1))
    imported(volts, unit="V", idle=22.0)
