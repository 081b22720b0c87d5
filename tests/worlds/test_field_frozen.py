"""For how long a measured channel may repeat one number in a log of the world `field`: as its settings say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from field_folder import bundle, field, fill_in, write_log

from hts.errors import RecordingError, WaitingForRobot
from hts.worlds.base import walking

SECONDS, STANDS = 12.0, 6.0


def swinging(log: Path, robot, seconds: float, stands: dict[str, tuple[slice, float]]) -> None:
    """A log whose joints swing at 2 Hz. stands: column -> rows, and the number that it keeps in them."""
    write_log(log, robot, seconds)
    names = log.read_text().splitlines()[0].split(",")
    values = np.loadtxt(log, delimiter=",", skiprows=1)
    swing = 2 * np.pi * 2.0
    for joint, pose in zip(robot.spec.joint_names, robot.spec.default_pose, strict=True):
        values[:, names.index(f"{joint}_position")] = pose + 0.1 * np.sin(swing * values[:, 0])
        values[:, names.index(f"{joint}_velocity")] = 0.1 * swing * np.cos(swing * values[:, 0])
    for name, (rows, number) in stands.items():
        values[rows, names.index(name)] = number
    np.savetxt(log, values, delimiter=",", header=",".join(names), comments="", fmt="%.6f")


def walked(run: Path, policy: Path, robot, beside: dict[str, object] | None = None, **settings: object) -> None:
    """A log whose joints swing at 2 Hz and whose current keeps one number for STANDS s of it, read as the settings say.
    beside: keys of the mapping, with which it lies beside the log instead."""
    with pytest.raises(WaitingForRobot):
        field(run, **settings).collect([policy], walking(0.5, SECONDS))
    fill_in(run)
    logs = bundle(run) / "logs"
    swinging(logs / "00.csv", robot, SECONDS, {"battery_current": (slice(100, 100 + round(STANDS * 50)), 4.9)})
    if beside is not None:
        (logs / "mappings").mkdir()
        own = yaml.safe_load((run / "field" / "mapping.yaml").read_text())
        (logs / "mappings" / "00.yaml").write_text(yaml.safe_dump({**own, **beside}))
    field(run, **settings).collect([policy], walking(0.5, SECONDS))


def test_a_log_is_refused_after_as_many_seconds_as_the_runtime_sits_down_after(run, policy, robot):
    with pytest.raises(RecordingError, match=r"'battery_current' is 4.9 A .* after at most 3 s: the sensor"):
        walked(run, policy, robot)


@pytest.mark.parametrize("seconds", [8.0, 0.0])
def test_with_a_longer_time_in_the_settings_the_log_is_taken(run, policy, robot, seconds):
    walked(run, policy, robot, frozen_real_seconds=seconds)


def test_what_a_mapping_says_of_it_comes_first(run, policy, robot):
    walked(run, policy, robot, beside={"frozen_real_seconds": 8.0})


def test_the_runs_own_mapping_says_it_of_logs_that_describe_themselves_too(run, policy, robot):
    with pytest.raises(WaitingForRobot):
        field(run).collect([policy], walking(0.5, SECONDS))
    own = run / "field" / "mapping.yaml"
    own.write_text("frozen_real_seconds: 8.0\n" + own.read_text())
    walked(run, policy, robot, beside={"frozen_real_seconds": 4.0})


@pytest.mark.parametrize("speed", [0.8, 0.0], ids=["where it was lost", "never read"])
def test_a_speed_that_keeps_one_number_while_the_robot_walks_was_not_read(run, policy, robot, speed):
    """At the asked speed every second would count, whatever the robot did. In the mapping somebody may vouch for it."""

    def ask():
        return field(run, block_seconds=3.3).head_to_head(policy, policy, [0.8])

    with pytest.raises(WaitingForRobot):
        ask()
    fill_in(run)
    for row in range(4):
        stands = {f"base_velocity_{i}": (slice(None), speed) for i in range(3)} if row == 2 else {}
        swinging(bundle(run) / "logs" / f"{row:02d}.csv", robot, 3.3, stands)
    with pytest.raises(
        RecordingError, match=r"02\.csv: 'base_velocity' keeps the numbers .* was probably not being read"
    ):
        ask()
    own = run / "field" / "mapping.yaml"
    mapping = yaml.safe_load(own.read_text())
    mapping["channels"]["base_velocity"]["may_be_constant"] = True
    own.write_text(yaml.safe_dump(mapping))
    assert len(ask()) == 4
