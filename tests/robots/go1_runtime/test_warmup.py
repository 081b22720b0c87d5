"""Why a visit warms up once, at its first speed: what another speed's heat adds to a comparison in A-B-B-A."""

from __future__ import annotations

import numpy as np
import pytest

from hts_power.gauge_parameters import GaugeParameters

COPPER = 0.00393  # 1/K
NET = {0.5: 66.0, 0.8: 90.0, 1.1: 120.0}  # W: the anchors of Table I with 30 W idle
SHARE = 0.6  # of net power that is copper loss at 25 degC; warm it is 55 to 80 % (docs/twin.md)
IN_JOINTS = np.tile([0.02, 0.1, 0.13], 4)  # of the copper loss, hip, thigh, calf
BLOCK, TRIMMING, STEP = 80.0, 40.0, 0.5  # s


def worst_bias(speeds, warmup: float) -> float:
    """By how much of net power a policy differs from itself, at the speed where it does most: from 25 degC, `warmup` s
    at the first speed, then trimming and A-B-B-A at each, without a pause."""
    p = GaugeParameters()
    joints = IN_JOINTS / IN_JOINTS.sum()
    winding, housing = np.full((2, 12), 25.0)

    def walk(speed: float, seconds: float) -> float:
        nonlocal winding, housing
        spent = []
        for _ in range(round(seconds / STEP)):
            copper = SHARE * NET[speed] * joints * (1 + COPPER * (winding - 25))
            inward = (winding - housing) / p.winding_resistance
            winding = winding + STEP * (copper - inward) / p.winding_capacity
            housing = housing + STEP * (inward - (housing - 25) / p.housing_resistance) / p.housing_capacity
            spent.append(copper.sum())
        return float(np.mean(spent)) if spent else 0.0

    walk(speeds[0], warmup)
    found = []
    for speed in speeds:
        walk(speed, TRIMMING)
        first, second, third, fourth = (walk(speed, BLOCK) for _ in range(4))
        found.append(abs(first + fourth - second - third) / 2 / NET[speed])
    return max(found)


def test_without_a_warm_up_heat_would_add_up_to_two_tenths_of_a_per_cent():
    assert 0.001 < worst_bias((1.1, 0.8, 0.5), 0.0) < 0.002


@pytest.mark.parametrize("speeds", [(0.5, 0.8, 1.1), (1.1, 0.8, 0.5), (0.5, 1.1)])
def test_later_speeds_of_a_visit_need_no_warm_up_of_their_own(speeds):
    assert worst_bias(speeds, 600.0) < 0.001
