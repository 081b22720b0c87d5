"""What a bundle's page leaves to a person, and what to the runtime of the robot's package."""

from __future__ import annotations

from pathlib import Path

import pytest

from hts.config import ScheduleConfig
from hts.contracts import HoldSpeed
from hts.worlds.field_bundle import Order, instructions
from hts.worlds.field_manifest import Facts


@pytest.fixture
def page(robot):
    """The page of one row. role: of it; commands: of the runtime, if there is one."""

    def made(role: str, commands: tuple[str, ...], hold: HoldSpeed | None = None) -> str:
        order = Order(
            "00", Path("a.onnx"), ScheduleConfig.model_validate({"commands": [{"seconds": 9, "vx": 0.5}]}), "s", 0, role
        )
        facts = Facts(robot.spec, hold=hold, commands=commands)
        return instructions([order], Path("mapping.yaml"), "hts resume run", facts, [])

    return made


def test_without_a_runtime_a_person_warms_up_swaps_and_keeps_the_heading(page):
    text = page("policy", (), HoldSpeed((0.2, 1.5)))
    assert "swap the policy while it walks, or as fast as you can" in text
    assert "Warm the robot up first, by walking for 10 minutes. Keep the heading by hand. If it falls, look it" in text
    assert "The runtime" not in text
    assert "Warm the robot up" not in page("collection", ())  # first data need none


def test_with_a_runtime_nothing_of_that_is_asked_of_a_person(page):
    text = page("policy", ("python -m runtime run .",), HoldSpeed((0.2, 1.5)))
    assert "by hand" not in text and "swap the policy" not in text and "Warm the robot up" not in text
    assert (
        "The runtime first warms the robot up for 10 minutes and keeps the heading. If it falls, look it over" in text
    )
    assert "The runtime does the steps below by itself.\n\n1. Before a row marked *trim first*" in text
    first = page("collection", ("python -m runtime run .",))
    assert "The runtime keeps the heading. If it falls, look it over, and type the command again." in first
    assert "Hold the speed" not in first
