"""What the benches run: the shipped policy, a measurement model in the loop, and the trainer of a real run."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from hts.bench.bare import engines_of
from hts.bench.widening import widened
from hts.config import Command, EnvConfig, PPOConfig, ScheduleConfig
from hts.contracts import MODEL, MeasurementModel, ModelContext, chosen_model, physics_steps_of, robot_signals
from hts.errors import ConfigError, HtsError
from hts.measurement.data import gather
from hts.measurement.transform import MeasurementTransform
from hts.plugins import load
from hts.policies.files import load_policy
from hts.recordings.recording import Recording, Series
from hts.rl.actor import PopulationActor
from hts.rl.population import Population
from hts.sim.mujoco_engine import MujocoEngine
from hts.sim.selection import select_engine
from hts.training.finetune import measured_env
from hts.training.trainer import PopulationTrainer

if TYPE_CHECKING:
    from hts.contracts import Objective, Robot

KL_BOUND, WEIGHT = 0.5, 1.0
SAMPLE_STEPS, SAMPLE_WORLDS = 50, 16  # control steps and env instances from which a model takes its input statistics

RECURRENT = "lstm"  # a model with a size to choose, that learns by passes over the data


def find(robot: str | None, objective: str | None) -> tuple[Robot, Objective]:
    """The robot and objective of a bench. Without a name: the first robot installed, and the objective whose
    measurement model is largest. Raises ConfigError where there is none."""
    registry = load()
    if robot is None and not registry.robots:
        raise ConfigError("No robot is installed. Install one, then `hts bench` again; `hts plugins` lists them.")
    machine = registry.make_robot(robot or min(registry.robots))
    if machine.pretrained_policy() is None:
        raise ConfigError(
            f"Robot '{machine.spec.name}' has no pretrained policy to collect with. A robot with a simulation gets one "
            f"by `hts pretrain --robot {machine.spec.name} --out DIR`: let its pretrained_policy() return that file."
        )
    if objective is not None:
        return machine, registry.make_objective(objective)
    offered: list[Objective] = []
    for name in sorted(registry.objectives):
        with suppress(HtsError):  # one that needs settings, or is broken: `hts plugins` lists it with its reason
            offered.append(registry.make_objective(name))
    fitting = [one for one in offered if set(one.inputs) <= set(machine.channels())]
    if not fitting:
        raise ConfigError(f"No objective is installed whose inputs robot '{machine.spec.name}' gives.")
    return machine, max(fitting, key=lambda one: size(new_model(one, machine)))


@dataclass(frozen=True)
class Sizes:
    """What a bench runs on, where it is not the default.

    device: of the env, as `EnvConfig.device`; hidden: layers of actor and critic, none: the shipped policy's;
    memory: units of the measurement model, 0: the objective's own.
    """

    device: str = "auto"
    hidden: tuple[int, ...] = ()
    memory: int = 0


def new_model(objective: Objective, robot: Robot, memory: int = 0) -> MeasurementModel:
    """The objective's model of its default configuration, unfitted: it costs what a fitted one costs."""
    choice = chosen_model(objective, {MODEL: {"name": RECURRENT, "hidden": memory}} if memory else None)
    context = ModelContext(
        robot_signals(objective, robot), objective.measurement_model(), physics_steps=physics_steps_of(robot)
    )
    return load().make_measurement_model(choice.name, choice.settings, context)


def size(model: MeasurementModel) -> int:
    """How many numbers were, or will be, fitted."""
    return sum(tensor.numel() for tensor in model.tensors().values())


def make_population(robot: Robot, count: int, hidden: Sequence[int] = ()) -> Population:
    """Candidates that all start as the robot's shipped policy, sigma included; hidden: in larger networks."""
    path = robot.pretrained_policy()
    assert path is not None
    policy = load_policy(path)
    sizes, tensors = policy.card.sizes(), policy.tensors
    if hidden and tuple(hidden) != sizes.hidden:
        sizes, tensors = widened(sizes, tensors, tuple(hidden))
    return Population.from_candidates(sizes, [tensors] * count)


def make_trainer(
    robot: Robot,
    objective: Objective,
    engine: str,
    candidates: int,
    envs: int,
    seed: int = 0,
    ppo: PPOConfig | None = None,
    sizes: Sizes | None = None,
    model: MeasurementModel | None = None,
) -> PopulationTrainer:
    """A trainer as fine-tuning makes it: anchored, bounded, with the measurement model's reward, already walking.

    model: one with its input statistics; without it a new one, barely fitted to a second of walking.
    """
    sizes = sizes or Sizes()
    seeds = [seed + index for index in range(candidates)]
    config = EnvConfig(device=sizes.device)
    engine = select_engine(engine, sizes.device)
    unfitted = model or new_model(objective, robot, sizes.memory)
    read = MeasurementTransform.of(objective, unfitted).inputs
    channels = tuple(dict.fromkeys((*objective.inputs, *read)))
    env = robot.make_env(engine, candidates, envs, config, channels=channels, seeds=seeds)
    population = make_population(robot, candidates, sizes.hidden).to(env.device)
    population.refresh()
    if model is None:
        model = unfitted
        _fit_barely(env, population, model, robot)
    env = measured_env(env, [MeasurementTransform.of(objective, model)])
    return PopulationTrainer(
        env,
        population,
        ppo or PPOConfig(),
        seeds=seeds,
        names=[str(seed) for seed in seeds],
        anchor=population.frozen(),
        bounds=torch.full((candidates,), KL_BOUND),
        weights={objective.name: torch.full((candidates,), WEIGHT)},
    )


def _fit_barely(env: EnvBase, population: Population, model: MeasurementModel, robot: Robot) -> None:
    """Walk for a second; one pass over what some env instances gave, with a made-up target, sets the statistics."""
    act: TensorDictModuleBase = PopulationActor(population)
    seen: list[torch.Tensor] = []
    with torch.no_grad():
        state = env.reset()
        for _ in range(SAMPLE_STEPS):
            data, state = env.step_and_maybe_reset(act(state))
            seen.append(gather(data["next", "channels"], model.signals.names, env.batch_size.numel()).cpu())
    walked = torch.stack(seen, 1)[:SAMPLE_WORLDS]  # (W, T, F)
    model.fit([_recording(one, model, robot) for one in walked], epochs=1)


def _recording(inputs: torch.Tensor, model: MeasurementModel, robot: Robot) -> Recording:
    """A recording of the model's channels from inputs (T, F); the target is their mean square."""
    signals, spec = model.signals, robot.spec
    parts = inputs.split(list(signals.sizes), 1)
    pairs = zip(signals.inputs, parts, strict=True)
    channels = {channel.name: Series(channel, part.reshape(-1, *channel.shape).numpy()) for channel, part in pairs}
    square = inputs.square().mean(1).reshape(-1, *signals.target.shape)
    channels[signals.target.name] = Series(signals.target, square.numpy())
    seconds = len(inputs) / signals.rate_hz
    return Recording(
        robot=spec.name,
        world="made up",
        policy_hash="",
        iteration=0,
        joint_names=spec.joint_names,
        kp=spec.kp,
        kd=spec.kd,
        rate_hz=signals.rate_hz,
        schedule=ScheduleConfig(commands=(Command(seconds=seconds, vx=0.0),)),
        idle={signals.target.name: 0.0},
        clock="simulated",
        time=np.arange(len(inputs)) / signals.rate_hz,
        channels=channels,
    )


def conditions(trainer: PopulationTrainer, robot: Robot, objective: Objective) -> dict[str, Any]:
    """What was measured where, for the JSON; `engine` is the one that ran."""
    shape: Sequence[int] = trainer.env.batch_size
    made = engines_of(trainer.env)[0]
    return {
        "robot": robot.spec.name,
        "engine": "mujoco" if isinstance(made, MujocoEngine) else "warp",
        "candidates": shape[0],
        "envs": shape[1],
        "horizon": trainer.config.horizon,
        "substeps": robot.spec.substeps,
        "measurement": f"{objective.name}: unfitted model of the default size (one pass), "
        "statistics from the collected channels",
        "hidden": list(trainer.population.sizes.hidden),
        "device": _device(trainer.population.device),
        "cores": os.cpu_count() or 1,
        "engine_threads": made.threads if isinstance(made, MujocoEngine) else 0,
        "torch_threads": 1,  # see `hts.rl.threads`
        "torch": str(torch.__version__),
    }


def _device(device: torch.device) -> str:
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    return platform.processor() or platform.machine()
