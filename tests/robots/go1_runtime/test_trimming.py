"""What a sensor of the speed that sees nothing, or a command at its limit, does to a visit."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.trimming import BLIND, Trimming

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)
PERIOD = 0.02  # s


def showing(*velocity: float):
    """A robot whose sensor shows one velocity from 4 s on."""
    return scripted.ScriptedLink(
        lambda state: dataclasses.replace(state, velocity=np.array(velocity)) if state.stamp > 4.0 else state
    )


@pytest.mark.parametrize("speed", [0.0, 0.55])
def test_a_speed_that_stands_still_to_the_last_digit_ends_the_visit_sitting(visit, bundle, capsys, speed):
    link = showing(speed, 0.0, 0.0)
    assert visit("--yes", link=link) == 2
    shown = capsys.readouterr()
    assert f"has given nothing but {speed:g} m/s for 0.5 s while a command was trimmed" in shown.err
    assert "sat down" in shown.out
    assert not list((bundle / "logs").glob("*.csv"))


def test_a_speed_that_stands_still_turns_the_command_no_further_than_blind_allows():
    trimming, highest = Trimming(0.8, (0.2, 1.5), 12.0, PERIOD), 0.0

    def walk() -> None:
        nonlocal highest
        for number in range(600):
            trimming.see(0.8 + 1e-6 * number if number < 300 else 0.0)
            highest = max(highest, trimming.command)

    with pytest.raises(RuntimeFault, match="nothing but 0 m/s"):
        walk()
    assert highest < 0.8 + 0.8 * (BLIND + 2 * PERIOD)


def test_a_camera_of_ten_a_second_is_no_blind_one():
    trimming = Trimming(0.8, (0.2, 1.5), 12.0, PERIOD)
    for number in range(600):
        trimming.see(0.75 + 1e-3 * (number // 5 % 7))
    assert not trimming.found()[1]


def test_a_command_that_ends_at_a_limit_is_not_recorded_unless_a_person_says_so(visit, bundle, capsys, monkeypatch):
    slow = scripted.ScriptedLink(lambda state: dataclasses.replace(state, velocity=0.001 * state.velocity + 0.05))
    assert visit("--yes", link=slow) == 2
    shown = capsys.readouterr()
    (line,) = shown.err.splitlines()
    assert line.startswith(
        "refused: Trimmed for 0.6 m/s the command ended at 1.5 m/s, an end of what is allowed (0.2 to"
    )
    assert "the sensor showed 0.05 m/s" in line and "--at-limit" in line
    assert "sat down" in shown.out
    assert not (bundle / "logs" / "held.json").exists() and not list((bundle / "logs").glob("*.csv"))
    again = scripted.ScriptedLink(lambda state: dataclasses.replace(state, velocity=0.001 * state.velocity + 0.05))
    assert visit("--yes", "--at-limit", link=again) == 0
    assert all(at_limit for _, at_limit in json.loads((bundle / "logs" / "held.json").read_text()).values())


@pytest.mark.parametrize("vouched", [[], ["--at-limit"]])
def test_a_speed_that_is_counted_the_other_way_ends_the_visit_before_the_robot_hurries(visit, capsys, vouched):
    link = scripted.ScriptedLink(lambda state: dataclasses.replace(state, velocity=-state.velocity))
    assert visit("--yes", *vouched, link=link) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "has shown -0.55 m/s, the other way, for 1 s in which the robot was told" in line
    assert "Correct it (x forward in the trunk's frame)" in line


def test_a_command_goes_no_further_while_the_speed_is_counted_the_other_way():
    trimming = Trimming(0.8, (-1.5, 1.5), 12.0, PERIOD)
    with pytest.raises(RuntimeFault, match="the other way"):
        shown_for(trimming, 12.0, -0.8)
    assert trimming.command == 0.8


def shown_for(trimming: Trimming, seconds: float, speed: float) -> None:
    for number in range(round(seconds / PERIOD)):
        trimming.see(speed + 1e-6 * number)


@pytest.mark.parametrize(("asked", "shown", "end"), [(0.8, 800.0, 0.0), (-0.8, -800.0, 0.0), (0.8, 0.0, 1.5)])
def test_a_command_stays_at_an_end_for_seconds_and_never_turns_round(asked, shown, end):
    trimming = Trimming(asked, (-1.5, 1.5), 48.0, PERIOD)
    with pytest.raises(RuntimeFault, match=rf"ended at -?{end:g} m/s.*the sensor showed {shown:.2f} m/s"):
        shown_for(trimming, 6.0, shown)
    assert abs(trimming.command) == end


def test_who_vouches_for_a_command_at_its_limit_walks_at_it_to_the_end():
    trimming = Trimming(0.8, (0.2, 1.5), 12.0, PERIOD, vouched=True)
    shown_for(trimming, 12.0, 0.3)
    trimming.check()
    assert trimming.found() == (1.5, True)


def test_a_robot_that_sways_about_standing_still_does_not_walk_backwards():
    trimming, rng = Trimming(0.3, (0.2, 1.5), 12.0, PERIOD), np.random.default_rng(0)
    for number in range(600):
        trimming.see(0.3 * np.sin(2 * np.pi * number * PERIOD) + 0.05 * rng.standard_normal())
        if trimming.command > 1.0:
            break
    else:
        pytest.fail("a robot that stands is told to walk faster")
