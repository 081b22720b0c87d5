"""One quantity of one joint that stays as it is while the joint moves."""

from __future__ import annotations

import numpy as np
import pytest

from hts.channels import Channel
from hts.errors import RecordingError
from hts.recordings import Series
from hts.recordings.logs import check_still_joints, recording_from_columns

TIMES = np.arange(400) / 50
UNITS = {"joint_position": "rad", "joint_velocity": "rad/s", "joint_torque": "N*m"}


def walking(**stuck):
    """Hip and knee swing at 1 and 1.5 Hz, with the torque of a heavy leg. stuck: channel -> (joint, slice of samples)
    that keep their first number."""
    rates = 2 * np.pi * np.array([1.0, 1.5])
    found = {"joint_position": 0.3 * np.sin(TIMES[:, None] * rates)}
    found["joint_velocity"] = 0.3 * rates * np.cos(TIMES[:, None] * rates)
    found["joint_torque"] = -4.0 * found["joint_position"]
    for name, (joint, samples) in stuck.items():
        found[name][samples, joint] = found[name][samples, joint][0]
    return {name: Series(Channel(name, UNITS[name], (2,)), values) for name, values in found.items()}


@pytest.mark.parametrize("name", list(UNITS))
@pytest.mark.parametrize("samples", [slice(None), slice(200, 400)])
def test_a_joint_of_which_one_column_was_not_written_is_refused_with_its_name_and_times(two_joints, name, samples):
    times = f"from {samples.start / 50 if samples.start else 0:.2f} to 7.98 s"
    with pytest.raises(RecordingError, match=rf"^01.csv: '{name}' of knee is \S+ \S+ {times}, while that joint "):
        check_still_joints(walking(**{name: (1, samples)}), two_joints.spec, 50.0, "01.csv")
    check_still_joints(walking(**{name: (1, samples)}), two_joints.spec, 50.0, "01.csv", stated={name})


def test_a_torque_is_told_by_positions_where_velocities_are_not_there(two_joints):
    log = walking(joint_torque=(0, slice(None)))
    del log["joint_velocity"]
    with pytest.raises(RecordingError, match="'joint_torque' of hip is"):
        check_still_joints(log, two_joints.spec, 50.0, "01.csv")


def test_a_joint_that_moves_or_stands_or_stops_for_a_moment_passes(two_joints):
    check_still_joints(walking(), two_joints.spec, 50.0, "01.csv")
    check_still_joints(walking(joint_torque=(1, slice(100, 200))), two_joints.spec, 50.0, "01.csv")  # 2 s
    locked = walking(**{name: (1, slice(None)) for name in UNITS})
    check_still_joints(locked, two_joints.spec, 50.0, "01.csv")


def test_logs_are_looked_at_so(tmp_path, two_joints, mapping):
    columns = {"t": 1000 * TIMES}
    for name, short in (("joint_position", "q"), ("joint_velocity", "dq"), ("joint_torque", "tau")):
        values = walking(joint_torque=(1, slice(None)))[name].values
        columns |= {f"{joint}_{short}": values[:, at] for at, joint in enumerate("HK")}
    pairs = (("joint_position", "q"), ("joint_velocity", "dq"), ("joint_torque", "tau"))
    mapping["channels"] = {name: {"columns": f"{{joint}}_{short}", "unit": UNITS[name]} for name, short in pairs}
    with pytest.raises(RecordingError, match="log: 'joint_torque' of knee is 0 N"):
        recording_from_columns([tmp_path / "log"], mapping, two_joints, lambda path: columns)
