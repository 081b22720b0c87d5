"""An accumulator that is exchanged while a recording goes on is told; a load that ends, or a slow gauge, is not."""

from __future__ import annotations

import numpy as np
import pytest

from hts.channels import Channel
from hts.recordings import Series
from hts.recordings.doubts import doubts
from hts.recordings.exchanged import exchanged_notes
from hts.recordings.logs import recording_from_columns

RATE, SECONDS = 50, 40
TIME = np.arange(RATE * SECONDS) / RATE
BEFORE = TIME < 20


def noted(charge, volts, unit="%", voltage="V", speed=None, **options):
    channels = {
        "charge": Series(Channel("charge", unit), charge),
        "pack": Series(Channel("pack", voltage), volts),
        "load": Series(Channel("load", "%", (2,)), np.tile(charge, (2, 1)).T),
    }
    if speed is not None:
        channels["joint_velocity"] = Series(Channel("joint_velocity", "rad/s", (2,)), np.tile(speed, (2, 1)).T)
    return exchanged_notes(channels, RATE, **options).get("accumulator_exchanged", "")


CHARGE = np.where(BEFORE, 31 - np.floor(TIME / 10), 96.0)
VOLTS = np.where(BEFORE, 22.4, 24.5) + 0.1 * np.sin(7 * TIME)


def test_a_step_of_charge_and_voltage_is_told_with_both_levels_and_when():
    said = noted(CHARGE, VOLTS)
    assert said.startswith("charge steps up from 30 to 96 % at about 20 s, and pack from 22.")
    assert " V: was it exchanged? " in said and "measure the idle level with each" in said
    assert "from 30 to 96 %" in noted(CHARGE / 100, 1000 * VOLTS, unit="1", voltage="mV")
    assert noted(CHARGE, VOLTS, stated={"charge"}) == noted(CHARGE, VOLTS, stated={"pack"}) == ""


def test_the_robot_may_stand_meanwhile_and_its_gauge_be_away_for_long():
    away = (TIME >= 16) & (TIME < 20)
    still = np.where((TIME > 12) & (TIME < 30), 0.0, 2.0)
    assert "from 30 to 96 %" in noted(np.where(away, 0.0, CHARGE), np.where(away, 0.0, VOLTS), speed=still)
    kept = np.full_like(TIME, 31.0), np.full_like(TIME, 22.4)  # a gauge that goes and comes back
    assert noted(np.where(away, 0.0, kept[0]), np.where(away, 0.0, kept[1]), speed=still) == ""
    assert "and pack from 22." in noted(np.where(TIME < 28, 30.0, 96.0), VOLTS)  # the charge is shown 8 s later


@pytest.mark.parametrize(
    ("charge", "volts"),
    [
        (CHARGE[::-1], VOLTS[::-1]),  # what a discharge looks like
        (CHARGE, np.full_like(TIME, 22.4)),
        (np.full_like(TIME, 30.0), VOLTS),
        (np.where(BEFORE, 90.0, 99.0), VOLTS),
        (CHARGE, np.where(BEFORE, 22.4, 22.9)),
        (30 + 60 * TIME / SECONDS, 22.4 + 2 * TIME / SECONDS),  # on a charger
        (np.where(TIME < 33, 30.0, 96.0), VOLTS),  # 13 s apart: of two events
        (np.where(BEFORE, -5.0, 96.0), VOLTS),  # no charge
    ],
)
def test_steps_of_one_of_the_two_small_ones_and_slow_ones_are_not(charge, volts):
    assert noted(charge, volts) == ""


def test_a_gauge_that_guesses_the_charge_from_a_voltage_that_recovers_is_not_told():
    """As a robot that walked stands, and then is exchanged after all."""
    walks = np.where(BEFORE, 2.0, 0.0)
    assert noted(np.where(BEFORE, 40.0, 55.0), np.where(BEFORE, 22.4, 23.4), speed=walks) == ""
    assert noted(np.where(BEFORE, 40.0, 55.0), np.where(BEFORE, 22.4, 23.4), speed=walks[::-1]) != ""
    late = np.where(TIME < 30, 40.0, 90.0), np.where(TIME < 30, 22.4, 24.4)
    assert "from 40 to 90 % at about 30 s" in noted(*late, speed=walks)


def test_a_recording_of_seconds_is_too_short_to_tell():
    assert noted(CHARGE[875:1115], VOLTS[875:1115]) == ""  # 2.5 s before, 2.3 after
    assert noted(CHARGE[875:1125], VOLTS[875:1125]) != ""


def test_an_import_tells_of_it(tmp_path, two_joints, mapping):
    whole = {"real": False, "may_be_constant": True}
    mapping["channels"] = {
        "charge": {"columns": "soc", "unit": "%", **whole},
        "pack": {"columns": "volts", "unit": "V", **whole},
    }
    columns = {"t": 1000 * TIME, "soc": CHARGE, "volts": VOLTS}
    recording = recording_from_columns([tmp_path / "log"], mapping, two_joints, lambda path: columns)
    (line,) = doubts([recording])
    assert line.startswith("note: accumulator_exchanged of log: charge steps up from 30 to 96 %")
