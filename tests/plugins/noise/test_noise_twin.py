"""The microphone beside a twin: standing is as quiet as the room, walking is not, and walking faster is louder."""

from __future__ import annotations

import numpy as np
import pytest

from hts import plugins
from hts.policies.export import to_onnx
from hts.policies.files import load_policy
from hts.worlds.base import walking
from hts.worlds.twin.parameters import TwinSettings
from hts.worlds.twin.programme import Block, Session
from hts.worlds.twin.session import Batch


@pytest.fixture(scope="module")
def levels(tmp_path_factory):
    """Of the last 2 s of 4 s: standing, walking at 0.4 m/s and at 1.0 m/s; and the microphone."""
    registry = plugins.load()
    robot = registry.make_robot("go1")
    policy = to_onnx(load_policy(robot.pretrained_policy()), tmp_path_factory.mktemp("policy") / "policy.onnx")
    microphone = registry.make_instrument("microphone", {}, robot)
    cases = [(None, 0.0), (str(policy), 0.4), (str(policy), 1.0)]
    batch = Batch(robot, TwinSettings(), {"microphone": microphone}, len(cases), np.random.SeedSequence(5))
    try:
        sessions = [Session(id="", blocks=(Block(policy=path, schedule=walking(speed, 4.0)),)) for path, speed in cases]
        rows = batch.run(sessions, "twin")
    finally:
        batch.close()
    return [row[0].values("sound_level")[100:].astype(float) for row in rows], microphone


def test_a_standing_robot_is_as_quiet_as_the_room(levels):
    (standing, _, _), microphone = levels
    assert standing.mean() == pytest.approx(microphone.idle()["sound_level"], abs=0.3)


def test_a_walk_is_heard_and_a_faster_one_more(levels):
    (standing, slow, fast), _ = levels
    assert slow.min() > standing.max() + 10
    assert 10 * np.log10((10 ** (fast / 10)).mean() / (10 ** (slow / 10)).mean()) > 3


def test_footfalls_are_what_is_heard(levels):
    _, microphone = levels
    assert (microphone.energy["steps"][1:] > 10 * microphone.energy["drives"][1:]).all()
    assert (microphone.steps[1:] > 4 * 4).all()  # four feet, more than a step a second each
