"""Which name is suggested in the place of a wrong one: only one that somebody may have meant."""

from __future__ import annotations

import pytest

from hts import units
from hts.errors import unknown_name
from hts.explain import closest
from hts.presets import PRESETS

SECTIONS = ["collection", "engine", "finetune", "gate", "iterations", "objectives", "robot", "seed", "start", "world"]


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("robbot", "robot"),
        ("sead", "seed"),
        ("finetunes", "finetune"),
        ("iteration", "iterations"),
        ("wrold", "world"),
        ("World", "world"),
        ("ROBOT", "robot"),
        ("bot", "robot"),
        ("tune", "finetune"),
    ],
)
def test_a_name_that_is_near_is_suggested(written, meant):
    assert closest(written, SECTIONS).startswith(f" Did you mean '{meant}'? Known: collection,")
    assert f" Did you mean '{meant}'?" in unknown_name("section", written, SECTIONS)


@pytest.mark.parametrize("written", ["old_key", "fields", "agent", "steps", "training", "w", "", "x" * 300])
def test_where_nothing_is_near_nothing_is_suggested(written):
    assert closest(written, SECTIONS) == f" Known: {', '.join(SECTIONS)}."
    assert "Did you mean" not in unknown_name("section", written, SECTIONS)


@pytest.mark.parametrize(
    ("written", "known", "meant"),
    [
        ("stamp", ["t", "amps", "K_tau"], None),
        ("hip_tau", ["t", "K_tau", "amps"], None),
        ("hip_tau", ["t", "hip_torque", "amps"], "hip_torque"),
        ("torque", ["joint_torque", "joint_target"], "joint_torque"),
        ("rate", ["temperature", "voltage"], None),
        ("hop", ["hip", "knee"], "hip"),
        ("g01", ["go1", "go2"], "go1"),
        ("quik", list(PRESETS), "quick"),
    ],
)
def test_nearness_is_of_letters_in_their_order(written, known, meant):
    said = unknown_name("column", written, known)
    assert f"Did you mean '{meant}'?" in said if meant else "Did you mean" not in said


def test_units_are_suggested_as_names_are():
    assert "Did you mean 'degC'?" in units.unknown("DegC")
    assert "Did you mean" not in units.unknown("furlongs")


def test_what_is_no_plugin_is_not_said_to_be_uninstalled():
    assert unknown_name("idle level", "current", ()) == "No idle level named 'current'. Known: none."
