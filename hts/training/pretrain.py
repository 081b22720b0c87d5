"""`hts pretrain`: the policy to start from, trained on the task's own reward."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from hts.atomic import atomic_write
from hts.config import PretrainConfig
from hts.contracts import Robot
from hts.envs.constants import delay_seconds
from hts.errors import ConfigError, RunError
from hts.locks import only_one
from hts.places import CURVE, PRETRAINED_FILE, PRETRAINING, resume_command
from hts.policies.files import Policy, make_card, save_policy
from hts.policies.layout import layout_of
from hts.policy_ids import PRETRAINED
from hts.rl.population import Population, Sizes
from hts.task_settings import check_env_velocities
from hts.training.finetune import Saved, check_env
from hts.training.trainer import PopulationTrainer

LOCK, CHECKPOINT = ".lock", "checkpoint"
"""How far a pretraining is."""


def pretrain_policy(
    robot: Robot, config: PretrainConfig, out: Path, progress: Callable[[dict[str, Any]], None] | None = None
) -> Path:
    """Train from scratch; writes out/pretrained.safetensors, .json and curve.json (a row per 20 batches).
    Returns the policy's path. Where a process stopped in the midst of it, the same call goes on from a checkpoint that
    is a minute old at most; envs that cannot be saved in mid-episode begin again.

    progress: called with each row. Raises SimulationError if training goes non-finite, ConfigError for an env that
    does not say what a policy sees in it, RunError for a folder in which another pretraining was begun, or one that
    another process works in.
    """
    Path(out).mkdir(parents=True, exist_ok=True)
    busy = f"{out}: another process is working in it. Wait for it, or stop it first."
    begun = (Path(out) / PRETRAINING).exists()
    with only_one(Path(out) / LOCK, busy):
        try:
            return _pretrained(robot, config, Path(out), progress)
        except ConfigError:  # these settings end so each time: no `hts resume` goes on with them
            if not begun:
                for one in (PRETRAINING, LOCK):
                    (Path(out) / one).unlink(missing_ok=True)
            raise


def _pretrained(
    robot: Robot, config: PretrainConfig, out: Path, progress: Callable[[dict[str, Any]], None] | None
) -> Path:
    """`pretrain_policy`, alone in the folder."""
    check_env_velocities(config.env, robot, "env")
    asked = {"robot": robot.spec.name, "config": config.model_dump(mode="json")}
    _begin(out, asked)
    env_config = config.env.model_copy(update={"seed": config.seed})
    env = robot.make_env(config.engine, 1, config.num_envs, env_config, channels=("joint_torque",), seeds=[config.seed])
    layout = layout_of(env, robot.spec.name)
    spaces = env.observation_spec
    sizes = Sizes(
        spaces["observation"].shape[-1], spaces["critic_observation"].shape[-1], robot.spec.num_joints, config.hidden
    )
    population = Population(sizes, 1, config.init_std, config.seed, env.device)
    saved = Saved(out / CHECKPOINT, {"robot": robot.spec.name, "key": _key(asked), "worlds": config.num_envs})
    before = saved.load()
    curve: list[dict[str, Any]] = before[1]["history"] if before is not None else []
    spent = _Spent(before[1]["spent"]["seconds"] if before is not None else 0.0)
    trainer = PopulationTrainer(
        env,
        population,
        config.ppo,
        seeds=[config.seed],
        names=[PRETRAINED],
        update_normaliser=True,
        resume=before[0] if before is not None else None,
    )
    batches = max(1, round(config.steps / trainer.steps_per_batch))
    while trainer.batches < batches:
        stats = trainer.batch()
        if trainer.batches % 20 == 0 or trainer.batches == batches:
            row = {"steps": stats.steps, "seconds": round(spent.seconds, 2)}
            row |= {name: round(values[0], 5) for name, values in stats.values.items()}
            curve.append(row)
            if progress is not None:
                progress(row)
        if trainer.batches < batches:
            saved.keep(trainer, curve, {"spent": spent})
    tensors = population.candidate(0)
    check_env(env)
    made = {
        "command": f"hts pretrain --robot {robot.spec.name}",
        "config": config.model_dump(mode="json"),
        "steps": trainer.batches * trainer.steps_per_batch,
        "seconds": round(spent.seconds, 1),
        "final": curve[-1],
        "delay_seconds": delay_seconds(env_config, robot.spec),
    }
    card = make_card(robot.spec, tensors, layout, sizes, **made)
    path = save_policy(out / PRETRAINED_FILE, Policy(tensors, card))
    atomic_write(out / CURVE, json.dumps(curve, indent=1) + "\n")
    trainer.close()
    for done in (CHECKPOINT, PRETRAINING, LOCK):
        (out / done).unlink(missing_ok=True)
    return path


def resume_pretraining(folder: Path, progress: Callable[[dict[str, Any]], None] | None = None) -> Path:
    """Go on with a pretraining that was begun in `folder`, for a robot that a plugin offers. Raises as
    `pretrain_policy`, and RunError if its file is damaged."""
    from hts.plugins import load

    path = Path(folder) / PRETRAINING
    try:
        asked = json.loads(path.read_text(encoding="utf-8"))
        name, config = asked["robot"], PretrainConfig.model_validate(asked["config"])
    except (ValueError, KeyError, TypeError) as error:
        raise RunError(
            f"{path}: does not say what was asked for ({str(error).splitlines()[0]}). Begin "
            "anew in another folder: hts pretrain --out DIR."
        ) from error
    return pretrain_policy(load().make_robot(name), config, folder, progress)


def _begin(out: Path, asked: Mapping[str, Any]) -> None:
    """Write down what is asked for. Raises RunError where something else was."""
    path = out / PRETRAINING
    text = json.dumps(asked, indent=1) + "\n"
    if not path.exists():
        atomic_write(path, text)
    elif path.read_text(encoding="utf-8") != text:
        raise RunError(
            f"{out}: another pretraining was begun here. Go on with it: `{resume_command(out)}`; or choose "
            "another folder."
        )


def _key(asked: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()


class _Spent:
    """Seconds of training, those before a checkpoint included; kept in one as `Halfway` and `Averaged` are."""

    def __init__(self, before: float) -> None:
        self._begun = time.perf_counter() - before

    @property
    def seconds(self) -> float:
        return time.perf_counter() - self._begun

    def state(self) -> dict[str, Any]:
        return {}

    def notes(self) -> dict[str, float]:
        return {"seconds": self.seconds}
