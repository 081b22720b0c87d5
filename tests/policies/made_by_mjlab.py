"""A short mjlab training of the Go1 on flat ground, on a CPU with mjlab: `python made_by_mjlab.py FOLDER`.

Writes what `mjlab train` writes (model_N.pt, params/, FOLDER.onnx) and log.npz: six seconds of that policy in mjlab,
without noise, encoder bias and pushes. The state of a row is read before its target is sent; its torques are those of
that state.
"""

from __future__ import annotations

import os
import sys
from dataclasses import asdict
from pathlib import Path

os.environ |= {"CUDA_VISIBLE_DEVICES": "", "WANDB_MODE": "disabled"}

import mjlab.tasks  # noqa: F401 - registers them
import numpy as np
import torch
from mjlab.envs import ManagerBasedRlEnv
from mjlab.rl import RslRlVecEnvWrapper
from mjlab.scripts.train import TrainConfig, run_train
from mjlab.tasks.registry import load_runner_cls

TASK = "Mjlab-Velocity-Flat-Unitree-Go1"
ROWS = 300


def main(folder: Path) -> None:
    config = TrainConfig.from_task(TASK)
    config.env.scene.num_envs = 4
    config.agent.max_iterations, config.agent.logger, config.agent.upload_model = 2, "tensorboard", False
    config.env.observations["actor"].terms.pop("base_lin_vel")  # which a robot does not measure
    run_train(TASK, config, folder)
    config.env.observations["actor"].enable_corruption, config.env.scene.num_envs = False, 1
    for event in ("encoder_bias", "push_robot"):
        config.env.events.pop(event, None)
    env = ManagerBasedRlEnv(cfg=config.env, device="cpu")
    wrapped = RslRlVecEnvWrapper(env, clip_actions=config.agent.clip_actions)
    runner = load_runner_cls(TASK)(wrapped, asdict(config.agent), None, "cpu")
    runner.load(str(max(folder.glob("model_*.pt"))))
    policy, robot = runner.get_inference_policy("cpu"), env.scene["robot"].data
    rows: dict[str, list[np.ndarray]] = {}
    seen, _ = wrapped.reset()
    for step in range(ROWS):
        with torch.no_grad():
            action = policy(seen)
        row = {
            "observation": seen["actor"], "action": action, "joint_position": robot.joint_pos,
            "joint_velocity": robot.joint_vel, "joint_torque": robot.qfrc_actuator,
            "angular_velocity": robot.root_link_ang_vel_b, "projected_gravity": robot.projected_gravity_b,
            "command": env.command_manager.get_command("twist"),
        }  # fmt: skip
        kept = {name: value[0].double().numpy().copy() for name, value in row.items()}
        seen, *_ = wrapped.step(action)
        kept |= {"joint_target": robot.joint_pos_target[0].double().numpy().copy(), "time": step * env.step_dt}
        for name, value in kept.items():
            rows.setdefault(name, []).append(np.array(value))
    arrays = {name: np.stack(values) for name, values in rows.items()}
    np.savez(folder / "log.npz", joint_names=np.array(env.scene["robot"].joint_names), **arrays)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
