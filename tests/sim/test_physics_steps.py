"""Every physics step of a control step, as engines keep it and as the velocity task writes it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from hts import plugins
from hts.channels import SUBSTEP_FORCE, SUBSTEP_TORQUE, SUBSTEP_VELOCITY
from hts.config import EnvConfig, RandomisationConfig
from hts.errors import SimulationError
from hts.sim.models import compile_model
from hts.sim.mujoco_engine import MujocoEngine

pytest.importorskip("hts_go1", reason="a robot with legs")
CHANNELS = (SUBSTEP_TORQUE, SUBSTEP_VELOCITY, SUBSTEP_FORCE, "joint_torque", "joint_velocity")
CONFIG = EnvConfig(randomisation=RandomisationConfig(enabled=False), threads=1)


@pytest.fixture(scope="module")
def robot():
    return plugins.load().make_robot("go1")


def test_they_are_those_that_mujoco_takes_one_by_one(robot):
    model, steps = compile_model(robot), robot.spec.substeps
    engine = MujocoEngine([model], [0], steps, threads=1)
    qpos, qvel = torch.zeros(1, model.nq), torch.zeros(1, model.nv)
    qpos[0, 2], qpos[0, 3] = robot.spec.base_height, 1.0
    qpos[0, 7:] = torch.tensor(robot.spec.default_pose)
    engine.reset(torch.tensor([True]), qpos, qvel)
    target = torch.tensor(robot.spec.default_pose) + 0.2
    engine.step(target.expand(steps, 1, -1))
    speeds, sensors = engine.physics_steps()
    engine.close()

    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = qpos[0].numpy(), target.numpy()
    for step in range(steps):
        before = data.qvel.copy()
        mujoco.mj_step(model, data)
        np.testing.assert_allclose(speeds[0, step], (before + data.qvel) / 2, atol=1e-4)
        np.testing.assert_allclose(sensors[0, step], data.sensordata, rtol=1e-3, atol=1e-2)
    assert float((speeds[0, 0] - speeds[0, -1]).abs().max()) > 0.1  # a control step is not one physics step


@pytest.mark.parametrize("engine", ["mujoco", "warp"])
def test_the_last_of_them_is_what_the_control_step_shows(robot, engine):
    if engine == "warp":
        pytest.importorskip("mujoco_warp", reason="the extra `gpu` is not installed")
    config = CONFIG.model_copy(update={"device": "cpu"})
    env = robot.make_env(engine, 2, 3, config, channels=CHANNELS, seeds=[0, 1])
    state = env.reset()
    state["action"] = 0.3 * torch.ones(env.action_spec.shape)
    channels = env.step(state)["next", "channels"]
    env.close()
    steps, joints = robot.spec.substeps, robot.spec.num_joints
    assert channels[SUBSTEP_TORQUE].shape == (2, 3, steps, joints)
    assert channels[SUBSTEP_FORCE].shape == (2, 3, steps, len(robot.spec.foot_sites))
    torch.testing.assert_close(channels[SUBSTEP_TORQUE][..., -1, :], channels["joint_torque"])
    assert not torch.equal(channels[SUBSTEP_TORQUE][..., 0, :], channels["joint_torque"])
    assert torch.isfinite(channels[SUBSTEP_VELOCITY]).all()


def test_an_engine_that_keeps_its_last_state_alone_says_so(robot, monkeypatch):
    monkeypatch.setattr(MujocoEngine, "physics_steps", lambda self: None)
    env = robot.make_env("mujoco", 1, 2, CONFIG, channels=(SUBSTEP_TORQUE,), seeds=[0])
    with pytest.raises(
        SimulationError, match="'substep_torque' needs every physics step.* Ask for it when the env is made"
    ):
        env.reset()
    env.close()
