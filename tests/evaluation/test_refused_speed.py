"""A policy that keeps the commanded speed at one speed and not at another: what it did is reported, the rest named."""

from __future__ import annotations

import io

import numpy as np
import pytest
from rich.console import Console

from hts.channels import Channel
from hts.config import Command, EvaluationConfig, ScheduleConfig
from hts.contracts.task import VELOCITY
from hts.evaluation.final import entry_of, refused_and_fallen, walked_speeds
from hts.evaluation.head_to_head import TooFewSegments
from hts.evaluation.held import NotComparable
from hts.recordings.recording import Recording, Series
from hts.report.table import print_table
from hts.testing.made_up_recordings import CostObjective

CONFIG = EvaluationConfig(bootstrap=100)


def block(role: str, number: int, commanded: float, walked: float, level: float) -> Recording:
    """22 s of one policy: 20 segments at a speed, m/s, and a cost with a ripple that differs from second to second."""
    count = 22 * 50
    velocity = np.zeros((count, 3))
    velocity[:, 0] = walked
    cost = level + 0.01 * np.sin(np.arange(count) / 37.0)
    series = {
        "base_velocity": Series(Channel("base_velocity", "m/s", (3,)), velocity),
        CostObjective.target.name: Series(CostObjective.target, cost),
    }
    return Recording(
        robot="r",
        world="w",
        policy_hash=role,
        iteration=0,
        joint_names=(),
        kp=(),
        kd=(),
        rate_hz=50.0,
        schedule=ScheduleConfig(commands=(Command(seconds=22, vx=commanded),)),
        idle={CostObjective.target.name: 0.0},
        clock="simulated",
        time=np.arange(count) / 50,
        channels=series,
        mass_kg=10.0,
        session=f"s{commanded}",
        block=number,
        role=role,
    )


def session(commanded: float, policy: float, reference: float) -> list[Recording]:
    """Reference, policy, policy, reference at their mean speeds."""
    rows = [
        ("reference", reference, 10.0),
        ("policy", policy, 8.0),
        ("policy", policy, 8.0),
        ("reference", reference, 10.0),
    ]
    return [block(role, number, commanded, speed, level) for number, (role, speed, level) in enumerate(rows)]


def test_a_speed_that_is_not_kept_is_refused_alone():
    recordings = session(0.5, policy=0.4, reference=0.5) + session(0.8, policy=0.8, reference=0.8)
    results, refused = walked_speeds(CostObjective(), recordings, CONFIG)
    assert list(results) == [0.8]
    assert results[0.8].comparison.improvement == pytest.approx(0.2, abs=0.01)
    assert list(refused) == ["0.5"] and "0 of 40 segments of the policy are valid" in str(refused["0.5"])
    assert "it went 0.40 m/s on average" in str(refused["0.5"])


def test_falls_at_a_refused_speed_are_told_with_it():
    slow = [one.replace(fell=one.role == "policy") for one in session(0.5, policy=0.4, reference=0.5)]
    recordings = slow + session(0.8, policy=0.8, reference=0.8)
    _, refused = walked_speeds(CostObjective(), recordings, CONFIG)
    told = refused_and_fallen(refused, recordings, VELOCITY)
    assert told == {"refused": {"0.5": str(refused["0.5"])}, "refused_falls": {"0.5": 2}}
    fast = {"0.8": NotComparable("too slow")}
    assert refused_and_fallen(fast, recordings, VELOCITY) == {"refused": {"0.8": "too slow"}}


def test_a_speed_that_the_reference_does_not_keep_is_refused_alone():
    recordings = session(0.5, policy=0.5, reference=0.56) + session(0.8, policy=0.8, reference=0.8)
    results, refused = walked_speeds(CostObjective(), recordings, CONFIG)
    assert list(results) == [0.8] and refused["0.5"].role == "reference"
    assert "0 of 40 segments of the reference policy are valid" in str(refused["0.5"])


def test_where_both_miss_a_speed_and_none_is_left_it_is_the_policy_that_is_said():
    recordings = session(0.5, policy=0.5, reference=0.4) + session(0.8, policy=0.6, reference=0.8)
    with pytest.raises(TooFewSegments) as caught:
        walked_speeds(CostObjective(), recordings, CONFIG)
    assert caught.value.role == "policy" and "at 0.8 m/s" in str(caught.value)


def test_nothing_is_refused_of_a_policy_that_keeps_all_speeds():
    recordings = session(0.5, policy=0.5, reference=0.5) + session(0.8, policy=0.8, reference=0.8)
    results, refused = walked_speeds(CostObjective(), recordings, CONFIG)
    assert (list(results), refused) == ([0.5, 0.8], {})


@pytest.mark.parametrize(("policy", "reference"), [(0.4, 0.5), (0.5, 0.4)])
def test_with_no_speed_left_or_a_reference_that_cannot_walk_there_is_no_result(policy, reference):
    with pytest.raises(TooFewSegments):
        walked_speeds(CostObjective(), session(0.5, policy, reference), CONFIG)


def test_the_table_and_the_page_name_the_refused_speed():
    from hts.report.data import RunData
    from hts.report.results import headline

    recordings = session(0.5, policy=0.4, reference=0.5) + session(0.8, policy=0.8, reference=0.8)
    results, refused = walked_speeds(CostObjective(), recordings, CONFIG)
    entry = entry_of(CostObjective(), results) | refused_and_fallen(refused, recordings, VELOCITY)
    out = Console(file=io.StringIO(), width=200)
    print_table({"final": {"policy": "01-00", "objectives": {"cost": entry}}}, out)
    assert "Head-to-head at 0.5 m/s: 0 of 40 segments of the policy are valid" in out.file.getvalue()
    run = RunData.__new__(RunData)
    object.__setattr__(run, "summary", {"final": {"policy": "01-00"}})
    said = headline(run, "cost", entry)
    assert "every speed" not in said
    assert "It is not judged at 0.5 m/s: 0 of 40 segments of the policy are valid (within" in said
