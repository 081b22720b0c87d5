"""A whole session against a scripted robot, its logs, and what becomes of them in hts."""

from __future__ import annotations

import errno
import importlib.util
import json
import os
import signal
import stat
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from hts import plugins
from hts.contracts import HoldSpeed
from hts.recordings.commanded import check_commanded
from hts.recordings.mapping import load_mapping
from hts.recordings.reading import read_log
from hts.worlds.twin.trimming import Trimming as Twins
from hts_go1_runtime.bundle import load_bundle
from hts_go1_runtime.errors import RuntimeFault, Stopped
from hts_go1_runtime.events import Events
from hts_go1_runtime.fake import failing, standing
from hts_go1_runtime.idle import changed
from hts_go1_runtime.link import DAMPING, NOTHING, Command
from hts_go1_runtime.log import CHANNELS, NOTED, RowLog, samples
from hts_go1_runtime.loop import Loop
from hts_go1_runtime.machine import STAND, TARGET_HIGH, TARGET_LOW, Limits
from hts_go1_runtime.rows import steps_of
from hts_go1_runtime.session import Options, Session
from hts_go1_runtime.trimming import Trimming

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)


def session(bundle: Path, link, options: Options | None = None) -> Session:
    loop = Loop(link, 0.02, Limits())
    options = options or Options(idle_seconds=0.2, warmup_seconds=0.0, mass_kg=13.0)
    return Session(load_bundle(bundle), link, loop, options, Events(bundle / "logs" / "events.jsonl"))


def events(bundle: Path, session: Session) -> list[dict]:
    session.events.close()
    return [json.loads(line) for line in (bundle / "logs" / "events.jsonl").read_text().splitlines()]


def test_a_session_records_its_rows_and_hts_reads_them_as_they_are(bundle):
    link = scripted.ScriptedLink()
    link.speed = 0.55
    found = session(bundle, link)
    assert found.run() == ["00", "01"]
    robot, registry = plugins.load().make_robot("go1"), plugins.load()
    trimmed = [one for one in events(bundle, found) if one["what"] == "trimmed"]
    for name, hashed in (("00", load_bundle(bundle).rows[0].policy_hash), ("01", "e" * 64)):
        mapping = load_mapping(bundle / "logs" / "mappings" / f"{name}.yaml")
        recording = read_log(registry, [bundle / "logs" / f"{name}.csv"], mapping, robot)
        check_commanded(recording, [bundle / "logs" / f"{name}.csv"])
        assert (recording.policy_hash, recording.clock, recording.kp) == (hashed, "simulated", robot.spec.kp)
        assert recording.mass_kg == 13.0
        assert recording.idle == pytest.approx({"battery_current": 3.0, "battery_voltage": 22.0}, abs=0.2)
        assert 50 - 2 <= recording.num_samples <= 50
        assert set(robot.channels()) <= set(recording.channels)
        sent = recording.values("command")[:, 0]
        assert np.ptp(sent) < 1e-6  # frozen
        assert sent[0] == pytest.approx(trimmed[int(name)]["command"], abs=1e-4)
        assert sent[0] > 0.6  # the robot walks too slowly


def test_the_robot_is_moved_without_a_jerk_and_within_its_range(bundle):
    link = scripted.ScriptedLink()
    session(bundle, link).run()
    kinds = [command for _, command in link.sent]
    assert kinds[0] is NOTHING  # idle is measured first
    assert kinds[-1] is DAMPING
    standing_up = [command for command in kinds[10:] if command.kp.any()][:150]
    assert standing_up[0].kp.max() < 1.0  # gains grow from nothing
    steps = np.diff([command.q for command in standing_up], axis=0)
    assert np.abs(steps).max() < 0.06  # rad a step
    targets = np.array([command.q for command in kinds if command.kp.any()])
    assert (targets >= TARGET_LOW).all()
    assert (targets <= TARGET_HIGH).all()


def test_a_stop_leaves_the_rows_before_it_and_the_half_one_apart(bundle):
    # 3.7 s of idling and standing up, then each row: 2 s of trimming and 1 s
    robot = scripted.ScriptedLink(lambda state: failing(state, "over-current") if state.stamp > 9.2 else state)
    found = session(bundle, robot)
    with pytest.raises(Stopped, match=r"over-current: 35.0 A drawn from the pack, at most 30"):
        found.run()
    assert found.done == ["00"]
    assert not (bundle / "logs" / "01.csv").exists()
    assert [one["reason"] for one in events(bundle, found) if one["what"] == "stopped"] == ["over-current"]
    assert robot.sent[-1][1] is DAMPING
    again = session(bundle, scripted.ScriptedLink())  # goes on with the row that is missing, with the command it has
    assert again.run() == ["01"]
    with pytest.raises(RuntimeFault, match="every row has its log"):
        session(bundle, scripted.ScriptedLink()).run()


def test_a_robot_that_is_not_fit_does_not_start(bundle):
    for fault, words in (
        ("temperature", "not fit to start: temperature"),
        ("low voltage", "not fit to start: low volt"),
    ):
        link = scripted.ScriptedLink(lambda state, fault=fault: failing(state, fault))
        with pytest.raises(RuntimeFault, match=words):
            session(bundle, link).run()
        assert link.sent == []


def test_holding_the_speed_needs_a_speed_sensor(bundle):
    import dataclasses

    link = scripted.ScriptedLink(lambda state: dataclasses.replace(state, velocity=np.full(3, np.nan)))
    with pytest.raises(RuntimeFault, match="Connect the speed sensor"):
        session(bundle, link).run()


def test_trimming_is_the_twins():
    hold = HoldSpeed((0.2, 1.5), 12.0)
    ours, theirs = Trimming(0.8, hold.commands, 12.0, 0.02), Twins(np.array([0.8]), hold, 0.02)
    rng, speed = np.random.default_rng(0), 0.0
    for _ in range(600):
        speed += 0.04 * (0.9 * ours.command - speed)
        seen = speed + 0.05 * rng.standard_normal()
        ours.see(seen)
        theirs.see(np.array([seen]))
        assert ours.command == pytest.approx(float(theirs.command[0]))
    (expected,) = theirs.found()
    assert ours.found() == (pytest.approx(expected.command), expected.saturated)


def test_a_speed_that_was_missed_for_a_moment_changes_no_command():
    trimming = Trimming(0.8, (0.2, 1.5), 12.0, 0.02)
    for number in range(600):
        trimming.see(float("nan") if number % 50 < 20 else 0.75 + 1e-6 * number)  # 0.4 s of each second
        assert 0.8 <= trimming.command <= 1.5
    command, at_limit = trimming.found()
    assert command == pytest.approx(trimming.command + 0.05, abs=0.3) and not at_limit


def test_a_sensor_that_is_silent_while_a_command_is_trimmed_ends_the_visit_sitting(bundle):
    import dataclasses

    def blind(state):
        return dataclasses.replace(state, velocity=np.full(3, np.nan)) if state.stamp > 5.0 else state

    link = scripted.ScriptedLink(blind)
    link.speed = 0.55
    found = session(bundle, link)
    with pytest.raises(RuntimeFault, match=r"has given nothing for 0.5 s while a command was trimmed"):
        found.run()
    assert "sat down" in [one["what"] for one in events(bundle, found)]
    assert all(np.isfinite(command.q).all() for _, command in link.sent)


def test_an_idle_current_that_is_another_after_the_visit_is_said(bundle):
    import dataclasses

    link = scripted.ScriptedLink(
        lambda state: dataclasses.replace(state, current=state.current + 0.5) if state.stamp > 12.0 else state
    )
    found = session(bundle, link)
    found.run()
    said = {one["what"]: one for one in events(bundle, found)}
    changed = next(one for what, one in said.items() if what.startswith("the idle current has changed"))
    assert changed["after"] - changed["before"] == pytest.approx(0.5, abs=0.2)


def test_an_idle_current_that_stays_is_measured_again_and_not_worth_a_word(bundle):
    found = session(bundle, scripted.ScriptedLink())
    found.run()
    said = [one["what"] for one in events(bundle, found)]
    assert said.index("idle") < said.index("row") < said.index("sat down") < said.index("idle after")
    assert not [what for what in said if what.startswith("the idle current has changed")]


def test_steps_are_rounded_in_total():
    assert len(steps_of([(0.29, 0.5, 0.0, 0.0)] * 100, 50.0)) == 1450
    assert steps_of([(0.04, 0.5, 0.1, 0.2)], 50.0).tolist() == [[0.5, 0.1, 0.2]] * 2


# ------------------------------------------------------------------------------------------------ the log


def rows(log: RowLog, count: int) -> None:
    for number in range(count):
        state = standing(number, 0.02 * number)
        log.write(100 + 0.02 * number, samples(state, np.zeros(3), Command(STAND, STAND, STAND)), (0.0,) * len(NOTED))


def test_a_full_disk_is_said_and_nothing_is_lost(tmp_path, monkeypatch):
    real, full = os.write, threading.Event()
    full.set()

    def write(handle, data):
        if full.is_set() and len(data) > 1000:
            if len(data) > 3000:
                return real(handle, data[:777])  # some of it fits
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(handle, data)

    monkeypatch.setattr("hts_go1_runtime.log.os.write", write)
    log = RowLog(tmp_path, "00", list(CHANNELS), "the mapping")
    rows(log, 40)
    end = time.monotonic() + 60
    while not log.fault and time.monotonic() < end:
        time.sleep(0.01)
    assert log.fault.endswith("cannot be written (No space left on device)")
    while not (there := (tmp_path / ".00.csv.partial").read_text()).endswith("\n"):  # it is trying again just now
        assert time.monotonic() < end
    assert 2 <= len(there.splitlines()) < 41  # whole lines, which can be read meanwhile
    assert (tmp_path / "mappings" / "00.yaml").exists()
    assert not log.closing().wait(0.2)
    full.clear()
    assert log.closing().wait(60)
    table = np.loadtxt(tmp_path / "00.csv", delimiter=",", skiprows=1)
    assert table[:, 0] == pytest.approx(100 + 0.02 * np.arange(40))
    assert log.fault == ""
    assert (tmp_path / "mappings" / "00.yaml").read_text() == "the mapping"


def test_a_file_system_that_cannot_sync_a_folder_gives_a_log_its_name(tmp_path, monkeypatch):
    real = os.fsync

    def fsync(handle):
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, "Invalid argument")
        real(handle)

    monkeypatch.setattr("hts_go1_runtime.log.os.fsync", fsync)
    log = RowLog(tmp_path, "00", list(CHANNELS))
    rows(log, 3)
    assert log.closing().wait(60)
    assert log.unnamed == "" and [path.name for path in tmp_path.iterdir()] == ["00.csv"]


def test_a_row_that_is_recorded_again_keeps_what_was_there(tmp_path):
    for _ in range(2):
        log = RowLog(tmp_path, "00", list(CHANNELS))
        rows(log, 5)
        assert log.closing(whole=False).wait(60)
    log = RowLog(tmp_path, "00", list(CHANNELS))
    rows(log, 7)
    assert log.closing().wait(60)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [".00.csv.partial-0", ".00.csv.partial-1", "00.csv"]
    assert len((tmp_path / "00.csv").read_text().splitlines()) == 8


def test_what_is_kept_of_a_broken_row_takes_no_name_that_is_there(tmp_path):
    (tmp_path / ".00.csv.partial-1").write_text("of before")  # the one before it, -0, was taken away
    (tmp_path / ".00.csv.partial").write_text("of the last visit")
    log = RowLog(tmp_path, "00", list(CHANNELS))
    rows(log, 5)
    assert log.closing().wait(60)
    assert (tmp_path / ".00.csv.partial-0").read_text() == "of the last visit"
    assert (tmp_path / ".00.csv.partial-1").read_text() == "of before"


def test_a_process_that_is_killed_leaves_what_it_recorded(tmp_path):
    code = """
import sys, time
from pathlib import Path
import numpy as np
from hts_go1_runtime.fake import standing
from hts_go1_runtime.link import Command
from hts_go1_runtime.log import CHANNELS, NOTED, RowLog, samples
folder = Path(sys.argv[1])
log = RowLog(folder, "00", list(CHANNELS))
for number in range(101):
    log.write(0.02 * number, samples(standing(0, 0.0), np.zeros(3), Command(*np.zeros((3, 12)))), (0.0,) * len(NOTED))
partial, end = folder / ".00.csv.partial", time.monotonic() + 60
while not (partial.exists() and len(partial.read_text().splitlines()) == 102) and time.monotonic() < end:
    time.sleep(0.05)
print("there", flush=True)
time.sleep(60)
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
    writer = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], env=environment, stdout=subprocess.PIPE, text=True
    )
    assert writer.stdout.readline() == "there\n"
    writer.send_signal(signal.SIGKILL)
    writer.wait()
    writer.stdout.close()
    assert not (tmp_path / "00.csv").exists()
    assert len(np.loadtxt(tmp_path / ".00.csv.partial", delimiter=",", skiprows=1)) == 101


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ((1.278, 23.496), (1.334, 22.515), False),  # electronics behind a converter: 30.0 W before and after
        ((1.278, 23.5), (1.28, 22.5), False),  # those that draw the same current
        ((1.278, 23.5), (1.40, 22.5), True),
        ((1.278, None), (1.334, None), True),  # no voltage, so the current alone
    ],
)
def test_a_voltage_that_sank_is_nothing_else_that_draws(before, after, told):
    def level(current, voltage):
        return {"battery_current": current} | ({} if voltage is None else {"battery_voltage": voltage})

    assert changed(level(*before), level(*after)) == told
