"""Numbers of a robot in other units than are asked for, and models that hold no numbers: said in one line each."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from legged_model import dog, text

from hts.config import EnvConfig
from hts.contracts.spec_faults import fault_of_spec, fault_of_step
from hts.errors import ConfigError, PluginError
from hts.factories import made_by
from hts.plugins import Entry, load
from hts.policies.files import pretrained_file
from hts.sim.models import compile_model
from hts.testing.checks.robot_models import height_matches, weight_is_carried
from hts.testing.checks.robots import env_gives_what_was_asked

MODEL = text()
SPEC = dog(MODEL).spec

WRONG = {
    "a range in degrees": (
        {"position_limit": ((-46.0, 46.0), (-57.0, 143.0), (-149.0, -29.0)) * 4},
        r"spec.default_pose of 'LF_KFE' is -1.6 rad, outside its position_limit -149 to -29 \(position_limit is pro",
    ),
    "a pose beyond its end": (
        {"default_pose": (0.0, 0.8, -2.8) * 4},
        r"spec.default_pose of 'LF_KFE' is -2.8 rad, outside its position_limit -2.6 to -0.5 \(correct one of them",
    ),
    "a scale in degrees": (
        {"action_scale": (14.3,) * 12},
        r"spec.action_scale of 'LF_HAA' is 14.3 rad per action unit, more than its whole range of 1.6 rad",
    ),
    "a speed in degrees": (
        {"velocity_limit": (1146.0,) * 12},
        r"spec.velocity_limit of 'LF_HAA' is 1146, expected at most 100 rad/s \(write rad/s, not degrees",
    ),
}


@pytest.mark.parametrize(("changes", "words"), WRONG.values(), ids=WRONG)
def test_a_number_in_degrees_is_said(changes, words):
    with pytest.raises(AssertionError, match=words):
        assert fault_of_spec(replace(SPEC, **changes)) == ""


def test_wheels_and_rounded_ends_are_no_fault():
    wheels = {"position_limit": ((-math.inf, math.inf),) * 12, "action_scale": (12.5,) * 12}
    assert fault_of_spec(replace(SPEC, **wheels, velocity_limit=(200.0,) * 12)) == ""
    assert fault_of_spec(replace(SPEC, default_pose=(0.8005, 2.5, -0.5) * 4)) == ""


def test_an_env_at_another_rate_than_the_robots_is_said():
    """Measurement models are stepped once a control step, and were fitted at the robot's rate."""
    assert fault_of_step(0.02, SPEC) == ""
    with pytest.raises(AssertionError, match=r"its env has dt = 0.025 s, expected 0.02 s, .* 50 Hz"):
        assert fault_of_step(0.025, SPEC) == ""
    robot = dog(MODEL)
    made = type(robot).make_env

    def faster(self, *given, **more):
        env = made(self, *given, **more)
        env.dt = 0.01
        return env

    type(robot).make_env = faster
    with pytest.raises(PluginError, match=r"dt = 0.01 s, expected 0.02 s"):
        env_gives_what_was_asked(Entry("dog", lambda settings: robot, "lab"), load(()))


def carried(model):
    robot = dog(model)
    weight_is_carried(Entry("dog", lambda settings: robot, "lab"), load(()))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('mass="8"', 'mass="8000"', r"its model weighs 8006 kg and stands 0.3 m high, .* together are 480 N·m"),
        ('<option integrator="implicitfast"/>', '<option gravity="0 0 0"/>', "gravity of its model is 0 0 0, expected"),
        ('<option integrator="implicitfast"/>', '<option gravity="0 -9.81 0"/>', "gravity of its model is 0 -9.81 0"),
        (
            '<option integrator="implicitfast"/>',
            '<option><flag gravity="disable"/></option>',
            "gravity of its model is 0 0 0",
        ),
    ],
)
def test_a_robot_in_grams_or_without_gravity_is_said(old, new, words):
    assert old in MODEL
    carried(MODEL)
    with pytest.raises(PluginError, match=words):
        carried(MODEL.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('mass="8"', 'mass="nan"', r"its model has mass=\"nan\" in <geom name=\"trunk\">"),
        ('pos="0 0 0.3"', 'pos="0 NaN 0.3"', r"its model has pos=\"0 nan 0\.[23]\d*\" in <body name=\"trunk\">"),
    ],
)
def test_a_model_with_what_is_no_number_is_named(old, new, words):
    """MuJoCo reads a mass that is NaN as one that was left out, without a word, and computes another."""
    assert old in MODEL
    with pytest.raises(ConfigError, match=words):
        compile_model(dog(MODEL.replace(old, new)))


def test_a_trunk_without_mass_is_said_and_no_load_is_asked_to_be_raised():
    """As of a model whose free joint is on a frame, and whose trunk is a body fixed to that."""
    frame = '<body name="frame" pos="0 0 0.3"><freejoint name="root"/><body name="trunk">'
    model = MODEL.replace('<body name="trunk" pos="0 0 0.3"><freejoint name="root"/>', frame)
    robot = dog(model.replace("</worldbody>", "</body></worldbody>"))
    robot.spec = replace(robot.spec, trunk_body="frame")
    with pytest.raises(ConfigError, match=r"Robot 'dog': body 'frame' of its model has no mass, .*<freejoint/> there"):
        robot.make_env("mujoco", 1, 1, EnvConfig(threads=1), seeds=[0])


@pytest.mark.parametrize(("ref", "said"), [("0.6", True), ("0.1", False)])
def test_a_leg_that_is_bent_otherwise_than_the_others_is_said(ref, said):
    """A zero of 0.6 rad (`ref`) in one knee: its foot hangs in the air while the others stand."""
    model = MODEL.replace('<joint name="LF_KFE" ', f'<joint name="LF_KFE" ref="{ref}" ')
    assert model != MODEL
    robot = dog(model)
    entry = Entry("dog", lambda settings: robot, "lab")
    if not said:
        height_matches(entry, load(()))
        return
    with pytest.raises(PluginError, match=r"feet in the default pose: foot 'LF_foot': \d+\.?\d* mm above that of '"):
        height_matches(entry, load(()))


def test_a_robot_whose_spec_has_another_name_than_the_registered_one_is_refused():
    """Else its recordings and policies would be of that other robot."""
    with pytest.raises(PluginError, match=r"Robot 'cat' .from lab.: its spec is called 'dog', expected .*, 'cat'"):
        made_by(lambda settings: dog(MODEL), "robots", "robot 'cat'", "cat", "lab", {})


def test_a_robot_without_a_policy_is_told_all_the_ways_to_one():
    with pytest.raises(ConfigError, match=r"hts pretrain.*hts policy import.*--set robot.policy=FILE.safetensors"):
        pretrained_file(dog(MODEL))
