"""Models that are not what their spec says: `hts check` and the velocity env say so, a line for each kind of fault."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import pytest
from legged_model import FLOOR, ISAAC, JOINTS, LEGS, dog, text

from hts.cli.policy_trial import trial_lines
from hts.config import EnvConfig
from hts.errors import ConfigError, PluginError
from hts.factories import made_by
from hts.plugins import Entry, load
from hts.testing.checks import robots
from hts.testing.checks.ensure import NotTried
from hts.testing.conformance import _in_turn

MODEL = text()
SOUND = dog(MODEL)
SERVO = ' kp="25" kv="0.5"'


@cache  # two tests look at what was said of the same robot
def not_kept(robot) -> list[tuple[str, Exception]]:
    """The names of the checks of robots that are not kept or could not be made, each with what it says."""
    entry, registry, said = Entry("dog", lambda settings: robot, "lab"), load(()), []
    for check in robots.CHECKS:
        try:
            check(entry, registry)
        except Exception as error:  # noqa: BLE001 - as `hts check` takes it
            said.append((check.__name__, error))
    return said


def faults(robot) -> list[str]:
    """What each check of robots says."""
    return [f"{type(error).__name__}: {error}" for _, error in not_kept(robot) if not isinstance(error, NotTried)]


def untried(robot) -> set[str]:
    """The checks that could not be made."""
    return {name for name, error in not_kept(robot) if isinstance(error, NotTried)}


def env_of(robot):
    return robot.make_env("mujoco", 1, 1, EnvConfig(threads=1), seeds=[0])


def test_a_sound_model_passes_and_its_env_is_made():
    assert faults(SOUND) == []
    env_of(SOUND).close()


def test_a_model_is_made_once_for_all_that_is_compared_with_the_spec():
    robot, made = dog(MODEL), []
    model = robot.mjcf()

    def mjcf(self):
        made.append("once")
        return model

    type(robot).mjcf = mjcf
    entry, registry = Entry("dog", lambda settings: robot, "lab"), load(())
    robots.ROBOT_MODEL_CHECKS[0](entry, registry)
    before = len(made)
    for check in robots.ROBOT_MODEL_CHECKS[1:]:
        check(entry, registry)
    assert len(made) == before > 0


def test_a_light_robot_of_few_physics_steps_is_as_sound():
    """Loads and delays that vary by default are those of a robot of some 10 kg at 50 Hz, which this one is not."""
    light = dog(MODEL.replace('mass="8"', 'mass="0.8"'))
    light.spec = replace(light.spec, control_rate_hz=100.0, substeps=2)
    assert faults(light) == []
    (line,) = trial_lines(light, None)  # `hts policy import` has no setting for it, and has written its file by then
    assert re.fullmatch(r"not tried in our simulation: .*added_mass .*: -1 kg .* 0.8 kg. Raise the lower end.", line)


WRONG = {
    "motors": (
        MODEL.replace("<position", "<motor").replace(SERVO, ""),
        r"actuators of its model: joint 'LF_HAA', .*'RH_KFE': motor, expected position",
    ),
    "speed servo": (
        MODEL.replace('<position name="RF_HFE" joint="RF_HFE" kp="25"', '<velocity name="RF_HFE" joint="RF_HFE"'),
        r"actuators of its model: joint 'RF_HFE': velocity, expected position",
    ),
    "gear": (MODEL.replace('kp="25"', 'kp="25" gear="3"', 1), r"gear of .*: joint 'LF_HAA': 3, expected 1"),
    "kp": (MODEL.replace('kp="25"', 'kp="100"', 2), r"gains .*joint 'LF_HAA', 'LF_HFE': kp 100, expected kp 25\. "),
    "kd": (MODEL.replace(' kv="0.5"', "", 1), r"gains .*joint 'LF_HAA': kd 0, expected kd 0.5\. kd is kv of"),
    "no limit": (MODEL.replace(' forcerange="-40 40"', "", 1), r"forcerange .*'LF_HAA': none, expected -40 to 40"),
    "more": (MODEL.replace("-40 40", "-120 120", 1), r"forcerange .*'LF_HAA': -120 to 120, expected -40 to 40"),
    "clipped targets": (
        MODEL.replace('joint="LF_HAA" kp', 'joint="LF_HAA" ctrlrange="-0.8 0.8" kp'),
        r"ctrlrange .*, rad: joint 'LF_HAA': -0.8 to 0.8, expected none, or at least -2.4 to 2.4\. .*ctrllimited=",
    ),
    "clipped on one side": (
        MODEL.replace('joint="RH_KFE" kp', 'joint="RH_KFE" ctrlrange="-4.2 0" kp'),
        r"ctrlrange .*: joint 'RH_KFE': -4.2 to 0, expected none, or at least -4.2 to 1.1\. ",
    ),
    "range": (MODEL.replace("-0.8 0.8", "-20 20", 1), r"range .*rad: joint 'LF_HAA': -20 to 20, expected -0.8 to 0.8"),
    "endless": (MODEL.replace(' range="-0.8 0.8"', "", 1), r"range .*'LF_HAA': none, expected -0.8 to 0.8"),
    "slippery": (
        MODEL.replace(' priority="1"', ""),
        r"geom 'floor' of its model has priority 0, geom 'trunk' .*has 0\.",
    ),
    "blind feet": (text(site=0.005), r"site 'LF_foot', .*'RH_foot': 5 mm, expected one that reaches 15 mm further"),
    "no contact": (
        MODEL.replace('name="RH_foot" type="sphere"', 'name="RH_foot" type="sphere" contype="0" conaffinity="0"'),
        r"site 'RH_foot': no geom of body 'RH_shank' touches the floor",
    ),
}


@pytest.mark.parametrize(("model", "words"), WRONG.values(), ids=WRONG)
def test_what_the_simulation_has_otherwise_is_said_in_one_line(model, words):
    (line,) = faults(dog(model))
    assert re.search(words, line) and line.startswith("PluginError: ") and "\n" not in line


def test_everything_that_is_wrong_is_said_at_once():
    model = text(ISAAC, ISAAC, site=0.005).replace('kp="25"', 'kp="100"', 1).replace("-40 40", "-120 120", 2)
    found = faults(dog(model.replace("-0.8 0.8", "-20 20", 1).replace(' priority="1"', ""), ISAAC))
    words = ("in the tree", "'LF_HAA': kp 100", "'LF_HAA', 'RF_HAA': -120", "-20 to 20", "priority 0", "15 mm")
    assert len(found) == len(words)
    for line, word in zip(found, words, strict=True):
        assert word in line


def test_a_rounded_number_is_no_other_one():
    model = (
        MODEL.replace('kp="25"', 'kp="25.01"').replace("-0.8 0.8", "-0.8009 0.8009").replace("-40 40", "-40.01 40.01")
    )
    assert faults(dog(model)) == []


def test_a_range_of_targets_passes_from_where_on_no_torque_changes():
    """By hand: the torque is at its 40 N m from 40 / 25 = 1.6 rad off on, so -0.8 - 1.6 to 0.8 + 1.6 rad."""
    wide = MODEL.replace('joint="LF_HAA" kp', 'joint="LF_HAA" ctrlrange="-2.4 2.4" kp')
    unused = MODEL.replace('joint="LF_HAA" kp', 'joint="LF_HAA" ctrlrange="-0.8 0.8" ctrllimited="false" kp')
    off = MODEL.replace('joint="LF_HAA" kp', 'joint="LF_HAA" ctrlrange="-0.8 0.8" kp').replace(
        '<option integrator="implicitfast"/>', '<option integrator="implicitfast"><flag clampctrl="disable"/></option>'
    )
    for model in (wide, unused, off):
        assert faults(dog(model)) == []


def other(**changes):
    """The dog with other numbers in its spec."""
    robot = dog(MODEL)
    type(robot).spec = replace(robot.spec, **changes)
    return robot


@pytest.mark.parametrize("height", [30.0, 0.2, 0.4, 300.0])
def test_a_height_at_which_the_feet_are_not_on_the_floor_is_said(height):
    """By hand: 2 * 0.2 m * cos 0.8 + 0.02 m = 0.2987 m from the hips to the floor."""
    (line,) = faults(other(base_height=height))
    assert f"spec.base_height is {height:g} m" in line and "at 0.2987 m" in line and "\n" not in line


@pytest.mark.parametrize("height", [0.28, 0.31])
def test_a_height_measured_under_load_or_rounded_is_no_other_one(height):
    assert faults(other(base_height=height)) == []


SPECS = {
    "one number for all joints": ({"kp": 25.0}, "spec.kp is 25.0, expected 12 entries, one a joint"),
    "one number too few": ({"kd": (0.5,) * 11}, "spec.kd has 11 entries for 12 joints"),
    "a range that is one number": ({"position_limit": (0.8,) * 12}, "spec.position_limit of 'LF_HAA' is 0.8, expected"),
    "text": ({"torque_limit": ("40 N*m",) * 12}, "spec.torque_limit of 'LF_HAA' is '40 N*m', expected a number, N·m"),
    "a torque limit of nothing": (
        {"torque_limit": (40.0,) * 11 + (0.0,)},
        "spec.torque_limit of 'RH_KFE' is 0, expected a number above 0",
    ),
    "a speed limit below 0": (
        {"velocity_limit": (-20.0,) * 12},
        "spec.velocity_limit of 'LF_HAA' is -20, expected a number above 0",
    ),
    "an action scale below 0": (
        {"action_scale": (0.25,) * 11 + (-0.25,)},
        "spec.action_scale of 'RH_KFE' is -0.25, expected a number above 0",
    ),
    "a stiffness below 0": ({"kp": (-25.0,) * 12}, "spec.kp of 'LF_HAA' is -25, expected a number of at least 0"),
    "a damping below 0": ({"kd": (-0.5,) * 12}, "spec.kd of 'LF_HAA' is -0.5, expected a number of at least 0"),
    "a damping without end": ({"kd": (float("inf"),) * 12}, "spec.kd of 'LF_HAA' is inf, expected a number, N·m·s/rad"),
    "degrees": (
        {"default_pose": (0.0, 45.0, -90.0) * 4},
        "spec.default_pose of 'LF_HFE' is 45, expected at most 10 rad (write rad, not degrees)",
    ),
    "a step that does not fit": ({"control_rate_hz": 40.0}, "4 · 0.005 s at 40.0 Hz"),
}


@pytest.mark.parametrize(("changes", "words"), SPECS.values(), ids=SPECS)
def test_a_spec_that_does_not_fit_its_joints_is_one_line_of_the_check_and_of_every_command(changes, words):
    robot = other(**changes)
    (line,) = faults(robot)
    assert words in line and line.startswith("PluginError: ")
    with pytest.raises(PluginError, match=re.escape(words)) as caught:
        made_by(lambda settings: robot, "robots", "robot 'dog'", "dog", "lab", {})
    assert "Robot 'dog' (from lab): " in str(caught.value) and "\n" not in str(caught.value)


def test_a_standing_height_in_mm_is_one_line_of_every_command():
    robot = other(base_height=299.0)
    with pytest.raises(PluginError, match=r"base_height is 299, expected at most 5 m \(write m, not mm\)"):
        made_by(lambda settings: robot, "robots", "robot 'dog'", "dog", "lab", {})


def test_a_model_whose_file_is_not_there_is_said_once_and_the_env_says_it_in_one_line():
    robot = dog(MODEL)

    def mjcf(self):
        raise FileNotFoundError(2, "No such file or directory", "dog.xml")

    type(robot).mjcf = mjcf
    (line,) = faults(robot)
    assert "dog.xml" in line
    assert untried(robot) == ENV | OF_THE_MODEL
    with pytest.raises(PluginError, match=r"Robot 'dog': mjcf\(\) failed, FileNotFoundError: .*'dog.xml'"):
        env_of(robot)


def test_a_sensor_of_the_joint_itself_measures_the_same():
    own = '<jointactuatorfrc name="torque_LF_HAA" joint="LF_HAA"/>'
    model = MODEL.replace('<actuatorfrc name="torque_LF_HAA" actuator="LF_HAA"/>', own)
    assert own in model and faults(dog(model)) == []
    model = MODEL.replace('objtype="site" objname="LF_foot"', 'objtype="xbody" objname="LF_shank"')
    assert model != MODEL and faults(dog(model)) == []


OTHER = dict(zip(JOINTS, ISAAC, strict=True))
ORDERS = {
    "tree": (
        dog(text(ISAAC, ISAAC), ISAAC),
        r"joint 'LF_HFE' is number 2 in the tree .*'RF_HAA' is expected there: found LF_HAA, LF.*; expected LF_HAA, R",
    ),
    "actuators": (dog(text(actuators=ISAAC)), r"actuator of joint 'RF_HAA' is number 2 .*'LF_HFE' is expected there"),
    "torques": (dog(text(sensors=ISAAC)), r"sensor 'torque_RF_HAA' is number 2 .*'torque_LF_HFE' is expected there"),
    "feet": (dog(text(touch=LEGS[::-1])), r"sensor 'touch_RH' is number 1 .*'touch_LF' is expected there"),
    "apart": (
        dog(MODEL.replace('<touch name="touch_RH"', '<gyro name="imu" site="trunk_shell"/><touch name="touch_RH"')),
        r"sensor 'imu' of its model stands between the sensors touch_",
    ),
    "torque of another joint": (
        dog(MODEL.replace('"torque_LF_HAA" actuator="LF_HAA"', '"torque_LF_HAA" actuator="RF_HAA"')),
        r"'torque_LF_HAA' measures actuator force of joint 'RF_HAA', expected actuator force of joint 'LF_HAA'\. ",
    ),
    "all torques in another order": (
        dog(
            re.sub('"(torque_.._...)" actuator="(.._...)"', lambda one: f'"{one[1]}" actuator="{OTHER[one[2]]}"', MODEL)
        ),
        r"'torque_LF_HFE' measures .* 'RF_HAA', .*; 'torque_LF_KFE' measures .* 'LH_HAA', ",
    ),
    "torque of nothing driven": (
        dog(MODEL.replace('<actuatorfrc name="torque_LF_HAA" actuator', '<jointpos name="torque_LF_HAA" joint')),
        r"'torque_LF_HAA' measures jointpos, expected actuator force of joint 'LF_HAA'\. ",
    ),
    "touch of another foot": (
        dog(MODEL.replace('"touch_LF" site="LF_foot"', '"touch_LF" site="RF_foot"')),
        r"'touch_LF' measures touch at site 'RF_foot', expected touch at site 'LF_foot'\. ",
    ),
    "speed of another foot": (
        dog(
            MODEL.replace(
                '"foot_velocity_RH" objtype="site" objname="RH', '"foot_velocity_RH" objtype="site" objname="LH'
            )
        ),
        r"'foot_velocity_RH' measures velocity of body 'LH_shank', expected velocity of body 'RH_shank'\. ",
    ),
    "speed in the axes of the foot": (
        dog(
            MODEL.replace(
                'framelinvel name="foot_velocity_LF" objtype="site" objname=',
                'velocimeter name="foot_velocity_LF" site=',
            )
        ),
        r"'foot_velocity_LF' measures velocity in its own axes of body 'LF_shank', expected velocity of body 'LF_s",
    ),
    "speed against the trunk": (
        dog(MODEL.replace('objname="RH_foot"', 'objname="RH_foot" reftype="body" refname="trunk"')),
        r"'foot_velocity_RH' measures velocity against body 'trunk' of body 'RH_shank', expected velocity of body 'RH",
    ),
    "fixed": (
        dog(MODEL.replace('<freejoint name="root"/>', "")),
        r"first joint .*'LF_HAA' of body 'LF_hip', expected a",
    ),
}


@pytest.mark.parametrize(("robot", "words"), ORDERS.values(), ids=ORDERS)
def test_another_order_is_refused_by_check_and_env_alike(robot, words):
    (line,) = faults(robot)
    assert re.search(words, line) and "\n" not in line
    with pytest.raises(ConfigError, match=words) as caught:
        env_of(robot)
    assert "\n" not in str(caught.value)


def test_a_joint_too_many_is_named():
    spring = '<body name="spring"><joint name="soft"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
    (line,) = faults(dog(MODEL.replace("</body></worldbody>", spring + "</body></worldbody>")))
    assert "joint 'soft' is number 13 in the tree of its model, none is expected there" in line


MISSING = {
    "floor": (dog(MODEL.replace(FLOOR, "")), r"its model has no geom 'floor'\. "),
    "sensors": (
        dog(re.sub("<sensor>.*</sensor>", "", MODEL)),
        r"no sensor 'torque_LF_HAA', .*'touch_LF', .*'foot_velocity_RH', 'trunk_touch'\. ",
    ),
    "actuator": (
        dog(re.sub('<(position|actuatorfrc) name="(torque_)?RH_KFE"[^>]*>', "", MODEL)),
        r"its model has no sensor 'torque_RH_KFE', no actuator of joint 'RH_KFE'\. ",
    ),
    "several": (
        dog(MODEL.replace(FLOOR, "").replace("trunk_touch", "touch_trunk").replace('"trunk"', '"base"')),
        r"its model has no body 'trunk', no geom 'floor', no sensor 'trunk_touch'\. ",
    ),
}


@pytest.mark.parametrize(("robot", "words"), MISSING.values(), ids=MISSING)
def test_all_that_is_missing_is_said_in_one_line_once(robot, words):
    (line,) = faults(robot)
    assert re.search(words, line) and "docs/authors/robot.md" in line and "\n" not in line
    with pytest.raises(ConfigError, match=words):
        env_of(robot)


ENV = {
    "env_gives_what_was_asked",
    "env_keeps_the_physics_steps_it_promises",
    "env_does_not_depend_on_neighbours",
}
OF_THE_MODEL = {check.__name__ for check in robots.ROBOT_MODEL_CHECKS}


@pytest.mark.parametrize("robot", [robot for robot, _ in ORDERS.values()], ids=ORDERS)
def test_of_a_model_that_is_refused_for_its_order_no_check_of_its_env_passes(robot):
    """They cannot be made, and must not count as kept."""
    assert untried(robot) - {"feet_are_felt", "height_matches"} == ENV


@pytest.mark.parametrize("robot", [robot for robot, _ in MISSING.values()], ids=MISSING)
def test_of_a_model_that_lacks_something_no_check_of_model_or_env_passes(robot):
    assert untried(robot) == ENV | OF_THE_MODEL


def test_gains_of_actuators_that_are_no_servos_are_not_compared_and_not_kept():
    assert untried(dog(WRONG["motors"][0])) == {"gains_match"}
    assert untried(SOUND) == set()


def test_what_was_not_tried_is_a_finding_that_waits():
    entry = Entry("dog", lambda settings: dog(MODEL.replace(FLOOR, "")), "lab")
    found = list(_in_turn("lab", "robot 'dog'", robots.CHECKS, entry, load(())))
    assert sum(one.fault is not None for one in found) == 1  # the floor
    waiting = [one.demand for one in found if not one.tried]
    assert len(waiting) == len(ENV | OF_THE_MODEL)
    assert any(demand.startswith("Its env has batch size [P, N]") for demand in waiting)


def test_a_robot_with_an_env_of_its_own_needs_only_what_a_twin_looks_for():
    from hts.contracts import Robot

    model = re.sub("<sensor>.*</sensor>", "", text(ISAAC, ISAAC)).replace(FLOOR, "").replace("<position", "<motor")
    sound = dog(model.replace(SERVO, ""), ISAAC)

    class Own(Robot):
        spec, mjcf, channels = sound.spec, sound.mjcf, sound.channels
        pretrained_policy = sound.pretrained_policy

    said = faults(Own())
    assert len(said) == 2 and all("has no env to train in" in line for line in said)


def test_a_robot_of_the_velocity_task_without_a_model_is_refused_and_nothing_of_its_env_counts_as_kept():
    robot = dog(MODEL)
    type(robot).mjcf = lambda self: None
    (line,) = faults(robot)
    assert "mjcf() gives None, so there is nothing to train in" in line and "LogOnlyRobot" in line
    assert untried(robot) == ENV | OF_THE_MODEL


def test_a_log_only_robot_passes_without_a_model():
    from hts.contracts import LogOnlyRobot

    sound = dog(MODEL)
    assert faults(LogOnlyRobot(sound.spec, sound.channels().values())) == []
