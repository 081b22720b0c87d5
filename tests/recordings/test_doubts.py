"""Doubts of an import are told where recordings are stored, each kind once."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

from walker_recording import a_recording

import hts.recordings
from hts.recordings.doubts import DOUBTS, doubts
from hts.run.job import Job
from hts.worlds import field_alike, field_levels, field_pause

SCALE = "0.16 times what kp (target - position) - kd velocity asks for: is it of the motor's side of the gears?"


def doubtful(name: str, **notes: str):
    return a_recording(notes={"source": name, **notes})


def test_nothing_is_said_without_notes_or_of_others():
    assert doubts([a_recording(), doubtful("00.csv", empty_rows_dropped="1")]) == []


def test_each_kind_is_told_once_with_the_first_that_has_it():
    several = [
        doubtful("00.csv"),
        doubtful("01.csv", joint_torque_scale=SCALE),
        doubtful("02.csv", joint_torque_scale=SCALE, repeated_while_moving="joint_target from 2 to 3 s: stale? Cut"),
    ]
    assert doubts(several) == [
        f"note: joint_torque_scale of 2 of 3 recordings, the first 01.csv: {SCALE}",
        "note: repeated_while_moving of 1 of 3 recordings, the first 02.csv: joint_target from 2 to 3 s: stale? Cut.",
    ]
    assert doubts(several[1:2]) == [f"note: joint_torque_scale of 01.csv: {SCALE}"]


def test_all_that_an_import_doubts_is_among_them():
    found = set()
    of_values = ("pd_torque", "base_speed", "joint_work", "repeated", "attitude", "axes", "feet", "temperatures")
    for name in (*of_values, "exchanged"):
        text = (Path(hts.recordings.__file__).parent / f"{name}.py").read_text()
        found |= set(re.findall(r'return \{\s*"(\w+)": ', text))
    paused = {field_pause.NOTE, field_pause.ORDER_NOTE, field_pause.OVERLAP_NOTE}
    assert found | paused | {field_levels.NOTE, field_alike.NOTE} == set(DOUBTS)


def test_a_run_says_them_of_what_it_keeps():
    said: list[str] = []
    job = SimpleNamespace(
        check_recordings=lambda recordings: None,
        say=said.append,
        store=SimpleNamespace(write=lambda recording: "id"),
    )
    Job.keep(job, [doubtful("00.csv", joint_torque_scale=SCALE)], 0)
    Job.keep(job, [a_recording(notes={})], 0)
    assert said == [f"note: joint_torque_scale of 00.csv: {SCALE}"]
