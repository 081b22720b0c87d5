"""The world `field`: a log that an earlier bundle of the run holds stands for no other row."""

from __future__ import annotations

import json
import shutil

import pytest
from field_folder import SECONDS, bundle, field, fill_in, write_log

from hts.errors import RecordingError, WaitingForRobot
from hts.recordings.store import RecordingStore
from hts.worlds.base import walking
from hts.worlds.field_once import READ


def collected(run, policy, robot):
    """First data of one row, read; its log."""
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.8, SECONDS))
    fill_in(run)
    log = bundle(run) / "logs" / "00.csv"
    write_log(log, robot)
    (recording,) = field(run).collect([policy], walking(0.8, SECONDS))
    return log, recording


def asked_again(run, policy, robot, old):
    """A head-to-head of which one row's log is an old one. Returns the logs' folder."""
    with pytest.raises(WaitingForRobot, match="4 of 4 logs"):
        field(run).head_to_head(policy, policy, [0.8])
    (new,) = [path for path in (run / "field").iterdir() if path.is_dir() and path != old.parent.parent]
    for number in range(4):
        write_log(new / "logs" / f"{number:02d}.csv", robot)
    shutil.copy(old, new / "logs" / "00.csv")
    return new / "logs"


def test_a_log_of_an_earlier_bundle_is_refused_with_where_it_was(run, policy, robot):
    old, _ = collected(run, policy, robot)
    logs = asked_again(run, policy, robot, old)
    with pytest.raises(RecordingError, match=rf"00\.csv: the same samples as {old}, which this run has read") as error:
        field(run).head_to_head(policy, policy, [0.8])
    assert "\n" not in str(error.value)
    write_log(logs / "00.csv", robot)
    assert len(field(run).head_to_head(policy, policy, [0.8])) == 4


def test_a_log_that_the_runs_store_holds_is_refused_as_well(run, policy, robot):
    """As in a run that was begun before bundles noted what was read."""
    old, recording = collected(run, policy, robot)
    name = RecordingStore(run / "data.zarr", create=True).write(recording)
    (run / "field" / READ).unlink()
    asked_again(run, policy, robot, old)
    with pytest.raises(RecordingError, match=rf"00\.csv: the same samples as recording {name} of .*data\.zarr"):
        field(run).head_to_head(policy, policy, [0.8])
    assert not (run / "field" / READ).exists()


def test_the_same_bundle_is_read_again_as_often_as_one_likes(run, policy, robot):
    _, recording = collected(run, policy, robot)
    RecordingStore(run / "data.zarr", create=True).write(recording)
    before = (run / "field" / READ).read_text()
    (again,) = field(run).collect([policy], walking(0.8, SECONDS))
    assert again.session == recording.session
    assert (run / "field" / READ).read_text() == before
    assert list(json.loads(before)) == [bundle(run).name]


@pytest.mark.parametrize("damage", ["{", "[]", '{"other": 3}', '{"other": {"mapping.yaml": 3}}'])
def test_what_was_read_is_a_second_look_and_is_written_again_where_it_is_damaged(run, policy, robot, damage):
    collected(run, policy, robot)
    known = run / "field" / READ
    before = known.read_text()
    known.write_text(damage)
    assert len(field(run).collect([policy], walking(0.8, SECONDS))) == 1
    assert known.read_text() == before


def test_a_log_that_was_moved_to_where_it_belongs_is_no_second_one(run, policy, robot):
    old, _ = collected(run, policy, robot)
    asked_again(run, policy, robot, old)
    old.unlink()
    assert len(field(run).head_to_head(policy, policy, [0.8])) == 4
