"""The world `field`: what was sent in a row is what its schedule asks for."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from field_folder import HOLD, SECONDS, bundle, field, fill_in, write_log

from hts.config import Command, ScheduleConfig
from hts.errors import RecordingError, WaitingForRobot
from hts.worlds.base import walking

STEPS = round(SECONDS * 50)
TWO_SPEEDS = ScheduleConfig(commands=(Command(seconds=6.0, vx=0.5), Command(seconds=6.0, vx=0.8)))


def head_to_head(run, policy, robot, command):
    """Whose row 01 was walked at this command, the others at the one asked for."""
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(policy, policy, [0.8])
    fill_in(run)
    for number in range(4):
        write_log(bundle(run) / "logs" / f"{number:02d}.csv", robot, command=command if number == 1 else None)
    return field(run).head_to_head(policy, policy, [0.8])


def first_data(run, policy, robot, command, schedule=TWO_SPEEDS):
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], schedule)
    fill_in(run)
    write_log(bundle(run) / "logs" / "00.csv", robot, schedule.seconds, command=command)
    return field(run).collect([policy], schedule)


def test_a_row_of_equal_commands_that_was_walked_at_another_one_is_refused(run, policy, robot):
    with pytest.raises(
        RecordingError, match=r"01\.csv: row 01: 'command' is 0\.600 m/s forward.*0\.8 m/s were"
    ) as error:
        head_to_head(run, policy, robot, 0.6)
    assert "\n" not in str(error.value) and "expected within 0.08 m/s" in str(error.value)


@pytest.mark.parametrize(
    "command",
    [
        0.74,
        0.8 + 0.2 * np.sin(np.arange(STEPS)),
        np.minimum(0.8, np.arange(STEPS) * 0.5 / 50),
    ],
    ids=["a stick that is not all the way", "a stick that trembles", "a rate limit of 0.5 m/s²"],
)
def test_what_a_hand_makes_of_a_command_is_the_command(run, policy, robot, command):
    assert len(head_to_head(run, policy, robot, command)) == 4


def test_first_data_are_compared_stretch_by_stretch(run, policy, robot):
    asked = np.repeat([0.5, 0.8], 300)
    assert len(first_data(run, policy, robot, asked)) == 1
    write_log(bundle(run) / "logs" / "00.csv", robot, 12.0, command=np.repeat([0.8, 0.5], 300))
    with pytest.raises(RecordingError, match=r"row 00: 'command' is 0\.800 m/s forward .* from 2 to 6 s, but 0\.5 m/s"):
        field(run).collect([policy], TWO_SPEEDS)
    write_log(bundle(run) / "logs" / "00.csv", robot, 12.0, command=0.0)
    with pytest.raises(RecordingError, match=r"'command' is 0\.000 m/s forward"):
        field(run).collect([policy], TWO_SPEEDS)


def test_first_data_of_a_run_that_holds_the_speed_are_compared_too(run, policy, robot):
    with pytest.raises(RecordingError, match=r"'command' is 0\.500 m/s forward in the mean from 8 to 12 s"):
        first_data(run, policy, robot, 0.5)
    world = field(run)
    assert world.hold_speed(HOLD)
    with pytest.raises(RecordingError, match=r"'command' is 0\.500 m/s forward"):
        world.collect([policy], TWO_SPEEDS)


def test_a_turn_is_compared_where_one_is_asked_for(run, policy, robot):
    turning = ScheduleConfig(commands=(Command(seconds=SECONDS, vx=0.3, yaw_rate=0.6),))
    with pytest.raises(RecordingError, match=r"rad/s turning .* but 0\.6 rad/s were to be sent"):
        first_data(run, policy, robot, 0.3, turning)


def test_a_log_without_its_commands_is_accepted(run, policy, robot):
    with pytest.raises(RecordingError):
        head_to_head(run, policy, robot, 0.6)
    path = run / "field" / "mapping.yaml"
    mapping = yaml.safe_load(path.read_text())
    del mapping["channels"]["command"]
    path.write_text(yaml.safe_dump(mapping))
    assert len(field(run).head_to_head(policy, policy, [0.8])) == 4


def test_the_command_after_a_fall_is_nobodys_mistake(run, policy, robot):
    """Whoever sets the robot up again lets go of the stick."""
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(policy, policy, [0.8])
    fill_in(run)
    logs = bundle(run) / "logs"
    for number in range(4):
        write_log(logs / f"{number:02d}.csv", robot, command=np.where(np.arange(STEPS) < 75, 0.8, 0.0))
    (logs / "mappings").mkdir()
    for number in range(4):
        (logs / "mappings" / f"{number:02d}.yaml").write_text("recording: {fell: true, notes: {fell_at: '1.6'}}\n")
    recordings = field(run).head_to_head(policy, policy, [0.8])
    assert all(recording.fell for recording in recordings)
    (logs / "mappings" / "00.yaml").unlink()
    with pytest.raises(RecordingError, match=r"row 00: 'command' is 0\.000 m/s"):
        field(run).head_to_head(policy, policy, [0.8])


def test_a_schedule_of_standing_is_a_command_of_nothing(run, policy, robot):
    assert len(first_data(run, policy, robot, 0.0, walking(0.0, SECONDS))) == 1
