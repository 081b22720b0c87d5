"""What is held out is the user's choice."""

import numpy as np
import pytest

from hts.config import Command, ScheduleConfig
from hts.errors import ConfigError, RecordingError
from hts.measurement.scoring import commanded_speed
from hts.measurement.split import named_part, of_fitted_sessions
from hts.measurement.split_rule import SplitRule, split_by
from hts.testing.known_signals import known_heat


def many(count=4, **changes):
    return [known_heat(i, "abcd"[i % 4], seconds=4.0, id=f"r{i}", **changes) for i in range(count)]


def ids(recordings):
    return [recording.id for recording in recordings]


def test_a_chronological_split_fits_to_the_beginning_of_each_recording():
    parts = split_by(SplitRule.parsed("chronological=0.7"), many(2), 0.2)
    assert ids(parts.training) == ["r0[0:140]", "r1[0:140]"] and ids(parts.held_out) == ["r0[140:200]", "r1[140:200]"]
    whole = many(1)[0].values("heat")
    joined = np.concatenate([parts.training[0].values("heat"), parts.held_out[0].values("heat")])
    assert np.array_equal(joined, whole)
    assert "first 70 %" in parts.how


def test_a_part_keeps_the_commands_of_its_own_time():
    schedule = ScheduleConfig(commands=(Command(seconds=1.0, vx=0.5), Command(seconds=3.0, vx=1.1)))
    whole = known_heat(1, seconds=4.0, schedule=schedule, id="r")
    for start, stop in ((0, 80), (30, 80), (50, 200), (120, 200)):
        assert commanded_speed(named_part(whole, start, stop)).tolist() == commanded_speed(whole)[start:stop].tolist()
    assert named_part(whole, 0, 200) is whole


@pytest.mark.parametrize(
    ("text", "key", "values"),
    [
        ("session=0.5", "session", ("monday", "monday", "tuesday", "tuesday")),
        ("policy=0.5", "policy_hash", ("a", "a", "b", "b")),
    ],
)
def test_what_belongs_together_is_held_out_together(text, key, values):
    recordings = [one.replace(**{key: value}, id=one.id) for one, value in zip(many(), values, strict=True)]
    parts = split_by(SplitRule.parsed(text), recordings, 0.2)
    training, held = ({getattr(one, key) for one in side} for side in (parts.training, parts.held_out))
    assert len(parts.training) == len(parts.held_out) == 2 and not training & held


def test_recordings_of_a_session_that_was_fitted_to_are_counted():
    monday, tuesday, nobody = (
        [one.replace(session=name, id=f"{name}{one.id}") for one in many(2)] for name in ("monday", "tuesday", "")
    )
    assert of_fitted_sessions([monday[0], nobody[0]], [monday[1], tuesday[0], nobody[1]]) == 1
    assert of_fitted_sessions(monday, tuesday) == 0
    parts = split_by(SplitRule.parsed("chronological=0.7"), nobody, 0.2)
    assert of_fitted_sessions(parts.training, parts.held_out) == 2  # the end of a walk is of that walk


def test_names_say_what_is_held_out_and_files_are_known_by_their_source():
    recordings = [one.replace(notes={"source": f"walk{i}.csv"}, id=one.id) for i, one in enumerate(many())]
    parts = split_by(SplitRule.parsed("file=walk2.csv,walk3.csv"), recordings, 0.2)
    assert ids(parts.held_out) == ["r2", "r3"] and parts.how == "file: walk2.csv, walk3.csv"
    assert ids(split_by(SplitRule.parsed("recording=r1"), recordings, 0.2).held_out) == ["r1"]
    with pytest.raises(RecordingError, match="No file named 'walk9.csv'"):
        split_by(SplitRule.parsed("file=walk9.csv"), recordings, 0.2)


def test_a_share_may_be_left_out_and_is_then_that_of_the_settings():
    assert len(split_by(SplitRule.parsed("recording"), many(4), 0.5).held_out) == 2
    assert len(split_by(SplitRule.parsed("recording=0.75"), many(4), 0.5).held_out) == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("chronologic=0.7", "Did you mean 'chronological'"),
        ("chronological=much", "chronological=0.7"),
        ("policy=1.5", "between 0 and 1"),
        ("session=0", "between 0 and 1"),
    ],
)
def test_a_wrong_split_is_one_line(text, said):
    with pytest.raises(ConfigError, match=said) as caught:
        SplitRule.parsed(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["recording=0.1", "recording=r0,r1,r2"])
def test_where_all_would_be_held_out_all_are_named(text):
    with pytest.raises(RecordingError, match=r"all 3 are held out \(r0, r1, r2\). Name fewer, or .* recording=0.7"):
        split_by(SplitRule.parsed(text), many(3), 0.2)
    assert len(split_by(SplitRule.parsed("recording=0.7"), many(3), 0.2).training) == 2


def test_where_there_is_one_it_is_named():
    with pytest.raises(RecordingError, match="there is one, r0. Split in another way"):
        split_by(SplitRule.parsed("recording=0.1"), many(1), 0.2)


def test_where_no_recording_says_its_session_another_split_is_advised():
    with pytest.raises(RecordingError, match=r"all recordings have none.*chronological=0.7"):
        split_by(SplitRule.parsed("session"), many(), 0.2)


def test_a_recording_too_short_to_cut_is_named():
    with pytest.raises(RecordingError, match="r0 has 3 samples"):
        split_by(SplitRule.parsed("chronological=0.7"), [named_part(many(1)[0], 0, 3).replace(id="r0")], 0.2)


@pytest.mark.parametrize("name", ["123456789012", "0012e4567890", "2024"])
def test_an_id_of_digits_alone_is_a_name(name):
    assert SplitRule.parsed(f"session={name}").names == (name,)
