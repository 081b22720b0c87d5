"""The world `field`: rows that are compared with each other state one idle level and one mass."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from field_folder import bundle, field, fill_in, write_log

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.errors import ConfigError, RecordingError, WaitingForRobot
from hts.plugins import load
from hts.recordings.doubts import remarks
from hts.recordings.recording import Recording, Series
from hts.worlds.field_levels import NOTE, real_channels, with_one_level


def walked(run, policy, robot, changed, **said):
    """A head-to-head whose rows have mappings beside their logs. changed: row -> (channel's idle level, or mass_kg)."""
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(policy, policy, [0.8])
    own = run / "field" / "mapping.yaml"
    empty = own.read_text()
    fill_in(run)
    mapping = yaml.safe_load(own.read_text())
    own.write_text(empty.replace("  mass_kg: null\n", "  {}\n"))
    logs = bundle(run) / "logs"
    (logs / "mappings").mkdir()
    for number in range(4):
        write_log(logs / f"{number:02d}.csv", robot)
        for key, value in {**said, **changed.get(number, {})}.items():
            if key == "mass_kg":
                mapping["recording"][key] = value
            else:
                mapping["channels"][key]["idle"] = value
        (logs / "mappings" / f"{number:02d}.yaml").write_text(yaml.safe_dump(mapping))
    return field(run).head_to_head(policy, policy, [0.8])


def refused(run, policy, robot, changed, **said):
    with pytest.raises(RecordingError) as error:
        walked(run, policy, robot, changed, **said)
    assert "\n" not in str(error.value)
    return str(error.value)


def told(recordings):
    """What is said of idle levels where the recordings are stored."""
    return [line for line in remarks(recordings) if NOTE in line]


def test_idle_levels_that_differ_by_a_fifth_are_refused_with_both_rows(run, policy, robot):
    text = refused(run, policy, robot, {2: {"battery_current": 1.6}}, battery_current=1.3)
    assert "mappings/02.yaml: channels.battery_current.idle is 1.6 A in row 02, but 1.3 A in row " in text
    assert "expected at most 15% apart" in text and "state the level of all rows in" in text


def test_an_idle_level_that_drifted_is_among_the_doubts_that_are_told_of_the_recordings(run, policy, robot, capsys):
    recordings = walked(run, policy, robot, {1: {"battery_current": 1.43}}, battery_current=1.3)
    (line,) = told(recordings)
    assert line.startswith("note: idle_differs of 4 of 4 recordings, the first 00.csv: session ")
    assert "'battery_current' is 1.3 A in row 00 and 1.43 A in row 01 (10.0% apart" in line
    assert "straight into net savings" in line
    assert all(recording.notes[NOTE] in line for recording in recordings)
    assert capsys.readouterr() == ("", "")  # whoever stores them says it


def test_small_differences_are_not_told(run, policy, robot):
    recordings = walked(run, policy, robot, {1: {"battery_current": 1.33}}, battery_current=1.3)
    assert all(NOTE not in recording.notes for recording in recordings)


def test_any_channel_is_compared(run, policy, robot):
    text = refused(run, policy, robot, {3: {"battery_voltage": 27.5}}, battery_voltage=23.0)
    assert "mappings/03.yaml: channels.battery_voltage.idle is 27.5 V in row 03, but 23 V" in text


def warm_rows(*levels, shown):
    """One session of rows with an idle level each, degC, and what all of them show at work."""
    channel = Channel("warmth", "degC", may_be_constant=True)
    schedule = ScheduleConfig(commands=(Command(seconds=0.2, vx=0.5),))
    joints = {"joint_names": ("hip",), "kp": (20.0,), "kd": (0.5,)}
    series, time = {"warmth": Series(channel, np.full(10, shown))}, np.arange(10) / 50
    return [
        Recording(
            "dog",
            "field",
            "abc",
            0,
            **joints,
            rate_hz=50.0,
            schedule=schedule,
            idle={"warmth": level},
            clock="log",
            time=time,
            channels=series,
            session="day",
            block=block,
        )
        for block, level in enumerate(levels)
    ]


def compared(recordings):
    names = [f"{number:02d}" for number in range(len(recordings))]
    return with_one_level(recordings, names, [Path(f"{name}.yaml") for name in names], Path("own.yaml"))


def test_idle_temperatures_are_held_against_what_walking_adds():
    assert all(NOTE not in one.notes for one in compared(warm_rows(1.0, 1.5, 1.5, 1.0, shown=41.0)))
    noted = compared(warm_rows(20.0, 22.0, 22.0, 20.0, shown=61.0))[0].notes[NOTE]
    assert "20 degC in row 00 and 22 degC in row 01 (5.0% of what walking adds to it)" in noted
    with pytest.raises(
        RecordingError, match="38 degC in row 00.*expected at most 15% of what walking adds to it apart"
    ):
        compared(warm_rows(38.0, 40.0, 40.0, 40.0, shown=45.0))


def test_a_level_that_is_small_beside_walking_may_differ(run, policy, robot):
    """0.01 A of the 5 A that walking adds change no result, although they are a tenth of the level."""
    recordings = walked(run, policy, robot, {2: {"battery_current": 0.11}}, battery_current=0.1)
    assert not told(recordings)


def test_masses_that_differ_by_a_kilogram_are_refused(run, policy, robot):
    text = refused(run, policy, robot, {1: {"mass_kg": 14.2}, 2: {"mass_kg": 13.2}}, mass_kg=13.2)
    assert "mappings/01.yaml: recording.mass_kg is 14.2 in row 01, but 13.2 in row" in text


def test_the_level_that_the_runs_own_mapping_states_is_that_of_all_rows(run, policy, robot):
    refused(run, policy, robot, {2: {"battery_current": 1.6}}, battery_current=1.3)
    own = run / "field" / "mapping.yaml"
    mapping = yaml.safe_load(own.read_text())
    mapping["channels"]["battery_current"]["idle"] = 1.3
    own.write_text(yaml.safe_dump(mapping))
    recordings = field(run).head_to_head(policy, policy, [0.8])
    assert {recording.idle["battery_current"] for recording in recordings} == {1.3}
    assert not told(recordings)


@pytest.mark.parametrize("said", [{"idle": None}, {"real": False}], ids=["as the template leaves it", "real: false"])
@pytest.mark.parametrize("channel", ["battery_current", "battery_voltage"])
def test_a_level_that_nobody_stated_is_asked_for_with_the_first_logs(run, policy, robot, said, channel):
    def ask():
        return field(run).collect([policy], ScheduleConfig(commands=(Command(seconds=3.0, vx=0.5),)))

    with pytest.raises(WaitingForRobot):
        ask()
    fill_in(run)
    own = run / "field" / "mapping.yaml"
    mapping = yaml.safe_load(own.read_text())
    level = mapping["channels"][channel].pop("idle")
    mapping["channels"][channel] |= said
    own.write_text(yaml.safe_dump(mapping))
    write_log(bundle(run) / "logs" / "00.csv", robot)
    with pytest.raises(
        ConfigError, match=rf"mapping\.yaml: channels\.{channel}\.idle is not stated, .* write it there"
    ):
        ask()
    mapping["channels"][channel] = {**mapping["channels"][channel], "idle": level, "real": True}
    own.write_text(yaml.safe_dump(mapping))
    assert ask()[0].idle[channel] == level


def test_of_a_log_whose_runtime_wrote_a_mapping_it_is_said_that_it_was_not_copied(run, policy, robot):
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(policy, policy, [0.8])
    for number in range(4):
        write_log(bundle(run) / "logs" / f"{number:02d}.csv", robot)
    with pytest.raises(
        RecordingError, match=r"mass_kg is still empty.* copy .* there is no .*logs/mappings/00\.yaml\."
    ):
        field(run).head_to_head(policy, policy, [0.8])


def test_a_machine_whose_motor_constants_nobody_wrote_down_can_be_measured(robot):
    """They are for the simulated gauge; of it only the names of channels are taken here."""
    registry, bare = load(), copy.copy(robot)
    bare.spec = replace(robot.spec, motors=None)
    objective = registry.make_objective("power")
    names = [channel.name for channel in real_channels([objective], registry, bare)]
    assert names == [channel.name for channel in real_channels([objective], registry, robot)]
    assert "battery_current" in names and bare.spec.motors is None
