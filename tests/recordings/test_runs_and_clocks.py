"""Several runs in a file, labels, sums, one channel per file, and two files whose clocks differ."""

from __future__ import annotations

import numpy as np
import pytest

from hts.errors import ConfigError, RecordingError
from hts.recordings.clocks import clock_offset
from hts.recordings.csv_reader import make
from hts.recordings.logs import recording_from_columns, recordings_from_columns


def csv(path, header, *columns):
    rows = zip(*columns, strict=True)
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


@pytest.fixture
def amps(mapping):
    """Only the gauge."""
    del mapping["channels"]["joint_torque"], mapping["joints"]
    return mapping


STEPS = np.arange(40)


# ------------------------------------------------------------------------------------------------------------- runs


def test_a_column_that_changes_begins_a_run(tmp_path, amps, two_joints):
    log = csv(tmp_path / "a.csv", "t,amps,run", np.tile(20 * np.arange(20), 2), 2 + STEPS / 10, np.repeat([3, 4], 20))
    with pytest.raises(RecordingError, match="time does not increase in line 22 of the file"):
        make({}).read([log], amps, two_joints)
    amps["runs"] = {"column": "run"}
    first, second = make({}).read_all([log], amps, two_joints)
    assert (first.num_samples, second.num_samples) == (20, 20)
    np.testing.assert_allclose(second.values("draw"), 2 + np.arange(20, 40) / 10, rtol=1e-6)
    assert second.notes["run_run"] == "4"


def test_runs_may_have_long_numbers_and_are_taken_by_all_of_their_digits(tmp_path, amps, two_joints):
    days = np.repeat([20240301, 20240302], 20)
    log = csv(tmp_path / "a.csv", "t,amps,run", np.tile(20 * np.arange(20), 2), 2 + STEPS / 10, days)
    amps["runs"] = {"column": "run", "take": [20240302]}
    (recording,) = make({}).read_all([log], amps, two_joints)
    np.testing.assert_allclose(recording.values("draw"), 2 + np.arange(20, 40) / 10, rtol=1e-6)
    assert recording.notes["run_run"] == "20240302"
    amps["runs"]["take"] = [20240300]
    with pytest.raises(RecordingError, match="none of the runs in 'run' is asked for. It has 20240301, 20240302"):
        make({}).read_all([log], amps, two_joints)


def test_a_gap_begins_a_run(tmp_path, amps, two_joints):
    log = csv(tmp_path / "a.csv", "t,amps", 20 * STEPS + 5000 * (STEPS >= 15), 2 + STEPS / 10)
    with pytest.raises(RecordingError, match="has nothing for 5.02 s"):
        make({}).read([log], amps, two_joints)
    amps["runs"] = {"gap_seconds": 2}
    assert [one.num_samples for one in make({}).read_all([log], amps, two_joints)] == [15, 25]


def test_a_reader_of_ones_own_has_runs_too(tmp_path, amps, two_joints):
    columns = {"t": 20 * STEPS, "amps": 2 + STEPS / 10, "run": np.repeat([1, 2], 20)}
    amps["runs"] = {"column": "run"}
    assert len(recordings_from_columns([tmp_path], amps, two_joints, lambda path: columns)) == 2
    with pytest.raises(RecordingError, match="2 runs, where one recording is read.*recordings_from_columns"):
        recording_from_columns([tmp_path], amps, two_joints, lambda path: columns)


@pytest.mark.parametrize(
    ("runs", "expected"),
    [
        ({}, "give either `column` or `gap_seconds`"),
        ({"column": "run", "gap_seconds": 1}, "give either `column` or `gap_seconds`"),
        ({"gap_seconds": 1, "take": [1]}, "`take` names numbers of a `column`"),
    ],
)
def test_runs_are_told_apart_in_one_way(tmp_path, amps, two_joints, runs, expected):
    amps["runs"] = runs
    with pytest.raises(ConfigError, match=expected):
        make({}).read_all([tmp_path / "a.csv"], amps, two_joints)


def test_a_row_without_its_run_is_refused(tmp_path, amps, two_joints):
    log = csv(tmp_path / "a.csv", "t,amps,run", 20 * STEPS, 2 + STEPS / 10, ["", *[1] * 39])
    amps["runs"] = {"column": "run"}
    with pytest.raises(RecordingError, match="line 2 of the file has no number in 'run', the column of runs"):
        make({}).read_all([log], amps, two_joints)


# ----------------------------------------------------------------------------------------------------------- labels


@pytest.fixture
def labelled(tmp_path, amps):
    log = csv(tmp_path / "a.csv", "t,amps", 20 * STEPS, 2 + STEPS / 10)
    labels = tmp_path / "a_label.csv"
    labels.write_text("start,end,label\n,,\n0.0,0.3,stand\n0.3,0.78,walk\n")
    amps |= {"files": {"log": "a.csv", "labels": "*_label.csv"}, "labels": {"file": "labels"}}
    amps["channels"]["draw"]["file"] = "log"
    return [log, labels]


def test_labels_are_noted(labelled, amps, two_joints):
    (recording,) = make({}).read_all(labelled, amps, two_joints)
    assert recording.notes["labels"] == "0 to 0.3 s stand; 0.3 to 0.78 s walk"


def test_stretches_of_a_label_become_recordings(labelled, amps, two_joints):
    amps["labels"]["take"] = ["walk"]
    (recording,) = make({}).read_all(labelled, amps, two_joints)
    assert recording.notes["labels"] == "0.3 to 0.78 s walk"
    np.testing.assert_allclose(recording.values("draw"), 2 + np.arange(15, 40) / 10, rtol=1e-6)
    amps["labels"]["take"] = ["run"]
    with pytest.raises(RecordingError, match="none of them is run. They are stand, walk"):
        make({}).read_all(labelled, amps, two_joints)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("start,end,label\n0.5,0.1,walk\n", "line 2: from 0.5 to 0.1 s; its end must come after its beginning"),
        ("start,end,label\n0,one,walk\n", "line 2: beginning and end are no numbers"),
        ("start,end,label\n0,1,\n", "line 2: no word in 'label'"),
        ("start,stop,label\n0,1,walk\n", "No column named 'end'"),
        ("start,end,label\n", "no labels"),
        ("", "No column named 'start'"),
        ("start,end,label\n0,nan,walk\n", "its end must come after its beginning"),
    ],
)
def test_wrong_labels_are_named_with_their_line(labelled, amps, two_joints, text, expected):
    labelled[1].write_text(text)
    with pytest.raises(RecordingError, match=expected) as refused:
        make({}).read_all(labelled, amps, two_joints)
    assert "a_label.csv" in str(refused.value) and "\n" not in str(refused.value)


# ------------------------------------------------------------------------------------------ sums, a channel per file


def test_a_channel_may_be_the_sum_of_columns(tmp_path, amps, two_joints):
    log = csv(tmp_path / "a.csv", "t,left,right", 20 * STEPS, 1 + STEPS / 10, np.where(STEPS == 7, "", "0.5"))
    amps["channels"]["draw"] |= {"columns": ["left", "right"], "sum": True}
    recording = make({}).read([log], amps, two_joints)
    np.testing.assert_allclose(recording.values("draw"), 1.5 + STEPS / 10, rtol=1e-6)
    assert recording.notes["incomplete_rows_filled"] == "draw 1"
    amps["channels"]["draw"]["per_joint"] = True
    with pytest.raises(ConfigError, match="follows the joints, so it is no `sum`"):
        make({}).read([log], amps, two_joints)


def test_a_channel_may_be_the_largest_of_columns(tmp_path, amps, two_joints):
    log = csv(tmp_path / "a.csv", "t,left,right", 20 * STEPS, 1 + STEPS / 10, np.where(STEPS == 7, "", "2.5"))
    amps["channels"]["draw"] |= {"columns": ["left", "right"], "max": True, "scale": 2, "offset": 1}
    recording = make({}).read([log], amps, two_joints)
    np.testing.assert_allclose(recording.values("draw"), 1 + 2 * np.maximum(1 + STEPS / 10, 2.5), rtol=1e-6)
    assert recording.notes["incomplete_rows_filled"] == "draw 1"


def test_the_largest_of_columns_that_count_the_other_way_is_that_of_the_values(tmp_path, amps, two_joints):
    log = csv(tmp_path / "a.csv", "t,left,right", 20 * STEPS, -1 - STEPS / 10, np.full(len(STEPS), -2.5))
    amps["channels"]["draw"] |= {"columns": ["left", "right"], "max": True, "sign": -1}
    recording = make({}).read([log], amps, two_joints)
    np.testing.assert_allclose(recording.values("draw"), np.maximum(1 + STEPS / 10, 2.5), rtol=1e-6)


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ({"per_joint": True}, "follows the joints, so it is no `max`; say per_joint: false"),
        ({"sum": True}, "channels.draw: it is said to be the `sum` of its columns and the `max`"),
        ({"columns": ["left", "left"]}, "columns of 'draw': 'left' is named 2 times"),
        ({"sign": {"hip": -1}}, "no column for each joint. Say one number.$"),
    ],
)
def test_a_largest_that_cannot_be_is_refused_in_one_line(tmp_path, amps, two_joints, said, expected):
    log = csv(tmp_path / "a.csv", "t,left,right", 20 * STEPS, 1 + STEPS / 10, 2 + STEPS / 10)
    amps["channels"]["draw"] |= {"columns": ["left", "right"], "max": True} | said
    with pytest.raises(ConfigError, match=expected) as refused:
        make({}).read([log], amps, two_joints)
    assert "\n" not in str(refused.value)


def test_each_channel_may_have_a_file_of_its_own(tmp_path, mapping, two_joints):
    """One file a channel, all with a column `value`, at rates of their own."""
    fast = np.arange(0, 800, 5)
    files = [
        csv(tmp_path / "tau.csv", "t,hip,knee", fast + 3, fast / 100, -fast / 100),
        csv(tmp_path / "amps.csv", "t,value", 20 * STEPS + 3, 2 + STEPS / 10),
    ]
    mapping |= {"files": {"tau": "tau*", "amps": "amps*"}, "joints": {"hip": "hip", "knee": "knee"}}
    mapping["channels"]["joint_torque"] |= {"columns": "{joint}", "file": "tau"}
    mapping["channels"]["draw"] |= {"columns": "value", "file": "amps"}
    recording = make({}).read(files, mapping, two_joints)
    np.testing.assert_allclose(recording.values("joint_torque")[:, 0], recording.time * 10, atol=1e-4)
    assert recording.notes["clocks"] == "taken as one: tau 0.003 to 0.798 s, amps 0.003 to 0.783 s"


# ----------------------------------------------------------------------------------------------------------- clocks


def wobble(times):
    """Never the same twice."""
    return np.sin(3 * times) + 0.7 * np.sin(7.3 * times + 1) + 0.4 * np.sin(1.7 * times**1.3)


@pytest.mark.parametrize("offset", [-3.217, 0.0, 0.013, 41.5, 1.7e9])
def test_the_offset_of_two_clocks_is_found(offset):
    times, others = np.arange(0, 20, 0.002), np.arange(2.0, 17, 0.011)
    noise = np.random.default_rng(0).normal(0, 0.05, len(others))
    found = clock_offset(times, wobble(times)[:, None], others - offset, (wobble(others) + noise)[:, None], 100.0)
    assert found.seconds == pytest.approx(offset, abs=2e-3)
    assert found.correlation > 0.95 and abs(found.drift_seconds) < 2e-3


def test_a_clock_that_runs_fast_is_noticed():
    times = np.arange(0, 60, 0.01)
    found = clock_offset(times, wobble(times)[:, None], times * 1.0005, wobble(times)[:, None], 100.0)
    assert found.drift_seconds == pytest.approx(-0.0005 * 40, rel=0.25)  # between the middles of first and last third


def test_a_steady_gait_tells_no_offset():
    times = np.arange(0, 20, 0.01)
    gait = np.sin(2 * np.pi * 2 * times)[:, None]
    with pytest.raises(RecordingError, match=r"two offsets of the clocks fit nearly equally well.*0\.50 s apart"):
        clock_offset(times, gait, times, gait, 100.0)


def test_signals_that_are_not_alike_tell_no_offset():
    random, times = np.random.default_rng(1), np.arange(0, 20, 0.01)
    with pytest.raises(RecordingError, match="no offset of the clocks makes the two signals alike"):
        clock_offset(times, random.normal(size=(2000, 1)), times, random.normal(size=(2000, 1)), 100.0)


@pytest.mark.parametrize("late", [5.0, 12.5])
@pytest.mark.parametrize("seed", range(5))
def test_a_signal_that_wanders_off_is_found_where_the_logs_overlap_in_part(seed, late):
    """A level of its own in each stretch, as a current or a height has, and no two logs begin or end together."""
    times = np.arange(0, 60, 0.02)
    level = np.cumsum(np.random.default_rng(seed).normal(size=len(times)))[:, None]
    first, second = times < 40, (times >= late) & (times < late + 40)
    found = clock_offset(times[first], level[first], times[second] - late, level[second], 50.0)
    assert found.seconds == pytest.approx(late, abs=0.01) and found.correlation > 0.999


@pytest.fixture
def two_files(tmp_path, mapping):
    """The robot's log counts from 0 s; the gauge's began 1.5 s later and counts from 1970. Both see the hip's "
    "torque."""
    times = np.arange(0, 20_000, 10)
    late = np.arange(1500, 19_000, 20)
    hip = 5 * wobble(times / 1000)
    walk = csv(tmp_path / "walk.csv", "t,H_tau,K_tau", times, hip, -hip)
    stamps = 1_700_000_000_000 + late - 1500
    gauge = csv(tmp_path / "gauge.csv", "t,amps,force", stamps, 3 + late / 10_000, 5 * wobble(late / 1000))
    mapping |= {"files": {"walk": "walk*", "gauge": "gauge*"}}
    mapping["channels"]["joint_torque"]["file"] = "walk"
    mapping["channels"]["draw"]["file"] = "gauge"
    mapping["channels"]["hip_force"] = {"columns": "force", "unit": "N", "real": False, "file": "gauge"}
    mapping["channels"]["hip"] = {"columns": "H_tau", "unit": "N*m", "real": False, "file": "walk"}
    return [walk, gauge]


def test_two_logs_of_one_run_are_joined_by_what_both_saw(two_files, mapping, two_joints):
    with pytest.raises(RecordingError, match="the stamps of these files hardly overlap.*say `join`"):
        make({}).read(two_files, mapping, two_joints)
    mapping["join"] = {"file": "gauge", "channel": "hip_force", "match": "hip"}
    recording = make({}).read(two_files, mapping, two_joints)
    np.testing.assert_allclose(recording.values("hip_force"), recording.values("hip"), atol=0.05)
    assert recording.values("draw")[0] == pytest.approx(3.15, abs=1e-3)
    assert recording.notes["clocks"].startswith("the clock of 'gauge' moved by +1.50")
    assert "drift" in recording.notes["clocks"]


@pytest.mark.parametrize("apart", [0.0, 5.0, 1000.0])
def test_labels_count_on_the_joined_clock(two_files, mapping, two_joints, tmp_path, apart):
    """However far the two clocks are apart, a label is the same stretch of both files."""
    lines = two_files[1].read_text().splitlines()
    moved = [line.split(",", 1) for line in lines[1:]]
    first = int(moved[0][0])
    kept = [f"{int(stamp) - first + int(1000 * apart)},{rest}" for stamp, rest in moved]
    two_files[1].write_text("\n".join([lines[0], *kept]) + "\n")
    labels = tmp_path / "labels.csv"
    labels.write_text("start,end,label\n4,9,walk\n12,15,walk\n")
    mapping["files"]["labels"] = "labels*"
    mapping["labels"] = {"file": "labels", "take": ["walk"]}
    mapping["join"] = {"file": "gauge", "channel": "hip_force", "match": "hip"}
    parts = make({}).read_all([*two_files, labels], mapping, two_joints)
    assert [part.num_samples / part.rate_hz for part in parts] == pytest.approx([5.0, 3.0], abs=0.1)
    for part, begin in zip(parts, (4.0, 12.0), strict=True):
        np.testing.assert_allclose(part.values("hip_force"), part.values("hip"), atol=0.1)
        assert part.values("draw")[0] == pytest.approx(3 + begin / 10, abs=0.01)


def test_a_join_that_names_the_wrong_thing_is_refused(two_files, mapping, two_joints):
    for join, expected in (
        ({"file": "gage", "channel": "hip_force", "match": "hip"}, "No file named 'gage'. Did you mean 'gauge'"),
        ({"file": "gauge", "channel": "hip", "match": "hip_force"}, "'hip' is not in the file 'gauge'"),
        ({"file": "gauge", "channel": "hip_force", "match": "draw"}, "'draw' is in 'gauge', too"),
        ({"file": "gauge", "channel": "hip_force", "match": "hop"}, "No channel named 'hop'"),
    ):
        with pytest.raises(ConfigError, match=expected):
            make({}).read(two_files, {**mapping, "join": join}, two_joints)


def test_files_that_each_begin_at_zero_are_not_taken_for_one_clock(tmp_path, mapping, two_joints):
    files = [
        csv(tmp_path / "walk.csv", "t,H_tau,K_tau", 20 * STEPS, STEPS / 10, -STEPS / 10),
        csv(tmp_path / "gauge.csv", "t,amps", 20 * STEPS, 2 + STEPS / 10),
    ]
    mapping |= {"files": {"walk": "walk*", "gauge": "gauge*"}}
    mapping["channels"]["joint_torque"]["file"] = "walk"
    mapping["channels"]["draw"]["file"] = "gauge"
    with pytest.raises(RecordingError, match="begin at 0.*If it is one clock, say one_clock: true"):
        make({}).read(files, mapping, two_joints)
    mapping["one_clock"] = True
    assert make({}).read(files, mapping, two_joints).num_samples == 40


def test_a_huge_jump_of_the_clock_is_a_gap_however_long_the_gap_may_be(tmp_path, amps, two_joints):
    """Nobody gets advice about memory."""
    times = np.where(STEPS < 20, 20 * STEPS, 20 * STEPS + 10**15)
    log = csv(tmp_path / "a.csv", "t,amps", times, 2 + STEPS / 10)
    with pytest.raises(RecordingError, match=r"a.csv: 'draw' .amps. has nothing for 1e\+12 s, from 0.380 s on"):
        make({}).read([log], amps, two_joints)
    amps["max_gap_seconds"] = 1e15
    with pytest.raises(RecordingError, match=r"a.csv: from first to last stamp 1e\+12 s.*the clock jumped"):
        make({}).read([log], amps, two_joints)
