"""Twins of models as others write them: sizes by class, solvers for another engine, a floor on a body."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from legged_model import FLOOR, dog, text

from hts.errors import ConfigError
from hts.worlds.twin.model import build
from hts.worlds.twin.parameters import DynamicsParameters

MODEL = text()


def zones(model: str) -> list[float]:
    """Radius of the zone of each foot's touch sensor, m."""
    twin = build(dog(model), DynamicsParameters())
    return [float(twin.model.site(f"twin_foot_{foot}").size[0]) for foot in range(4)]


def test_a_foot_site_whose_size_a_default_says_is_felt_all_over():
    by_class = MODEL.replace(' size="0.03"/></body>', "/></body>")
    by_class = by_class.replace("<worldbody>", '<default><site size="0.08"/></default><worldbody>')
    assert zones(MODEL) == pytest.approx([1.6 * 0.03] * 4)
    assert zones(by_class) == pytest.approx([1.6 * 0.08] * 4)


def test_the_zone_holds_the_corners_of_a_sole():
    sole = MODEL.replace(' size="0.03"/></body>', ' type="box" size="0.06 0.06 0.06"/></body>')
    assert zones(sole) == pytest.approx([np.sqrt(3) * 0.06] * 4)


def test_a_floor_on_a_body_is_refused_since_its_grip_would_not_vary():
    with pytest.raises(ConfigError, match=r"Robot 'dog': geom 'floor' .* lies on body 'ground', expected directly"):
        build(dog(MODEL.replace(FLOOR, f'<body name="ground">{FLOOR}</body>')), DynamicsParameters())


def test_the_floor_carries_a_robot_whose_model_was_made_for_a_coarse_solver():
    """On average the feet of a robot that steps on the spot carry its weight."""
    twin = build(dog(MODEL.replace("<option ", '<option iterations="1" ls_iterations="5" ')), DynamicsParameters())
    data, felt = mujoco.MjData(twin.model), []
    data.qpos[:] = twin.standing
    pose = np.array(twin.spec.default_pose)
    for step in range(2000):
        target = pose + 0.1 * np.sin(2 * np.pi * 3 * step * 0.001 + np.arange(12))
        data.ctrl[:] = 100 * (target - data.qpos[7:]) - 2 * data.qvel[6:]
        mujoco.mj_step(twin.model, data)
        felt.append(data.sensordata[twin.touch].sum())
    assert np.mean(felt) == pytest.approx(9.81 * twin.total_mass, rel=0.1)
