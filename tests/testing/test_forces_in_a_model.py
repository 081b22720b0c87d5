"""Forces that a model brings along and neither its spec nor its sensors know of: `hts check` names each."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest
from legged_model import FLOOR, JOINTS, LEGS, dog, text

from hts.errors import PluginError
from hts.plugins import Entry, load
from hts.testing.checks import robots
from hts.testing.checks.robot_forces import CHECKS

MODEL = text()
TYPED = MODEL.replace('<freejoint name="root"/>', '<joint name="root" type="free"/>')
SHELL = '<site name="trunk_shell" type="box" size="0.21 0.09 0.06"/>'
KNEE = '<joint name="LF_KFE" '


def said(model: str) -> list[str]:
    """What each check of forces says of a dog of this MJCF."""
    robot, found = dog(model), []
    for check in CHECKS:
        try:
            check(Entry("dog", lambda settings: robot, "lab"), load(()))
        except PluginError as error:
            found.append(str(error))
    return found


WRONG = {
    "a trunk in oil, by a class of defaults": (
        TYPED.replace("<worldbody>", '<default><joint damping="0.02" armature="0.1"/></default><worldbody>'),
        r"free joint 'root' of its model has damping 0.02, armature 0.1, .*write <freejoint/>",
    ),
    "a thigh without weight": (
        MODEL.replace('<body name="LF_thigh"', '<body name="LF_thigh" gravcomp="1"'),
        r"gravcomp of bodies of its model .LF_thigh. takes their weight away",
    ),
    "damping beside kd": (
        MODEL.replace(KNEE, f'{KNEE} damping="1" '),
        r"damping of joints .*: joint 'LF_KFE': 1, expected at most 0\.2\. It brakes beside kd, in training alone",
    ),
    "no rotor": (
        MODEL.replace('armature="0.01"', "", 1),
        r"armature of joints .*: joint 'LF_HAA': 0, expected rotor inertia",
    ),
    "a narrower limit of the joint": (
        MODEL.replace(KNEE, f'{KNEE} actuatorfrcrange="-20 40" '),
        r"actuatorfrcrange .*: joint 'LF_KFE': -20 to 40, expected none, or -40 to 40\. Correct it or SPEC",
    ),
    "a step before it": (
        MODEL.replace(FLOOR, f'{FLOOR}<geom name="step" type="box" pos="0.8 0 0.05" size="0.1 1 0.05"/>'),
        r"1 more geom.* 'floor' .*first: box 'step' at 0.8 0 0.05.*take them out",
    ),
    "a floor on a body": (
        MODEL.replace(FLOOR, f'<body name="ground">{FLOOR}</body>'),
        r"geom 'floor' of its model lies on body 'ground', expected directly in the <worldbody>",
    ),
    "a solver for MJX": (
        MODEL.replace("<option ", '<option iterations="1" '),
        r'<option iterations="1"> of its model .*, expected at least 5\. Leave it out, or write 10',
    ),
    "a grip of its own": (
        MODEL.replace("<actuator>", '<contact><pair geom1="LF_foot" geom2="floor"/></contact><actuator>'),
        r"<pair> of its model gives 'LF_foot' a friction on 'floor' of its own",
    ),
}


@pytest.mark.parametrize(("model", "words"), WRONG.values(), ids=WRONG)
def test_a_force_that_nobody_asked_for_is_said_in_one_line(model, words):
    assert model != MODEL
    (line,) = said(model)
    with pytest.raises(AssertionError, match=words):
        raise AssertionError(line)
    assert "\n" not in line


def test_what_is_no_other_force_is_taken():
    sound = MODEL.replace(KNEE, f'{KNEE} damping="0.01" actuatorfrcrange="-40 40" ')
    seen = '<geom type="box" pos="1 0 0" size="1 1 1" contype="0" conaffinity="0"/>'
    slides = '<contact><pair geom1="trunk" geom2="floor" condim="1"/></contact><actuator>'
    sound = sound.replace(FLOOR, FLOOR + seen).replace("<actuator>", slides)
    assert said(MODEL) == said(sound) == said(TYPED) == []


def test_the_page_makes_of_a_file_with_motors_a_model_that_is_in_order(tmp_path):
    """A file as robots' makers have it: motors, classes of defaults that reach the trunk, a keyframe, no floor."""
    page = (Path(__file__).parents[2] / "docs" / "authors" / "robot.md").read_text()
    block = page.split('```python title="from_file.py"\n')[1].split("```")[0]
    (tmp_path / "from_file.py").write_text(block)
    made = runpy.run_path(str(tmp_path / "from_file.py"))
    theirs = TYPED.replace(FLOOR, "").replace("<option ", '<option iterations="1" ')
    theirs = theirs.replace("<worldbody>", '<default><joint damping="1" armature="0.1"/></default><worldbody>')
    theirs = re.sub("<actuator>.*</actuator><sensor>.*</sensor>", "", theirs)
    theirs = re.sub(r'<site name="\w+_foot"[^>]*/>', "", theirs).replace(SHELL, "")
    motors = "".join(f'<motor joint="{joint}" ctrlrange="-40 40"/>' for joint in reversed(JOINTS))
    rest = f'<actuator>{motors}</actuator><keyframe><key qpos="{"0 " * 19}" ctrl="{"0 " * 12}"/></keyframe>'
    (tmp_path / "dog.xml").write_text(theirs.replace("</mujoco>", f"{rest}</mujoco>"))
    robot = dog(MODEL)
    feet = {f"{leg}_foot": (f"{leg}_shank", (0, 0, -0.2), 0.03) for leg in LEGS}
    path = str(tmp_path / "dog.xml")
    type(robot).mjcf = lambda self: made["from_file"](path, self.spec, feet, [0.21, 0.09, 0.06])
    for check in robots.CHECKS:
        check(Entry("dog", lambda settings: robot, "lab"), load(()))
