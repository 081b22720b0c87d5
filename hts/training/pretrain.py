"""`hts pretrain`: the policy to start from, trained on the task's own reward."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hts.atomic import atomic_write
from hts.config import PretrainConfig
from hts.contracts import Robot
from hts.envs.constants import delay_seconds
from hts.policies.files import Policy, make_card, save_policy
from hts.policies.layout import layout_of
from hts.rl.population import Population, Sizes
from hts.training.finetune import check_env
from hts.training.trainer import PopulationTrainer


def pretrain_policy(
    robot: Robot, config: PretrainConfig, out: Path, progress: Callable[[dict[str, Any]], None] | None = None
) -> Path:
    """Train from scratch; writes out/pretrained.safetensors, .json and curve.json (a row per 20 batches).
    Returns the policy's path.

    progress: called with each row. Raises SimulationError if training goes non-finite, ConfigError for an env that
    does not say what a policy sees in it.
    """
    started = time.perf_counter()
    env_config = config.env.model_copy(update={"seed": config.seed})
    env = robot.make_env(config.engine, 1, config.num_envs, env_config, channels=("joint_torque",), seeds=[config.seed])
    layout = layout_of(env, robot.spec.name)
    spaces = env.observation_spec
    sizes = Sizes(
        spaces["observation"].shape[-1], spaces["critic_observation"].shape[-1], robot.spec.num_joints, config.hidden
    )
    population = Population(sizes, 1, config.init_std, config.seed, env.device)
    trainer = PopulationTrainer(
        env, population, config.ppo, seeds=[config.seed], names=["pretrained"], update_normaliser=True
    )
    curve: list[dict[str, Any]] = []
    batches = max(1, round(config.steps / trainer.steps_per_batch))
    for index in range(batches):
        stats = trainer.batch()
        if index % 20 == 19 or index == batches - 1:
            row = {"steps": stats.steps, "seconds": round(time.perf_counter() - started, 2)}
            row |= {name: round(values[0], 5) for name, values in stats.values.items()}
            curve.append(row)
            if progress is not None:
                progress(row)
    tensors = population.candidate(0)
    check_env(env)
    made = {
        "command": f"hts pretrain --robot {robot.spec.name}",
        "config": config.model_dump(mode="json"),
        "steps": trainer.batches * trainer.steps_per_batch,
        "seconds": round(time.perf_counter() - started, 1),
        "final": curve[-1],
        "delay_seconds": delay_seconds(env_config, robot.spec),
    }
    card = make_card(robot.spec, tensors, layout, sizes, **made)
    path = save_policy(Path(out) / "pretrained.safetensors", Policy(tensors, card))
    atomic_write(Path(out) / "curve.json", json.dumps(curve, indent=1) + "\n")
    trainer.close()
    return path
