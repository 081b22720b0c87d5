"""Both engines, one robot: from the same states and inputs the same motion, under the same policy the same walk.

The small form of `benchmarks/parity.py`, which a GPU runs with 64 worlds for 20 s; here on Warp's CPU device.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

pytest.importorskip("hts_go1", reason="the robot of this test is not installed")
# A cold cache of compiled kernels costs about a minute, a warm one a few seconds.
pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(1800),
    # Asked without importing it, which takes seconds also for who collects these tests and runs others.
    pytest.mark.skipif(importlib.util.find_spec("mujoco_warp") is None, reason="the extra `gpu` is not installed"),
]

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "parity.py"


@pytest.fixture(scope="module")
def parity():
    spec = importlib.util.spec_from_file_location("parity", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPT.parent))  # its neighbours can be imported as when it is run
        spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def robot():
    from hts.plugins import load

    return load().make_robot("go1")


@pytest.fixture(scope="module")
def policy(robot):
    from hts.policies.files import load_policy

    return load_policy(robot.pretrained_policy(), robot.spec)


def test_from_a_walk_both_engines_move_alike_for_fifty_control_steps(parity, robot, policy):
    """Open loop: 50 steps are two to three strides, so every foot lands and lifts off; errors in rad and m."""
    errors = parity.same_inputs(robot, policy, "cpu", worlds=4)
    # Single precision gives some 1e-6; a wrong variant, delay or solver setting gives 1e-2 within a few steps.
    assert max(errors["joint_rad"]["largest"]) < 2e-4
    assert max(errors["position_m"]["largest"]) < 2e-4
    assert max(errors["joint_rad"]["largest"]) > 0.0  # they are two engines


def test_the_same_policy_walks_alike_in_both_engines(parity, robot, policy):
    """Three worlds, one per speed, for 3 s: one second to judge, so without luck only because the motions agree."""
    found = {engine: parity.walk(robot, policy, engine, "cpu", worlds=3, seconds=3.0) for engine in ("mujoco", "warp")}
    difference = parity.differences(found["mujoco"], found["warp"])
    assert all(abs(difference[name]) < 0.03 for name in ("reward", "speed", "power")), found
    assert found["mujoco"]["falls"] == found["warp"]["falls"] == 0.0
    assert 0.7 < found["mujoco"]["speed"] < 0.9  # the mean of 0.5, 0.8 and 1.1 m/s: it did walk


def test_the_verdict_fails_where_any_one_difference_is_too_large(parity):
    fine = {"reward": 0.0, "speed": -0.029, "power": 0.029, "falls_points": -1.0}
    still = {name: {"median": [0.0, 0.0]} for name in ("joint_rad", "position_m")}
    assert parity.verdict(fine, still)
    assert not parity.verdict({**fine, "power": 0.031}, still)
    assert not parity.verdict({**fine, "falls_points": 1.6}, still)
    assert not parity.verdict(fine, {**still, "joint_rad": {"median": [0.0, 1.0]}})


def test_differences_are_relative_and_falls_are_points(parity):
    one = {"reward": 2.0, "speed": 0.8, "power": 40.0, "falls": 0.0}
    other = {"reward": 2.1, "speed": 0.8, "power": 38.0, "falls": 1 / 64}
    assert parity.differences(one, other) == pytest.approx(
        {"reward": 0.05, "speed": 0.0, "power": -0.05, "falls_points": 1.5625}
    )
