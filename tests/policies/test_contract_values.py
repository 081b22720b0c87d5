"""Numbers of a contract that cannot be the robot's, maps that leave joints out, and a delay that nobody says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from hts.contracts import RobotSpec
from hts.errors import PolicyError
from hts.policies.contract import Contract, ask, per_joint
from hts.policies.contract_checks import check_values
from hts.policies.layout import load_layout

FILE = Path("walk.pt")
NAMES = ("F_haa", "F_hfe", "F_kfe", "H_haa", "H_hfe", "H_kfe")
SPEC = RobotSpec(
    name="dog",
    joint_names=NAMES,
    default_pose=(0.0, 0.8, -1.6) * 2,
    kp=(25.0,) * 6,
    kd=(0.5,) * 6,
    action_scale=(0.25,) * 6,
    torque_limit=(40.0,) * 6,
    velocity_limit=(20.0,) * 6,
    position_limit=((-0.8, 0.8), (-1.0, 2.5), (-2.6, -0.5)) * 2,
    control_rate_hz=50.0,
    physics_dt=0.005,
    substeps=4,
    base_height=0.3,
)

WRONG = {
    "degrees": (
        {"default_pose": (0, 46, -92) * 2},
        r"default_pose .stated by L.yaml. of joint 'F_hfe' is 46 rad, .*-1 to 2.5 rad of.*, and 3 more; in degrees",
    ),
    "bent": (
        {"default_pose": (0, 0.8, -3) * 2},
        r"'F_kfe' is -3 rad, outside its range -2.6 to -0.5 [^;]*, and 1 more\.",
    ),
    "scale": ({"action_scale": 25.0}, r"'F_haa' is 25 rad per action unit, more than its whole range of 1.6 rad"),
    "backwards": ({"action_scale": -0.25}, r"action_scale .*is -0.25 rad per action unit, expected a number above 0"),
    "nothing": ({"action_scale": 0.0}, r"action_scale .*is 0 rad per action unit, expected a number above 0"),
    "loose": ({"kp": 0.0}, r"kp .*is 0 N\*m/rad, expected a number above 0"),
    "stiff": (
        {"kp": 2000.0},
        r"kp .*is 2000 N\*m/rad, expected up to 1200, 30 1/rad times its torque limit of 40 N\*m",
    ),
    "damped": (
        {"kd": {".*_haa": 300.0, ".*e": 0.5}},
        r"kd .*'F_haa' is 300 N\*m\*s/rad, expected up to 200.*, and 1 more",
    ),
    "both": ({"kp": 2000.0, "action_scale": 25.0}, r"action_scale .*kp .*is 2000"),
}


@pytest.mark.parametrize(("said", "words"), WRONG.values(), ids=WRONG)
def test_what_cannot_be_the_robots_is_refused_in_one_line(said, words):
    with pytest.raises(PolicyError, match=words) as caught:
        check_values(FILE, Contract(**said, said_by=dict.fromkeys(said, "L.yaml")), SPEC)
    assert "\n" not in str(caught.value) and str(caught.value).startswith("walk.pt: ")


BEARABLE = {  # kp, kd, torque limit
    "go1": (30.0, 0.6, 23.7),
    "a soft leg": (10.0, 0.2, 40.0),
    "a stiff leg": (500.0, 40.0, 45.0),
    "as stiff as may be": (1400.0, 66.0, 126.0),
}


@pytest.mark.parametrize(("kp", "kd", "torque"), BEARABLE.values(), ids=BEARABLE)
def test_gains_that_a_leg_may_have_are_taken(kp, kd, torque):
    check_values(FILE, Contract(kp=kp, kd=kd, action_scale=0.5), replace(SPEC, torque_limit=(torque,) * 6))


def test_the_robots_own_numbers_are_never_refused():
    odd = replace(SPEC, kp=(0.0,) * 6, kd=(900.0,) * 6, action_scale=(12.5,) * 6, default_pose=(0.0,) * 6)
    check_values(FILE, Contract().of_robot(odd), odd)
    with pytest.raises(PolicyError, match="kp of joint 'F_haa' is 0"):
        check_values(FILE, Contract(kp=0.0), SPEC)


def test_a_map_may_leave_joints_to_the_robot(tmp_path):
    file = tmp_path / "L.yaml"
    file.write_text("default_pose: {.*_haa: 0.1, H_kfe: -1.5}\nkp: 20\nrest: robot\n")
    contract = load_layout(file, SPEC).contract
    assert per_joint(FILE, "default_pose", contract.default_pose, NAMES) == (0.1, 0.8, -1.6, 0.1, 0.8, -1.5)
    assert (contract.said_by["default_pose"], contract.said_by["kp"]) == ("L.yaml and the robot", "L.yaml")
    file.write_text("default_pose: {.*_haa: 0.1, H_kfe: -1.5}\n")
    contract = load_layout(file, SPEC).contract
    with pytest.raises(PolicyError, match=r"gives joint 'F_hfe' no number\. .*, or `rest: robot` there"):
        per_joint(FILE, "default_pose", contract.default_pose, NAMES)


@pytest.mark.parametrize("rest", ["", "rest: robot\n"])
@pytest.mark.parametrize(
    "line",
    ["default_pose: {.*_haa: 0.1, .*_hef: 0.8, .*_kfe: -1.6}", "kp: {F_haa: 20, .*_hfe: 30, .*_kfe: 30, H_haaa: 5}"],
)
def test_a_name_that_means_no_joint_is_refused(tmp_path, line, rest):
    file = tmp_path / "L.yaml"
    file.write_text(f"{line}\n{rest}")
    with pytest.raises(PolicyError, match=r"L.yaml: (default_pose|kp): no joint is meant by '(\.\*_hef|H_haaa)'"):
        load_layout(file, SPEC)


def test_a_delay_that_nobody_says_is_asked_for_without_rest():
    whole = Contract().of_robot(SPEC)
    with pytest.raises(
        PolicyError, match=r"`rest: robot` does not say it: a delay is of the policy's training"
    ) as caught:
        ask(FILE, whole)
    assert "leaves out" not in str(caught.value)
    with pytest.raises(PolicyError, match=r"is the robot's own, but for delay_seconds: the robot has none to take\."):
        ask(FILE, Contract())
    with pytest.raises(PolicyError, match=r"is the robot's own\.$"):
        ask(FILE, Contract(delay_seconds=(0.0, 0.0)))
