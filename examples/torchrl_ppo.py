"""A TorchRL PPO script on dm_control's cartpole, and the same script with three pieces of `hts.rl` swapped in.

    python examples/torchrl_ppo.py

First plain PPO learns to balance. Then that policy is fine-tuned to push the cart less, which the task does not reward,
without moving further than c nats from what it was: the measured effort comes into the reward by `MeasuredReward`
(centred by `RewardCentring`), and `ClipPPOLoss` becomes `KLConstrainedPPOLoss`. Nothing else changes: env, collector,
GAE, actor, critic and optimiser are TorchRL's and torch's own. Lines that differ are marked with <--.
"""

from __future__ import annotations

import argparse

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import Unbounded
from torchrl.envs import (
    CatTensors,
    Compose,
    DMControlEnv,
    DoubleToFloat,
    ExplorationType,
    StepCounter,
    TransformedEnv,
    set_exploration_type,
)
from torchrl.envs.transforms import Transform
from torchrl.modules import NormalParamExtractor, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from hts.rl import KLConstrainedPPOLoss, MeasuredReward, RewardCentring

FRAMES, EPOCHS, MINIBATCH, DT = (
    1000,
    8,
    250,
    0.01,
)  # a batch, passes over it, samples of a part, control step of cartpole, s


class Effort(Transform):
    """What a measurement model would predict: minus the squared push, as a rate. Here it is simply computed."""

    def __init__(self) -> None:
        super().__init__(out_keys=["effort_reward"])

    def _step(self, tensordict, next_tensordict):
        return next_tensordict.set("effort_reward", -tensordict["action"].square().sum(-1, keepdim=True).float())

    def _reset(self, tensordict, tensordict_reset):
        return tensordict_reset.set("effort_reward", torch.zeros(1))

    def transform_observation_spec(self, observation_spec):
        observation_spec["effort_reward"] = Unbounded(1)
        return observation_spec


def make_env(seed: int, weight: float = 0.0) -> TransformedEnv:
    """Cartpole with its observation as one vector; with weight λ the measured effort is in the reward."""
    stock = [DoubleToFloat(), CatTensors(["position", "velocity"], "observation"), StepCounter(500), Effort()]
    measured = MeasuredReward(weight, DT, in_key="effort_reward", centring=RewardCentring(rate=0.002))  # <--
    env = TransformedEnv(DMControlEnv("cartpole", "balance"), Compose(*stock, *([measured] if weight else [])))
    env.set_seed(seed)
    return env


def make_networks(env: TransformedEnv) -> tuple[ProbabilisticActor, ValueOperator]:
    size, actions = env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
    net = nn.Sequential(nn.Linear(size, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 2 * actions))
    head = TensorDictModule(nn.Sequential(net, NormalParamExtractor()), ["observation"], ["loc", "scale"])
    actor = ProbabilisticActor(
        head, in_keys=["loc", "scale"], spec=env.action_spec, distribution_class=TanhNormal, return_log_prob=True
    )
    critic = nn.Sequential(nn.Linear(size, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 1))
    return actor, ValueOperator(critic, in_keys=["observation"])


def train(env, actor, critic, loss, batches: int) -> float:
    """PPO as it stands in TorchRL's tutorial. Returns the mean KL to the reference over the last batch, nats."""
    advantage = GAE(gamma=0.99, lmbda=0.95, value_network=critic, average_gae=True)
    optimiser = torch.optim.Adam(loss.parameters(), lr=3e-4)
    frames = {"frames_per_batch": FRAMES, "total_frames": batches * FRAMES}
    collector = Collector(env, actor, **frames, auto_register_policy_transforms=False)  # nothing is recurrent here
    kl = torch.tensor(float("nan"))
    for data in collector:
        for _ in range(EPOCHS):
            advantage(data)
            for rows in torch.randperm(FRAMES).split(MINIBATCH):
                parts = loss(data[rows])
                optimiser.zero_grad()
                (parts["loss_objective"] + parts["loss_critic"] + parts["loss_entropy"]).backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                optimiser.step()
        if isinstance(loss, KLConstrainedPPOLoss):  # <--
            kl = loss.kl_to_reference(data)
            loss.update_multiplier(kl)
    collector.shutdown()
    return float(kl)


@torch.no_grad()
def judged(actor, seed: int = 100) -> tuple[float, float]:
    """Return of one balanced episode of 5 s (500 at most), and its mean squared push."""
    env = make_env(seed)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        data = env.rollout(500, actor)
    return float(data["next", "reward"].sum()), -float(data["next", "effort_reward"].mean())


def main(pretraining: int = 40, finetuning: int = 20, kl_bound: float = 0.5, weight: float = 50.0) -> dict[str, float]:
    torch.manual_seed(0)
    env = make_env(seed=0)
    actor, critic = make_networks(env)
    train(env, actor, critic, ClipPPOLoss(actor, critic, entropy_coeff=1e-3), pretraining)
    before = judged(actor)
    print(f"plain PPO: return {before[0]:.0f} of 500, mean squared push {before[1]:.3f}")

    loss = KLConstrainedPPOLoss(
        actor, critic, kl_bound=kl_bound, clip_value=None
    )  # <-- the reference: actor as it is now
    kl = train(make_env(seed=1, weight=weight), actor, critic, loss, finetuning)
    after = judged(actor)
    print(f"fine-tuned: return {after[0]:.0f} of 500, mean squared push {after[1]:.3f}; KL {kl:.2f} of {kl_bound} nats")
    names = ("return_before", "effort_before", "return_after", "effort_after", "kl")
    return dict(zip(names, (*before, *after, kl), strict=True))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--pretraining", type=int, default=40, help="batches of plain PPO")
    parser.add_argument("--finetuning", type=int, default=20, help="batches under the bound")
    arguments = parser.parse_args()
    main(arguments.pretraining, arguments.finetuning)
