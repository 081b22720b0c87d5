"""Forces that a model brings along and neither its spec nor its sensors know of: `hts check` names each."""

from __future__ import annotations

import pytest
from legged_model import FLOOR, dog, text

from hts.errors import PluginError
from hts.plugins import Entry, load
from hts.testing.checks.robot_forces import CHECKS

MODEL = text()
TYPED = MODEL.replace('<freejoint name="root"/>', '<joint name="root" type="free"/>')
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
