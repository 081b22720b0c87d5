"""The contestants of `compare_cpu.py`, each run in a process of its own: `python cpu_rivals.py NAME` serves rounds.

Each line on stdin is a number of seconds; the answer is one line of JSON, {"steps", "seconds"}, of whole batches.
Between rounds a contestant waits and takes no processor time. All of them walk with the shipped policy (a robot in the
air is simulated twice as fast as one on its feet) and hardly change it (learning rate 1e-5); 1,536 samples a candidate
and batch, 5 epochs of 4 minibatches of 384, networks 256-128 with ELU.
"""

from __future__ import annotations

import itertools
import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from one_world import OneWorld

from hts.plugins import load
from hts.policies.files import load_policy

BATCH, MINIBATCH, EPOCHS = 1536, 384, 5
RATE = 1e-5
Work = Callable[[], int]
"""Collects one batch and learns from it; returns the number of control steps."""


def ours(robot_name: str, candidates: int, anchored: bool, engine: str = "mujoco") -> Work:
    """`hts`: candidates of 64 worlds; anchored: as fine-tuning does it, with anchor, bound and measurement model."""
    from hts.bench.setup import find, make_population, make_trainer
    from hts.config import EnvConfig, PPOConfig
    from hts.training.trainer import PopulationTrainer

    config = PPOConfig(horizon=BATCH // 64, epochs=EPOCHS, minibatches=BATCH // MINIBATCH, learning_rate=RATE)
    robot, objective = find(robot_name, None)
    seeds = list(range(candidates))
    if anchored:
        trainer = make_trainer(robot, objective, engine, candidates, 64, ppo=config)
    else:
        env = robot.make_env(engine, candidates, 64, EnvConfig(), channels=("joint_torque",), seeds=seeds)
        population = make_population(robot, candidates).to(env.device)
        trainer = PopulationTrainer(env, population, config, seeds=seeds, names=[str(seed) for seed in seeds])

    def work() -> int:
        trainer.batch()
        return trainer.steps_per_batch

    return work


def folded_actor(robot) -> tuple[list[tuple[torch.Tensor, torch.Tensor]], torch.Tensor]:
    """Weights and biases of the shipped actor, with its observation normaliser folded in, and log sigma."""
    policy = load_policy(robot.pretrained_policy(), robot.spec)
    t = policy.tensors
    count = len(policy.card.sizes().hidden) + 1
    layers = [(t[f"actor.{i}.weight"].clone(), t[f"actor.{i}.bias"].clone()) for i in range(count)]
    weight, bias = layers[0]
    weight = weight / t["observation_std"]
    layers[0] = (weight, bias - weight @ t["observation_mean"])
    return layers, t["log_std"].clone()


@torch.no_grad()
def copy_layers(layers: list[tuple[torch.Tensor, torch.Tensor]], linears: list[torch.nn.Linear]) -> None:
    """Into a rival's linear layers of the same sizes."""
    for (weight, bias), linear in zip(layers, linears, strict=True):
        linear.weight.copy_(weight)
        linear.bias.copy_(bias)


def gym_world(robot, index: int):
    """One world as a gymnasium env."""
    import gymnasium
    import numpy as np

    class GymWorld(OneWorld, gymnasium.Env):
        """`OneWorld` with the spaces that gymnasium asks for."""

        def __init__(self) -> None:
            super().__init__(robot, None, index)
            self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (self.observation_size,), np.float32)
            self.action_space = gymnasium.spaces.Box(-100.0, 100.0, (self.action_size,), np.float32)

    return GymWorld()


def stable_baselines(robot_name: str, kind: str, worlds: int, threads: int) -> Work:
    """Stable-Baselines3's PPO on a DummyVecEnv or SubprocVecEnv of so many worlds, torch with so many threads."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.logger import configure
    from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

    robot = load().make_robot(robot_name)
    torch.set_num_threads(1)  # before the workers are forked
    makers = [lambda index=index: gym_world(robot, index) for index in range(worlds)]
    env = DummyVecEnv(makers) if kind == "dummy" else SubprocVecEnv(makers, start_method="fork")
    torch.set_num_threads(threads)
    layers, log_std = folded_actor(robot)
    hidden = [len(bias) for _, bias in layers[:-1]]
    model = PPO(
        "MlpPolicy",
        env,
        learning_rate=RATE,
        n_steps=BATCH // worlds,
        batch_size=MINIBATCH,
        n_epochs=EPOCHS,
        gamma=0.99,
        gae_lambda=0.95,
        clip_range=0.2,
        vf_coef=1.0,
        ent_coef=0.0,
        max_grad_norm=1.0,
        device="cpu",
        seed=0,
        policy_kwargs={"net_arch": {"pi": hidden, "vf": hidden}, "activation_fn": torch.nn.ELU},
    )
    model.set_logger(configure(None, []))
    linears = [m for m in model.policy.mlp_extractor.policy_net if isinstance(m, torch.nn.Linear)]
    copy_layers(layers, [*linears, model.policy.action_net])
    with torch.no_grad():
        model.policy.log_std.copy_(log_std)

    def work() -> int:
        model.learn(BATCH, reset_num_timesteps=model.num_timesteps == 0, log_interval=None)
        return BATCH

    return work


def torchrl_parallel(robot_name: str, worlds: int, threads: int) -> Work:
    """TorchRL as its PPO tutorial does it: ParallelEnv, Collector, GAE, ClipPPOLoss."""
    from tensordict.nn import NormalParamExtractor, TensorDictModule
    from torch import nn
    from torchrl.collectors import Collector
    from torchrl.envs import GymWrapper, ParallelEnv
    from torchrl.modules import ProbabilisticActor, ValueOperator
    from torchrl.objectives import ClipPPOLoss
    from torchrl.objectives.value import GAE

    robot = load().make_robot(robot_name)
    torch.set_num_threads(1)
    makers = [lambda index=index: GymWrapper(gym_world(robot, index)) for index in range(worlds)]
    env = ParallelEnv(worlds, makers, mp_start_method="fork")
    torch.set_num_threads(threads)
    layers, log_std = folded_actor(robot)

    def network(last: int) -> nn.Sequential:
        sizes = [layers[0][0].shape[1], *(len(bias) for _, bias in layers[:-1]), last]
        parts: list[nn.Module] = []
        for first, second in itertools.pairwise(sizes):
            parts += [nn.Linear(first, second), nn.ELU()]
        return nn.Sequential(*parts[:-1])

    class Sigma(nn.Module):
        """Mean and a sigma that does not depend on the observation, one beside the other."""

        def __init__(self, sigma: torch.Tensor) -> None:
            super().__init__()
            self.log_std = nn.Parameter(sigma)

        def forward(self, mean: torch.Tensor) -> torch.Tensor:
            return torch.cat((mean, self.log_std.expand_as(mean)), -1)

    mean = network(robot.spec.num_joints)
    copy_layers(layers, [m for m in mean if isinstance(m, nn.Linear)])
    body = nn.Sequential(mean, Sigma(log_std), NormalParamExtractor(scale_mapping="exp"))
    actor = ProbabilisticActor(
        TensorDictModule(body, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=_Diagonal,
        return_log_prob=True,
    )
    critic = ValueOperator(network(1), ["observation"])
    gae = GAE(gamma=0.99, lmbda=0.95, value_network=critic, average_gae=True)
    loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_bonus=False, critic_coeff=1.0)
    optimiser = torch.optim.Adam(loss.parameters(), lr=RATE)
    batches = iter(
        Collector(env, actor, frames_per_batch=BATCH, total_frames=-1, auto_register_policy_transforms=False)
    )

    def work() -> int:
        data = next(batches)
        for _ in range(EPOCHS):
            with torch.no_grad():
                gae(data)
            flat = data.reshape(-1)
            for rows in torch.randperm(BATCH).chunk(BATCH // MINIBATCH):
                values = loss(flat[rows])
                optimiser.zero_grad()
                (values["loss_objective"] + values["loss_critic"]).backward()
                torch.nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                optimiser.step()
        return BATCH

    return work


class _Diagonal(torch.distributions.Independent):
    """A normal distribution per joint, as one."""

    def __init__(self, loc: torch.Tensor, scale: torch.Tensor) -> None:
        super().__init__(torch.distributions.Normal(loc, scale, validate_args=False), 1, validate_args=False)


CONTESTANTS: dict[str, Callable[[str], Work]] = {
    "hts, 6 candidates x 64 worlds, anchored, measured": lambda robot: ours(robot, 6, True),
    "hts, 6 candidates x 64 worlds": lambda robot: ours(robot, 6, False),
    "hts, 1 candidate x 64 worlds": lambda robot: ours(robot, 1, False),
    "sb3 DummyVecEnv 16": lambda robot: stable_baselines(robot, "dummy", 16, 1),
    "sb3 DummyVecEnv 16, 2 torch threads": lambda robot: stable_baselines(robot, "dummy", 16, 2),
    "sb3 SubprocVecEnv 2": lambda robot: stable_baselines(robot, "subproc", 2, 1),
    "sb3 SubprocVecEnv 16": lambda robot: stable_baselines(robot, "subproc", 16, 1),
    "sb3 SubprocVecEnv 16, 2 torch threads": lambda robot: stable_baselines(robot, "subproc", 16, 2),
    "torchrl ParallelEnv 2": lambda robot: torchrl_parallel(robot, 2, 1),
    "torchrl ParallelEnv 16": lambda robot: torchrl_parallel(robot, 16, 1),
    "torchrl ParallelEnv 16, 2 torch threads": lambda robot: torchrl_parallel(robot, 16, 2),
}
OURS = "hts, 6 candidates x 64 worlds, anchored, measured"


@contextmanager
def quiet() -> Iterator[Any]:
    """What libraries print goes to stderr; yields the real stdout."""
    real, sys.stdout = sys.stdout, sys.stderr
    try:
        yield real
    finally:
        sys.stdout = real


def main() -> None:
    name, robot = sys.argv[1], sys.argv[2]
    with quiet() as answer:
        work = CONTESTANTS[name](robot)
        work()
        for line in sys.stdin:
            seconds, start, steps = float(line), time.perf_counter(), 0
            while True:
                steps += work()
                spent = time.perf_counter() - start
                if spent >= seconds:
                    break
            answer.write(json.dumps({"steps": steps, "seconds": spent}) + "\n")
            answer.flush()


if __name__ == "__main__":
    main()
