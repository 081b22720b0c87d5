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


def walked(run: Path, policy: Path, robot, beside: dict[str, object] | None = None, **settings: object) -> None:
    """A log whose joints swing at 2 Hz and whose current keeps one number for STANDS s of it, read as the settings say.
    beside: keys of the mapping, with which it lies beside the log instead."""
    with pytest.raises(WaitingForRobot):
        field(run, **settings).collect([policy], walking(0.5, SECONDS))
    fill_in(run)
    logs = bundle(run) / "logs"
    write_log(logs / "00.csv", robot, SECONDS)
    names = (logs / "00.csv").read_text().splitlines()[0].split(",")
    values = np.loadtxt(logs / "00.csv", delimiter=",", skiprows=1)
    swing = 2 * np.pi * 2.0
    for joint, pose in zip(robot.spec.joint_names, robot.spec.default_pose, strict=True):
        values[:, names.index(f"{joint}_position")] = pose + 0.1 * np.sin(swing * values[:, 0])
        values[:, names.index(f"{joint}_velocity")] = 0.1 * swing * np.cos(swing * values[:, 0])
    values[100 : 100 + round(STANDS * 50), names.index("battery_current")] = 4.9
    np.savetxt(logs / "00.csv", values, delimiter=",", header=",".join(names), comments="", fmt="%.6f")
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
