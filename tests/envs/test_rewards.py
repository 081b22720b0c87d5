"""Each reward term against arithmetic on paper."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch

from hts.envs import rewards
from hts.errors import ConfigError


def still(**changes) -> rewards.RewardInputs:
    """One world that stands still on four feet, commanded to; with changes."""
    zeros = torch.zeros
    inputs = rewards.RewardInputs(
        velocity=zeros(1, 1, 3),
        angular_velocity=zeros(1, 1, 3),
        gravity=torch.tensor([[[0.0, 0.0, -1.0]]]),
        command=zeros(1, 1, 3),
        torque=zeros(1, 1, 2),
        joint_velocity=zeros(1, 1, 2),
        last_joint_velocity=zeros(1, 1, 2),
        pose_error=zeros(1, 1, 2),
        action=zeros(1, 1, 2),
        last_action=zeros(1, 1, 2),
        air_time=zeros(1, 1, 4),
        landed=zeros(1, 1, 4, dtype=torch.bool),
        contact=torch.ones(1, 1, 4, dtype=torch.bool),
        foot_speed_squared=zeros(1, 1, 4),
        fell=zeros(1, 1, dtype=torch.bool),
        dt=0.02,
        tracking_sigma=0.05,
    )
    made = {name: torch.tensor([[value]]) for name, value in changes.items()}
    return dataclasses.replace(inputs, **made)


def term(name: str, **changes) -> float:
    return only(name, still(**changes))


def only(name: str, inputs: rewards.RewardInputs) -> float:
    """One term by itself, as a rate per second: the total with that weight 1 and no other."""
    return float(rewards.total(inputs, {name: 1.0})) / inputs.dt


def test_standing_still_when_commanded_to_earns_both_tracking_terms_and_nothing_else():
    # (2.0 + 0.75) x 0.02 s
    assert float(rewards.total(still(), rewards.DEFAULT_WEIGHTS)) == pytest.approx(0.055)


def test_joints_cost_what_they_are_beyond_the_middle_share_of_their_range():
    # Ranges of 2 rad about 0.5 and -0.5: soft limits at -0.4 and 1.4, and at -1.4 and 0.4; the pose is at 0.4 and 0.
    limits = rewards.soft_range([(-0.5, 1.5), (-1.5, 0.5)], (0.4, 0.0), 0.9, torch.device("cpu"))
    assert [end.tolist() for end in limits] == [pytest.approx([-0.8, -1.4]), pytest.approx([1.0, 0.4])]
    seen = dataclasses.replace(still(pose_error=[1.2, -1.5]), pose_range=limits)
    assert only("joint_range", seen) == pytest.approx(0.2 + 0.1)
    assert float(rewards.total(seen, {"joint_range": -10.0})) == pytest.approx(-10 * 0.3 * 0.02)
    half = rewards.soft_range([(-0.5, 1.5), (-1.5, 0.5)], (0.4, 0.0), 0.5, torch.device("cpu"))
    assert [end.tolist() for end in half] == [pytest.approx([-0.4, -1.0]), pytest.approx([0.6, 0.0])]
    inside = dataclasses.replace(still(pose_error=[0.9, 0.3]), pose_range=limits)
    assert only("joint_range", inside) == 0.0


def test_joints_without_limits_are_never_beyond_them():
    limits = rewards.soft_range([(-math.inf, math.inf), (0.0, 0.0)], (0.0, 0.0), 0.9, torch.device("cpu"))
    seen = dataclasses.replace(still(pose_error=[9.0, -9.0]), pose_range=limits)
    assert only("joint_range", seen) == 0.0
    assert term("joint_range", pose_error=[9.0, -9.0]) == 0.0


def test_tracking_pays_by_the_square_of_the_error():
    # An error of (0.3, 0.4) m/s is 0.5 m/s: exp(-0.25 / 0.05).
    assert term("track_velocity", command=[0.8, 0.4, 0.0], velocity=[0.5, 0.0, 9.0]) == pytest.approx(math.exp(-5))
    assert term("track_yaw_rate", command=[0.0, 0.0, 0.5], angular_velocity=[9.0, 9.0, 0.3]) == pytest.approx(
        math.exp(-0.8)
    )


def test_at_half_a_metre_per_second_the_papers_tolerance_costs_five_per_cent():
    assert 1 - term("track_velocity", command=[0.5, 0.0, 0.0], velocity=[0.45, 0.0, 0.0]) == pytest.approx(
        0.05, abs=0.002
    )


@pytest.mark.parametrize(
    ("name", "changes", "value"),
    [
        ("vertical_velocity", {"velocity": [1.0, 1.0, 0.3]}, 0.09),
        ("roll_pitch_rate", {"angular_velocity": [1.0, 2.0, 7.0]}, 5.0),
        ("orientation", {"gravity": [0.6, 0.0, -0.8]}, 0.36),
        ("torque", {"torque": [3.0, -4.0]}, 25.0),
        (
            "joint_acceleration",
            {"joint_velocity": [0.1, 0.0], "last_joint_velocity": [0.0, -0.1]},
            2 * (0.1 / 0.02) ** 2,
        ),
        ("action_rate", {"action": [1.0, 0.0], "last_action": [0.5, 0.5]}, 0.5),
        ("pose", {"pose_error": [0.1, -0.2]}, 0.05),
        ("stand_still", {"pose_error": [0.1, -0.2]}, 0.3),
    ],
)
def test_each_penalty_is_the_formula_of_its_docstring(name, changes, value):
    assert term(name, **changes) == pytest.approx(value)


def test_a_landing_pays_for_its_flight_above_a_tenth_of_a_second_and_only_up_to_a_limit():
    walking = {"command": [0.5, 0.0, 0.0]}
    # Landed: feet 0 (0.3 s -> 0.2) and 1 (0.05 s -> -0.05) and 2 (1 s -> 0.25, the limit); foot 3 still flies.
    air = {"air_time": [0.3, 0.05, 1.0, 0.9], "landed": [True, True, True, False]}
    assert term("air_time", **air, **walking) == pytest.approx(0.2 - 0.05 + 0.25)
    assert term("air_time", **air) == 0.0  # commanded to stand


def test_only_feet_on_the_floor_can_slip():
    slip = term("slip", foot_speed_squared=[0.04, 1.0, 0.0, 0.01], contact=[True, False, True, True])
    assert slip == pytest.approx(0.05)


def test_standing_still_is_asked_only_of_those_commanded_to_stand():
    bent = {"pose_error": [0.5, 0.5]}
    for command in ([0.3, 0.0, 0.0], [-0.3, 0.0, 0.0], [0.0, -0.3, 0.0], [0.0, 0.0, -0.3], [0.11, 0.0, 0.0]):
        assert term("stand_still", **bent, command=command) == 0.0
    assert term("stand_still", **bent, command=[0.09, 0.0, 0.0]) == pytest.approx(1.0)  # below 0.1 m/s is none


def test_falling_costs_one():
    with_fall = rewards.total(still(fell=True), rewards.DEFAULT_WEIGHTS)
    assert float(with_fall - rewards.total(still(), rewards.DEFAULT_WEIGHTS)) == pytest.approx(-1.0)  # -50 x 0.02


def test_of_steps_told_together_those_that_broke_alone_pay_the_price_of_a_fall():
    steps = [still(), dataclasses.replace(still(), broken=torch.tensor([[True]])), still(fell=True)]
    together = rewards.total(rewards.stacked(steps), rewards.DEFAULT_WEIGHTS)
    # (2.0 + 0.75) x 0.02 s; -50 x 0.02 s and nothing else; both.
    assert together.flatten().tolist() == pytest.approx([0.055, -1.0, -0.945])
    assert rewards.stacked([still(), still()]).broken is None


def test_the_total_is_not_clipped_at_zero():
    assert float(rewards.total(still(torque=[100.0, 100.0], velocity=[2.0, 0.0, 2.0]), rewards.DEFAULT_WEIGHTS)) < 0.0


def test_a_weight_can_be_changed_and_a_misspelt_one_is_named():
    weights = rewards.resolve_weights({"torque": -1.0})
    assert weights["torque"] == -1.0 and weights["slip"] == rewards.DEFAULT_WEIGHTS["slip"]
    with pytest.raises(ConfigError, match="No reward term named 'torqe'. Did you mean 'torque'?"):
        rewards.resolve_weights({"torqe": -1.0})


def test_a_number_that_is_not_one_stays_not_one():
    assert math.isnan(float(rewards.total(still(torque=[float("nan"), 0.0]), rewards.DEFAULT_WEIGHTS)))
