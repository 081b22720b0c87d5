"""Every block counts the same and every session, however many of its seconds are valid."""

from __future__ import annotations

import numpy as np
import pytest

from hts.config import EvaluationConfig
from hts.evaluation.balance import Balance, mean_of_blocks
from hts.evaluation.head_to_head import TooFewSegments, compare, point
from hts.evaluation.segments import cut
from hts.recordings.recording import Recording, Series
from hts.testing.made_up_recordings import CostObjective, known_head_to_head

OBJECTIVE = CostObjective()
QUICK = EvaluationConfig(bootstrap=200)


def off_speed(recording: Recording, seconds: int) -> Recording:
    """The last so many seconds at a speed that nobody asked for."""
    series = recording.channels["base_velocity"]
    values = np.array(series.values)
    if seconds:
        values[-round(seconds * recording.rate_hz) :, 0] *= 1.2
    return recording.replace(channels={**recording.channels, "base_velocity": Series(series.channel, values)})


@pytest.mark.parametrize("lost", [0, 20, 30])
def test_a_drift_cancels_however_many_seconds_the_last_block_has_left(lost):
    """Two equal policies on a machine that gets dearer by a tenth: 60 % of the last block's seconds may be lost."""
    blocks = known_head_to_head(8.0, 8.0, drift=0.8)
    found = compare(OBJECTIVE, [off_speed(one, lost if one.block == 3 else 0) for one in blocks], QUICK)
    assert found.policy_segments.total - len(found.policy_segments) == lost
    # the lost seconds are the latest, so this block is earlier by lost / 2 of 160 s, and the policy by half of that
    assert found.improvement == pytest.approx(0.1 * lost / 4 / 160, abs=3e-4)


def test_pooled_seconds_would_take_the_drift_for_a_saving():
    blocks = known_head_to_head(8.0, 8.0, drift=0.8)
    blocks = [off_speed(one, 30 if one.block == 3 else 0) for one in blocks]
    pooled = [
        OBJECTIVE.score(cut([one for one in blocks if one.role == role]))["net_cost"]
        for role in ("policy", "reference")
    ]
    balanced = point(OBJECTIVE, blocks, QUICK).improvement
    assert 1 - pooled[0].mean() / pooled[1].mean() > 4 * balanced > 0


@pytest.mark.parametrize("days", [2, 4, 16])
def test_who_keeps_fewer_seconds_on_dear_days_is_not_taken_for_thrifty(days):
    """20 % are saved each day, and days cost 0.7 to 1.3 times as much; where it is dear the policy loses half."""
    recordings = []
    for day, cost in enumerate(np.linspace(0.7, 1.3, days)):
        own = known_head_to_head(8.0 * cost, 10.0 * cost, scatter=0.005, seed=day)
        lost = 19 if cost > 1 else 0
        recordings += [off_speed(one, lost if one.role == "policy" else 0).replace(session=f"day {day}") for one in own]
    found = compare(OBJECTIVE, recordings, QUICK)
    assert found.improvement == pytest.approx(0.2, abs=0.002)
    low, high = found.improvement_ci95
    assert low < 0.2 < high


def test_speeds_are_those_of_the_same_means():
    blocks = [off_speed(one, 0) for one in known_head_to_head(8.0, 10.0)]
    fast = blocks[0].channels["base_velocity"]
    blocks[0] = blocks[0].replace(
        channels={**blocks[0].channels, "base_velocity": Series(fast.channel, np.array(fast.values) * 1.05)}
    )
    blocks[3] = off_speed(blocks[3], 20)
    found = compare(OBJECTIVE, blocks, QUICK)
    assert found.mean_speed == pytest.approx(0.8 * (1.05 + 1.0) / 2)
    assert found.reference_mean_speed == pytest.approx(0.8)


def test_without_two_sessions_of_both_every_block_counts():
    """Each policy on a day of its own: nothing is common, and nothing is left out."""
    blocks = [one.replace(session=one.role) for one in known_head_to_head(8.0, 10.0)]
    policy, reference = (cut([one for one in blocks if one.role == role]) for role in ("policy", "reference"))
    balance = Balance.of(policy, reference)
    assert balance.sessions == () and [len(role[0]) for role in (balance.policy, balance.reference)] == [2, 2]


def test_seconds_of_a_session_that_counts_for_nothing_are_none_of_those_that_a_figure_needs():
    """On two days the policy keeps one second a block, and on two others the reference none."""
    recordings = []
    for day in range(4):
        for one in known_head_to_head(8.0, 10.0, seed=day):
            lost = {("policy", True): 37, ("reference", False): 40}.get((one.role, day < 2), 0)
            recordings.append(off_speed(one, lost).replace(session=f"day {day}"))
    with pytest.raises(TooFewSegments, match=r"^Head-to-head at 0\.8 m/s: 4 of 304 segments of the policy are valid "):
        compare(OBJECTIVE, recordings, QUICK)


def test_the_mean_of_blocks_by_hand():
    table = np.array([[1.0], [3.0], [10.0]])
    assert mean_of_blocks(table, np.array([4, 4, 7])) == pytest.approx([6.0])
