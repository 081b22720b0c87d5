"""The world `field` where speed is held: how a person trims, and what the logs must show of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from field_folder import HOLD, SECONDS, bundle, field, fill_in, holding, write_log

from hts.contracts import HoldSpeed
from hts.errors import ConfigError, RecordingError, WaitingForRobot
from hts.evaluation.final import falls_by_speed
from hts.worlds.base import walking


def head_to_head_at(run: Path, policy: Path, robot, commands) -> list:
    """Ask, record the four blocks with these commands, ask again."""
    with pytest.raises(WaitingForRobot):
        holding(run).head_to_head(policy, policy, [0.8])
    fill_in(run)
    for number, command in enumerate(commands):
        write_log(bundle(run) / "logs" / f"{number:02d}.csv", robot, command=command)
    return holding(run).head_to_head(policy, policy, [0.8])


def test_a_bundle_says_how_to_trim_and_before_which_rows(run, policy):
    with pytest.raises(WaitingForRobot):
        holding(run).head_to_head(policy, policy, [0.8])
    text = (bundle(run) / "README.md").read_text()
    assert "walk with its policy for 12 s" in text and "between 0.4 and 1.2 m/s" in text
    assert "motion capture" in text and "`base_velocity`" in text
    plan = json.loads((bundle(run) / "plan.json").read_text())
    assert [row["trim"] for row in plan] == [True, True, False, False]
    assert [line.count("trim first") for line in text.splitlines() if line.startswith("| 0")] == [1, 1, 0, 0]
    with pytest.raises(WaitingForRobot):
        field(run).head_to_head(policy, policy, [0.8])
    assert len([path for path in (run / "field").iterdir() if path.is_dir()]) == 2  # another request


def test_a_bundle_of_forward_speeds_allows_no_command_backward(run, policy, robot):
    """As of a preset whose training commands both ways; its request keeps the name that earlier versions gave it."""
    world = field(run)
    world.hold_speed(HoldSpeed((-1.5, 1.5)))
    with pytest.raises(WaitingForRobot):
        world.head_to_head(policy, policy, [0.8])
    assert "Stay between 0 and 1.5 m/s" in (bundle(run) / "README.md").read_text()
    assert json.loads((bundle(run) / "manifest.json").read_text())["hold"]["commands"] == [0.0, 1.5]
    assert HoldSpeed((-1.5, 1.5)).named()["commands"] == (-1.5, 1.5)
    fill_in(run)
    for number in range(4):
        write_log(bundle(run) / "logs" / f"{number:02d}.csv", robot, command=-0.1)
    with pytest.raises(RecordingError, match="the command is -0.100 m/s, allowed are 0 to 1.5"):
        world.head_to_head(policy, policy, [0.8])


def test_a_speed_that_is_walked_again_gets_a_bundle_of_its_own(run, policy, robot):
    head_to_head_at(run, policy, robot, [0.82, 0.85, 0.85, 0.82])
    world = field(run)
    world.hold_speed(replace(HOLD, again=1))
    with pytest.raises(WaitingForRobot):  # and does not read the logs of the first time again
        world.head_to_head(policy, policy, [0.8])


def test_the_frozen_command_is_read_from_the_logs(run, policy, robot):
    recordings = head_to_head_at(run, policy, robot, [0.82, 0.85, 0.85, 0.82])
    assert [float(r.notes["held_command"]) for r in recordings] == pytest.approx([0.82, 0.85, 0.85, 0.82])
    assert {r.notes["held_saturated"] for r in recordings} == {"false"}
    assert {r.schedule.commands[0].vx for r in recordings} == {0.8}
    assert [r.robot_samples for r in recordings] == [750, 750, 150, 150]  # 12 s of trimming before the first of each


def test_a_command_at_the_limit_says_so(run, policy, robot):
    recordings = head_to_head_at(run, policy, robot, [0.82, 1.2, 1.2, 0.82])
    assert [r.notes["held_saturated"] for r in recordings] == ["false", "true", "true", "false"]


@pytest.mark.parametrize(
    ("commands", "words"),
    [
        ([0.82, np.linspace(0.8, 0.85, 150), 0.85, 0.82], "01.csv: the command moves between 0.800 and 0.850"),
        ([0.82, 1.3, 1.3, 0.82], "01.csv: the command is 1.300 m/s, allowed are 0.4 to 1.2"),
        ([0.82, 0.85, 0.87, 0.82], "block 2: the policy got 0.870 m/s after 0.850"),
    ],
)
def test_commands_that_were_not_frozen_are_refused_in_one_line(run, policy, robot, commands, words):
    with pytest.raises(RecordingError, match=words) as error:
        head_to_head_at(run, policy, robot, commands)
    assert "\n" not in str(error.value)


def test_holding_needs_a_mapping_with_the_speed_sensor(run, policy):
    with pytest.raises(WaitingForRobot):
        holding(run).collect([policy], walking(0.5, SECONDS))
    assert "trim" not in (bundle(run) / "README.md").read_text()  # first data are collected as ever
    mapping = yaml.safe_load((run / "field" / "mapping.yaml").read_text())
    del mapping["channels"]["base_velocity"]
    path = run / "mine.yaml"
    path.write_text(yaml.safe_dump(mapping))
    field(run, mapping=path).check()
    with pytest.raises(ConfigError, match="needs the channel 'base_velocity'.*motion capture"):
        holding(run, mapping=path).check()


def test_a_round_at_two_speeds_is_one_bundle(run, policy, robot):
    asked = ([policy], policy, [0.5, 0.8])
    with pytest.raises(WaitingForRobot, match="8 of 8 logs"):
        holding(run).head_to_head_round(*asked, 0, SECONDS)
    fill_in(run)
    for number in range(8):
        command = 0.55 if number < 4 else 0.85
        write_log(bundle(run) / "logs" / f"{number:02d}.csv", robot, command=command)
    (row,) = holding(run).head_to_head_round(*asked, 0, SECONDS)
    assert [r.schedule.commands[0].vx for r in row] == [0.5] * 4 + [0.8] * 4
    assert [r.role for r in row] == ["reference", "policy", "policy", "reference"] * 2
    assert len({r.session for r in row}) == 2


def test_a_fall_while_a_command_was_trimmed_counts_and_is_no_frozen_command(run, policy, robot):
    with pytest.raises(WaitingForRobot):
        holding(run).head_to_head(policy, policy, [0.8])
    fill_in(run)
    logs = bundle(run) / "logs"
    for number, command in enumerate([0.82, np.linspace(0.8, 0.9, 50), 0.85, 0.82]):
        seconds = SECONDS if number != 1 else 1.0
        write_log(logs / f"{number:02d}.csv", robot, seconds, command=command)
    beside = yaml.safe_load((run / "field" / "mapping.yaml").read_text())
    beside["recording"] = {"mass_kg": 12.5, "fell": True, "notes": {"fell_while_trimmed": "true"}}
    (logs / "mappings").mkdir()
    (logs / "mappings" / "01.yaml").write_text(yaml.safe_dump(beside))
    recordings = holding(run).head_to_head(policy, policy, [0.8])
    assert [recording.fell for recording in recordings] == [False, True, False, False]
    assert falls_by_speed(recordings, robot.task()) == {"0.8": 1}
    assert recordings[1].robot_samples == 50  # it is the trimming
