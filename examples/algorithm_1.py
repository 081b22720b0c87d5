"""Algorithm 1 on a toy robot: measure, model, fine-tune under a KL bound, try, repeat. About a minute on a laptop.

    python examples/algorithm_1.py

The robot is a sled on a rail with two motors and a commanded speed. In simulation both motors are alike. On the real
one the front motor has four times the copper loss, there is more drag, a delay, and a gauge that shows battery current:
what the simulator does not know, and what is to be saved. "Real" is another simulation here, and only `Real.record`
looks into it. The steps are those of arXiv 2502.10956, Algorithm 1; what a step does for a legged robot is `hts run`.
"""

from __future__ import annotations

import argparse
import itertools

import numpy as np
import torch
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs.transforms import TransformedEnv
from torchrl.objectives.value import GAE

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.contracts import Signals
from hts.measurement.linear import Linear, LinearSettings
from hts.measurement.transform import MeasurementTransform
from hts.recordings.recording import Recording, Series
from hts.rl import (
    KLConstrainedPPOLoss,
    MeasuredReward,
    Population,
    PopulationActor,
    PopulationCollector,
    PopulationCritic,
    PopulationRandom,
    Sizes,
    SplitStepEnv,
    project_to_kl_bound,
)

DT, INSTANCES, HORIZON, CPU = 0.05, 32, 32, torch.device("cpu")  # s, env instances a candidate, steps a batch
TORQUE, CURRENT = Channel("motor_torque", "N*m", (2,)), Channel("battery_current", "A", ())
SIZES = Sizes(observation=2, critic_observation=2, action=2, hidden=(32, 32))
WEIGHTS, BOUNDS, ELITES, ITERATIONS = (0.5, 1.0, 5.0), (0.2, 0.5, 1.0), 3, 3


class Sled(SplitStepEnv):
    """1 kg that two motors push along a rail, P candidates in N instances: hold the commanded speed, 0.5 to 1.5 m/s."""

    dt, drag, delay = DT, 1.0, 0

    def __init__(self, candidates: int, instances: int, seed: int = 0) -> None:
        shape = torch.Size((candidates, instances))
        super().__init__(batch_size=shape, device=CPU)
        self.random = PopulationRandom([seed] * candidates, CPU)  # the same draws for every candidate
        self.speed = torch.zeros(*shape, 1)
        self.sent = [torch.zeros(*shape, 2)] * (1 + self.delay)  # torques on their way, oldest first
        seen = {name: Unbounded((*shape, 2)) for name in ("observation", "critic_observation")}
        channels = Composite(motor_torque=Unbounded((*shape, 2)), shape=shape)
        self.observation_spec = Composite(**seen, channels=channels, shape=shape)
        self.action_spec, self.reward_spec = Unbounded((*shape, 2)), Unbounded((*shape, 1))
        flag = Binary(1, (*shape, 1), dtype=torch.bool)
        self.done_spec = Composite({name: flag.clone() for name in ("done", "terminated", "truncated")}, shape=shape)

    def begin_step(self, action):
        self.sent = [*self.sent[1:], action]
        return self.sent[0]

    def simulate(self, inputs):
        self.torque, self.steps = inputs, self.steps + 1
        self.speed = self.speed + DT * (inputs.sum(-1, keepdim=True) - self.drag * self.speed)

    def end_step(self, action):
        over = self.steps >= 100  # 5 s
        return (self.speed - self.command), {"terminated": torch.zeros_like(over), "truncated": over, "done": over}

    def rewards(self, steps):
        return DT * torch.exp(-torch.stack(steps).squeeze(-1).square() / 0.05)  # a rate of at most 1 per second

    def observations(self):
        seen = torch.cat((self.speed, self.command), -1)
        return {"observation": seen, "critic_observation": seen}

    def channel_values(self):
        return {"motor_torque": self.torque}

    def start_episodes(self, mask):
        mask, shape = mask.unsqueeze(-1), self.batch_size
        fresh = 0.5 + self.random.uniform(shape[1], 1)
        if not hasattr(self, "command"):
            self.command, self.steps, self.torque = fresh, torch.zeros(*shape, 1), torch.zeros(*shape, 2)
        self.command = torch.where(mask, fresh, self.command)
        self.speed, self.steps = self.speed.masked_fill(mask, 0.0), self.steps.masked_fill(mask, 0.0)

    def _set_seed(self, seed):
        self.random.seed(seed or 0)


class Real(Sled):
    """The robot. It gives recordings and nothing else."""

    drag, delay, idle = 1.3, 1, 0.4  # 1/s, steps, A

    def record(self, policy: dict[str, torch.Tensor], noise: bool, seconds: float) -> Recording:
        """One walk of a policy, with or without its exploration noise, and what the gauge showed."""
        population = Population.from_candidates(SIZES, [policy])
        actor = PopulationActor(population, PopulationRandom([7], CPU) if noise else None)
        data = self.rollout(round(seconds / DT), actor, break_when_any_done=False)[0, 0]
        torque = data["next", "channels", "motor_torque"]
        loss = torch.tensor([2.0, 0.5])  # A/(N·m)²: the front motor is the bad one
        current = self.idle + (loss * torque.square()).sum(-1) + 0.05 * torch.randn(len(torque))
        robot = {"robot": "sled", "joint_names": ("front", "rear"), "kp": (1.0, 1.0), "kd": (0.0, 0.0), "mass_kg": 1.0}
        session = {"world": "real", "policy_hash": "", "iteration": 0, "clock": "simulated", "rate_hz": 1 / DT}
        return Recording(
            **robot,
            **session,
            schedule=ScheduleConfig(commands=(Command(seconds=seconds, vx=1.0),)),
            idle={"battery_current": self.idle},
            time=np.arange(len(torque)) * DT,
            channels={name.name: Series(name, one.numpy()) for name, one in ((TORQUE, torque), (CURRENT, current))},
        )


def net_current(policy: dict[str, torch.Tensor], seconds: float) -> float:
    """Mean battery current above idle of a walk on the robot, A."""
    recording = Real(1, 1, seed=5).record(policy, False, seconds)
    return float(recording.values("battery_current").mean()) - Real.idle


def train(starts, weights, bounds, batches: int, model: Linear | None = None):
    """PPO of all candidates together: r_sim + λ (r_real − centre), E[KL(π ‖ anchor)] ≤ c. Returns policies and scores.

    starts: each candidate's anchor; weights, bounds [P]: λ, c; score: mean r_real of the finished policy in simulation.
    """
    count, random = len(starts), PopulationRandom([3] * len(starts), CPU)
    population = Population.from_candidates(SIZES, starts)
    anchor, actor, critic = population.frozen(), PopulationActor(population, random), PopulationCritic(population)
    env = Sled(count, INSTANCES)
    measured = None
    if model is not None:
        env = TransformedEnv(env, MeasurementTransform(model, torch.neg, "current"), auto_unwrap=False)
        measured = MeasuredReward(weights, DT, in_key=("real_reward", "current"))
    collector = PopulationCollector(env, actor, frames_per_batch=count * INSTANCES * HORIZON)
    advantage = GAE(gamma=0.97, lmbda=0.95, value_network=critic, vectorized=False)
    loss = KLConstrainedPPOLoss(actor, critic, kl_bound=bounds, multiplier_rate=0.1, normalize_advantage=True)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
    for data in itertools.islice(collector, batches):
        if measured is not None:
            measured(data)
        advantage(data)
        samples = data.flatten(1, 2)
        for _ in range(4):
            for rows in torch.randperm(samples.shape[1]).chunk(4):
                parts = loss(samples[:, rows])
                optimiser.zero_grad()
                (parts["loss_objective"] + parts["loss_critic"] + parts["loss_entropy"]).sum().backward()
                optimiser.step()
        loss.update_multiplier(loss.kl_to_reference(data))
    project_to_kl_bound(population, anchor, data["observation"].flatten(1, 2), bounds)  # the last batch may end beyond
    score = torch.zeros(count)
    if model is not None:
        trial = env.rollout(100, PopulationActor(population), break_when_any_done=False)
        score = trial["next", "real_reward", "current"].mean((1, 2, 3))
    collector.shutdown()
    return [population.candidate(index) for index in range(count)], score


def main(iterations: int = ITERATIONS, batches: int = 40, pretraining: int = 150, seconds: float = 60.0) -> float:
    """Saving of the best policy against the pretrained one: share of net current in walks of `seconds` on the robot."""
    torch.manual_seed(0)
    fresh = Population(SIZES, 1, init_std=0.5).candidate(0)
    (pretrained,), _ = train([fresh], torch.zeros(1), torch.full((1,), torch.inf), pretraining)
    before = net_current(pretrained, seconds)
    print(f"pretrained: {before:.2f} A above idle on the robot")
    best, saving = pretrained, 0.0
    data = [Real(1, 1, seed=seed).record(pretrained, bool(seed), seconds) for seed in range(4)]  # D_0
    for iteration in range(iterations):
        model = Linear(LinearSettings(), Signals((TORQUE,), CURRENT, 1 / DT))
        fit = model.fit(data, seed=iteration)  # f_i <- A(D_i)
        anchors = [pretrained] if best is pretrained else [best, pretrained]
        sweep = list(itertools.product(anchors, WEIGHTS, BOUNDS))
        weights, bounds = (torch.tensor([one[index] for one in sweep]) for index in (1, 2))
        candidates, score = train([one[0] for one in sweep], weights, bounds, batches, model)
        elites = score.topk(min(ELITES, len(sweep))).indices.tolist()  # Π_{i+1} <- the best in simulation
        found = {one: 1.0 - net_current(candidates[one], seconds) / before for one in elites}  # tried on the robot
        data += [Real(1, 1, seed=9).record(candidates[index], True, seconds) for index in elites]  # D_{i+1}
        winner = max(found, key=found.__getitem__)
        if found[winner] > saving:
            best, saving = candidates[winner], found[winner]
        tried = ", ".join(f"λ {sweep[i][1]:g} c {sweep[i][2]:g}: {found[i]:.1%}" for i in elites)
        print(f"iteration {iteration + 1}: fit R² {fit['validation_r2'] or float('nan'):.2f}; elites saved: {tried}")
    print(f"best: {saving:.1%} less than the pretrained policy")
    return saving


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--iterations", type=int, default=ITERATIONS)
    main(parser.parse_args().iterations)
