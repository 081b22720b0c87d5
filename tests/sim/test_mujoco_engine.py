"""The CPU engine steps leaner copies of the models that it is given, to the same bits."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from hts import plugins
from hts.config import RandomisationConfig
from hts.sim.models import variants
from hts.sim.mujoco_engine import FEW_GEOMS, MujocoEngine, lean

pytest.importorskip("hts_go1", reason="a robot with legs")
FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
ISLAND, MIDPHASE = mujoco.mjtDisableBit.mjDSBL_ISLAND, mujoco.mjtDisableBit.mjDSBL_MIDPHASE


def plainly(model: mujoco.MjModel, state: np.ndarray, ctrl: np.ndarray) -> np.ndarray:
    """The state after physics steps with ctrl (steps, nu), of a model as it is, with a cold solver at first."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state, FULL)
    for row in ctrl:
        data.ctrl[:] = row
        mujoco.mj_step(model, data)
    mujoco.mj_getState(model, data, state, FULL)
    return state


def test_a_walk_on_leaner_models_is_to_the_bit_that_on_the_given_ones():
    robot = plugins.load().make_robot("go1")
    spec, worlds = robot.spec, 6
    given = variants(robot, RandomisationConfig(models=3), seed=0)
    engine = MujocoEngine(given, [0, 1, 2, 0, 1, 2], spec.substeps, threads=1)
    pose, random = torch.tensor(spec.default_pose), torch.Generator().manual_seed(0)
    qpos, qvel = torch.zeros(worlds, given[0].nq), torch.zeros(worlds, given[0].nv)
    qpos[:, 2], qpos[:, 3], qpos[:, 7:] = spec.base_height, 1.0, pose
    engine.reset(torch.ones(worlds, dtype=torch.bool), qpos, qvel)
    for _ in range(60):  # 1.2 s: on its feet, then with trunk and knees on the floor
        ctrl = pose + torch.randn(spec.substeps, worlds, len(pose), generator=random)
        before, inputs = engine.snapshot(ctrl)
        engine.step(ctrl)
        after = engine.snapshot(ctrl)[0]
        for world in range(worlds):
            np.testing.assert_array_equal(after[world], plainly(given[world % 3], before[world], inputs[world]))
    assert float(engine.qpos[:, 2].min()) < 0.6 * spec.base_height
    engine.close()


def test_an_engine_looks_for_no_islands_and_leaves_the_given_models_as_they_are():
    given = variants(plugins.load().make_robot("go1"), RandomisationConfig(models=2), seed=0)
    engine = MujocoEngine(given, [0, 1, 0], 4, threads=1)
    assert all(model.opt.disableflags & ISLAND and model.opt.disableflags & MIDPHASE for model in engine.models)
    assert engine.models[0] is engine.models[2]  # one copy of each, not one per world
    assert not any(model.opt.disableflags for model in given)
    engine.close()


def test_several_trees_keep_their_islands_and_many_geoms_their_boxes():
    geom = '<geom size="0.1"/>'

    def model(*geoms_of_trees: int) -> mujoco.MjModel:
        trees = "".join(f"<body><freejoint/>{geom * count}</body>" for count in geoms_of_trees)
        return mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{trees}</worldbody></mujoco>")

    alone, two, many = model(1), model(1, 1), model(FEW_GEOMS + 1)
    assert lean(alone).opt.disableflags == ISLAND | MIDPHASE
    assert lean(two).opt.disableflags == MIDPHASE
    assert lean(many).opt.disableflags == ISLAND
