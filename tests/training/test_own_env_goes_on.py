"""A training in an author's own env goes on from a checkpoint as if it had never ended."""

from __future__ import annotations

import torch
from tensordict import TensorDict
from torchrl.data import Binary, Composite, Unbounded

from hts.config import PPOConfig
from hts.rl import Population, PopulationActor, PopulationCollector, PopulationRandom, Sizes, SplitStepEnv
from hts.training.trainer import PopulationTrainer

SHAPE, CPU, SIZES = torch.Size((2, 4)), torch.device("cpu"), Sizes(2, 2, 2, (8,))


class Walk(SplitStepEnv):
    """The position moves by the action, a step pays less the farther away it is, and an episode takes ten steps. It
    saves its state, and knows nothing of how a collector begins."""

    dt = 0.02

    def __init__(self):
        super().__init__(batch_size=SHAPE, device=CPU)
        self.random = PopulationRandom(range(2), CPU)
        self.position, self.age = torch.zeros(*SHAPE, 2), torch.zeros(SHAPE)
        own = {name: Unbounded((*SHAPE, 2)) for name in ("observation", "critic_observation")}
        self.observation_spec = Composite(own, shape=SHAPE)
        self.action_spec, self.reward_spec = Unbounded((*SHAPE, 2)), Unbounded((*SHAPE, 1))
        flag = Binary(1, (*SHAPE, 1), dtype=torch.bool)
        self.done_spec = Composite({name: flag.clone() for name in ("done", "terminated", "truncated")}, shape=SHAPE)

    def begin_step(self, action):
        return action

    def simulate(self, inputs):
        self.position, self.age = self.position + inputs, self.age + 1

    def end_step(self, action):
        late = (self.age >= 10).unsqueeze(-1)
        return self.position.clone(), {"terminated": torch.zeros_like(late), "truncated": late, "done": late}

    def rewards(self, steps):
        return -torch.stack(list(steps)).abs().sum(-1) * self.dt

    def observations(self):
        return {"observation": self.position, "critic_observation": self.position}

    def channel_values(self):
        return {}

    def start_episodes(self, mask):
        self.position = torch.where(mask.unsqueeze(-1), self.random.normal(4, 2), self.position)
        self.age = torch.where(mask, 0.0, self.age)

    def _set_seed(self, seed):
        self.random.seed(seed or 0)

    def full_state(self):
        random = self.random.state_dict()
        return TensorDict({"position": self.position.clone(), "age": self.age.clone(), "random": random}, batch_size=[])

    def load_full_state(self, state):
        self.position, self.age = state["position"].clone(), state["age"].clone()
        self.random.load_state_dict(state["random"])


def population():
    one = Population(SIZES, 1, init_std=0.3, seed=1).candidate(0)
    return Population.from_candidates(SIZES, [one] * 2)


def trainer(resume=None):
    own = population()
    settings = PPOConfig(horizon=6, epochs=1, minibatches=1)
    own_anchor, bounds = own.frozen(), torch.full((2,), 0.5)
    return PopulationTrainer(
        Walk(), own, settings, seeds=(1, 2), names=("a", "b"), anchor=own_anchor, bounds=bounds, resume=resume
    )


def test_a_training_goes_on_in_the_midst_of_its_episodes():
    whole = trainer()
    for _ in range(2):
        whole.batch()
    state = whole.full_state().clone()
    assert state["env", "age"].max() > 0, "no episode is under way, so this shows nothing"
    other = trainer(state)
    assert [other.batch().values for _ in range(2)] == [whole.batch().values for _ in range(2)]


def test_so_does_a_collector_alone():
    def collector():
        actor = PopulationActor(population(), PopulationRandom([5, 6], CPU))
        return PopulationCollector(Walk(), actor, frames_per_batch=48)

    first, second = collector(), collector()
    batches = iter(first)
    next(batches)
    second.load_state_dict(first.state_dict())
    assert torch.equal(next(iter(second))["observation"], next(batches)["observation"])


def test_only_the_first_reset_after_it_starts_no_episodes():
    env = Walk()
    env.reset()
    env.position += 1
    before = env.position.clone()
    env.go_on(env.full_state())
    assert torch.equal(env.reset()["observation"], before)
    assert not torch.equal(env.reset()["observation"], before)
