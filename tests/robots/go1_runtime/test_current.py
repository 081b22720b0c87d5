"""Sign and unit of the pack's current and voltage: of another one, no limit would see them."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
from pathlib import Path

import pytest

from hts_go1_runtime.fake import standing
from hts_go1_runtime.machine import Limits
from hts_go1_runtime.safety import Guard

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)
ScriptedLink = scripted.ScriptedLink


def amps(change):
    return ScriptedLink(lambda state: dataclasses.replace(state, current=change(state)))


@pytest.mark.parametrize("options", [(), ("--idle-seconds", "0")])
@pytest.mark.parametrize("change", [lambda state: -state.current, lambda state: 0.0])
def test_a_robot_that_draws_nothing_while_idle_does_not_stand_up(visit, capsys, options, change):
    link = amps(change)
    assert visit("--yes", *options, link=link) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "A while the motors idle, expected above 0" in line and "counts the other way" in line
    assert not any(command.kp.any() for _, command in link.sent)


@pytest.mark.parametrize("share", [1e-3, 0.05])
def test_a_current_in_another_unit_that_no_limit_would_see_is_refused(visit, capsys, share):
    link = amps(lambda state: share * state.current)
    assert visit("--yes", link=link) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "expected 0.2 or more" in line and "no over-current would stop the robot" in line
    assert not any(command.kp.any() for _, command in link.sent)


@pytest.mark.parametrize("times", [1000.0, 100.0, 10.0, math.inf])
def test_a_voltage_in_another_unit_that_no_limit_would_see_is_refused(visit, capsys, times):
    link = ScriptedLink(lambda state: dataclasses.replace(state, voltage=times * state.voltage))
    assert visit("--yes", link=link) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "V, expected at most 40: another unit" in line and "no empty pack would stop the robot" in line
    assert not link.sent


def test_a_current_that_nobody_measures_is_no_current_of_the_wrong_sign(visit):
    assert visit("--yes", link=amps(lambda state: math.nan)) == 0


@pytest.mark.parametrize("current", [31.0, -45.0])
def test_an_over_current_stops_the_robot_whatever_its_sign(current):
    reason, detail = Guard(Limits()).state(dataclasses.replace(standing(0, 0.0), current=current))
    assert reason == "over-current" and f"{current:.1f} A" in detail
