"""Cutting recordings into 1 s pieces, on worlds with known answers."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hts.config import Command, ScheduleConfig
from hts.errors import RecordingError
from hts.evaluation.segments import cut
from hts.recordings.recording import Series
from hts.testing.made_up_recordings import known_recording


def test_a_steady_walk_of_ten_seconds_gives_eight_valid_pieces():
    segments = cut([known_recording([3.0] * 10)])
    assert (len(segments), segments.total, segments.valid, segments.falls) == (8, 8, 1.0, 0)
    assert segments.values("cost").shape == (8, 10)
    assert segments.speed == pytest.approx(0.8)
    assert segments.commanded.tolist() == [0.8] * 8
    assert segments.time == pytest.approx(np.arange(2.0, 10.0))


def test_pieces_are_the_seconds_after_settling_in_order():
    segments = cut([known_recording(np.arange(6.0))])
    assert segments.values("cost").mean(axis=1).tolist() == [2.0, 3.0, 4.0, 5.0]


def test_a_piece_counts_within_ten_percent_of_the_commanded_speed():
    speeds = [1.0, 1.0, 0.89, 0.91, 1.0, 1.09, 1.11]
    segments = cut([known_recording([1.0] * 7, speed=speeds, vx=1.0)])
    assert segments.speed == pytest.approx([0.91, 1.0, 1.09])
    assert (segments.total, segments.valid) == (5, 3 / 5)


def test_walking_backwards_is_judged_by_the_same_rule():
    segments = cut([known_recording([1.0] * 4, speed=[-0.5, -0.5, -0.52, 0.5], vx=-0.5)])
    assert segments.speed == pytest.approx([-0.52])


def test_standing_on_command_gives_no_valid_piece():
    assert cut([known_recording([1.0] * 5, speed=0.0, vx=0.0)]).valid == 0.0


def test_settling_is_dropped_after_every_change_of_command_but_not_after_a_repeated_one():
    commands = (Command(seconds=2, vx=0.5), Command(seconds=3, vx=0.5), Command(seconds=4, vx=0.8))
    speed = [0.5] * 5 + [0.8] * 4
    segments = cut([known_recording([1.0] * 9, speed=speed, schedule=ScheduleConfig(commands=commands))])
    assert segments.commanded.tolist() == [0.5, 0.5, 0.5, 0.8, 0.8]
    assert segments.time == pytest.approx([2, 3, 4, 7, 8])


def test_a_world_may_say_how_long_its_start_is_unsteady():
    recording = known_recording([1.0] * 6).replace(notes={"unsteady_seconds": "3.0"})
    assert cut([recording]).time == pytest.approx([3, 4, 5])
    with pytest.raises(RecordingError, match="expected a number of seconds"):
        cut([recording.replace(notes={"unsteady_seconds": "a while"})])


def test_pieces_near_a_fall_are_dropped_and_count_as_invalid():
    # it walks well until it lies on its side from second 8 on; second 7 holds the stumble
    segments = cut([known_recording([1.0] * 12, fell_at=8.0)])
    assert segments.time == pytest.approx([2, 3, 4, 5, 6])
    assert (segments.total, segments.falls) == (10, 1)


def test_a_fall_without_recorded_tilt_drops_the_end_and_is_counted_once():
    recording = known_recording([1.0] * 12)
    channels = {name: series for name, series in recording.channels.items() if name != "projected_gravity"}
    segments = cut([recording.replace(channels=channels, fell=True)])
    assert segments.time == pytest.approx([2, 3, 4, 5, 6, 7, 8])
    assert segments.falls == 1


def collapsed(seconds=20, **changes):
    """A robot that sinks down without tipping over, at a moment that no channel tells, and is set up again."""
    return known_recording([1.0] * seconds).replace(fell=True, **changes)


def test_pieces_near_a_collapse_are_dropped_where_the_world_says_when_it_was():
    # it was seen to lie at 9.4 s, half a second after it sank down: from 7.9 s, the stumble included, until it has
    # stood for 2 s
    segments = cut([collapsed(notes={"falls": "1", "fell_at": "9.4"})])
    assert segments.time == pytest.approx([2, 3, 4, 5, 6, *range(12, 20)])
    assert (segments.total, segments.falls) == (18, 1)
    assert cut([collapsed(notes={"fell_at": "9.4, 15.2"})]).time == pytest.approx([2, 3, 4, 5, 6, 12, 18, 19])
    assert cut([collapsed(notes={"fell_at": "9.4, 15.2"})]).falls == 2


def test_a_fall_that_tilts_the_trunk_is_dropped_as_before_where_the_world_says_when_it_was():
    fallen = known_recording([1.0] * 12, fell_at=8.0)
    told = fallen.replace(notes={"falls": "1", "fell_at": "8.0"})
    assert cut([told]).time == pytest.approx(cut([fallen]).time)


def test_where_nobody_knows_when_a_robot_collapsed_nothing_of_the_block_counts():
    segments = cut([collapsed(notes={"falls": "1"})])
    assert (len(segments), segments.total, segments.falls) == (0, 18, 1)


def test_a_recording_that_is_shorter_than_its_schedule_ended_in_the_fall():
    recording = collapsed(notes={"falls": "1"})
    longer = ScheduleConfig(commands=(Command(seconds=30.0, vx=0.8),))
    assert cut([recording.replace(schedule=longer)]).time == pytest.approx(range(2, 17))


def test_falls_that_only_the_world_saw_are_counted_as_it_noted():
    assert cut([known_recording([1.0] * 12).replace(fell=True, notes={"falls": "3"})]).falls == 3


def test_a_world_that_falls_in_three_of_ten_recordings_reports_three_falls():
    recordings = [known_recording([1.0] * 10, fell_at=6.0 if i < 3 else None, block=i) for i in range(10)]
    assert cut(recordings).falls / len(recordings) == pytest.approx(0.3)


def test_a_piece_with_missing_samples_does_not_count():
    recording = known_recording([1.0] * 6)
    time = recording.time.copy()
    time[35:] += 2.0  # the log stopped for two seconds in the middle of second 3
    commands = (Command(seconds=8, vx=0.8),)
    segments = cut([recording.replace(time=time, schedule=ScheduleConfig(commands=commands))])
    assert segments.time == pytest.approx([2.0, 6.0, 7.0])
    assert segments.total == 4


def test_one_sample_may_be_missing_since_clocks_jitter_and_two_may_not():
    recording = known_recording([1.0] * 12, rate_hz=50.0)
    for missing, valid in ((1, 1.0), (2, 0.0), (9, 0.0)):  # of each second
        kept = np.flatnonzero(np.arange(recording.num_samples) % 50 >= missing)
        segments = cut([without(recording, kept)])
        assert segments.valid == valid, missing


@pytest.mark.parametrize("rate_hz", [10.0, 50.0, 200.0, 1000.0])
def test_a_clock_that_goes_slower_than_the_rate_says_misses_no_samples(rate_hz):
    recording = known_recording([1.0] * 8, rate_hz=rate_hz)
    assert cut([recording.replace(time=recording.time * 1.04)]).valid == 1.0


def test_how_many_pieces_miss_samples_is_known():
    recording = known_recording([1.0] * 8, rate_hz=50.0)
    found = cut([without(recording, np.delete(np.arange(400), slice(220, 230)))])
    assert (found.gaps, len(found)) == (1, found.total - 1)


def without(recording, kept):
    channels = {name: Series(one.channel, np.asarray(one.values)[kept]) for name, one in recording.channels.items()}
    return recording.replace(time=recording.time[kept], channels=channels)


@pytest.mark.parametrize(
    ("notes", "expected"),
    [
        ({"unsteady_seconds": "nan"}, "note unsteady_seconds is 'nan', expected a number of seconds from 0 on."),
        ({"unsteady_seconds": "inf"}, "note unsteady_seconds is 'inf', expected a number of seconds from 0 on."),
        ({"unsteady_seconds": "-30"}, "note unsteady_seconds is '-30', expected a number of seconds from 0 on."),
        ({"falls": "3.0"}, "note falls is '3.0', expected how often it fell, a whole number."),
        (
            {"fell_at": "soon"},
            "note fell_at is 'soon', expected seconds after its first sample, up to 5.9, as in 1.5, 4.",
        ),
        (
            {"fell_at": "2, 7"},
            "note fell_at is '2, 7', expected seconds after its first sample, up to 5.9, as in 1.5, 4.",
        ),
    ],
)
def test_a_note_that_says_no_such_number_is_named(notes, expected):
    with pytest.raises(RecordingError, match=f"^A recording's {re.escape(expected)}$"):
        cut([known_recording([1.0] * 6).replace(notes=notes)])


def test_blocks_of_different_sessions_are_different_blocks():
    recordings = [known_recording([1.0] * 4, session=session, block=1) for session in ("a", "b")]
    assert cut(recordings).block.tolist() == [0, 0, 1, 1]


def test_each_piece_knows_the_idle_level_and_the_mass_of_its_own_recording():
    recordings = [known_recording([1.0] * 3, idle=7.0, block=0), known_recording([1.0] * 4, idle=9.0, block=1)]
    segments = cut(recordings)
    assert segments.idle("cost").tolist() == [7.0, 9.0, 9.0]
    assert segments.mass_kg.tolist() == [10.0, 10.0, 10.0]


def test_no_recordings_give_no_pieces():
    segments = cut([])
    assert (len(segments), segments.total, segments.valid) == (0, 0, 0.0)


def test_a_short_recording_gives_no_pieces_but_keeps_its_shapes():
    segments = cut([known_recording([1.0] * 2)])
    assert segments.values("base_velocity").shape == (0, 10, 3)


def test_a_missing_channel_names_the_closest_one():
    with pytest.raises(RecordingError, match="Did you mean 'cost'"):
        cut([known_recording([1.0] * 4)]).values("costs")


def test_a_missing_idle_level_is_named():
    recording = known_recording([1.0] * 4).replace(idle={})
    with pytest.raises(RecordingError, match="no idle level of 'cost'"):
        cut([recording]).idle("cost")


def test_a_missing_mass_says_to_weigh_the_robot():
    with pytest.raises(RecordingError, match="Weigh it"):
        _ = cut([known_recording([1.0] * 4).replace(mass_kg=None)]).mass_kg


def test_recordings_of_different_rates_are_refused():
    with pytest.raises(RecordingError, match="10, 20 Hz"):
        cut([known_recording([1.0] * 4), known_recording([1.0] * 4, rate_hz=20.0)])
