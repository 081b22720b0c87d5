"""One column of a log for two things is a line that was copied and not changed: refused, before anything is stored."""

from __future__ import annotations

import pytest
from two_joint_log import a_log, a_mapping, read

from hts.errors import ConfigError

AMPS = {"unit": "mA", "sign": -1, "idle": 1900.0}
TORQUE = {"unit": "N*m"}
SUPPLY = {"draw": {"columns": ["amps", "amps"], **AMPS}}


@pytest.mark.parametrize(
    ("mapping", "said"),
    [
        (a_mapping(joints={"hip": "H", "knee": "H"}), "joints: 'H' is named 2 times (entries 1, 2)"),
        (
            a_mapping(channels={"joint_torque": {"columns": ["K_tau", "K_tau"], **TORQUE}}),
            "columns of 'joint_torque': 'K_tau' is named 2 times (entries 1, 2)",
        ),
        (a_mapping(channels=SUPPLY), "columns of 'draw': 'amps' is named 2 times"),
        (a_mapping(channels={"draw": {**SUPPLY["draw"], "sum": True}}), "columns of 'draw': 'amps' is named 2 times"),
    ],
)
def test_a_mapping_that_names_one_column_twice_is_refused_in_one_line(tmp_path, mapping, said):
    with pytest.raises(ConfigError) as refused:
        read(a_log(tmp_path), mapping)
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_a_column_of_zeros_may_fill_up_a_channel(tmp_path):
    channels = {"velocity": {"columns": ["amps", "K_tau", "K_tau"], "unit": "m/s", "real": False}}
    assert read(a_log(tmp_path), a_mapping(channels=channels)).values("velocity").shape[1] == 3


def test_one_column_may_be_two_channels(tmp_path):
    channels = {"draw": {"columns": "amps", **AMPS}, "again": {"columns": "amps", **AMPS}}
    recording = read(a_log(tmp_path), a_mapping(channels=channels))
    assert (recording.values("draw") == recording.values("again")).all()
