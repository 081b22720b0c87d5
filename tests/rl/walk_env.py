"""An env of made-up states, for tests of what collectors make of it."""

from __future__ import annotations

import torch
from torchrl.data import Binary, Composite, Unbounded

from hts.rl import PopulationRandom, SplitStepEnv

CPU, SHAPE = torch.device("cpu"), torch.Size((2, 4))


class Walk(SplitStepEnv):
    """States [P, N, 3] drawn anew; a step pays the sum of the one it began in; episodes never end."""

    dt = 1.0

    def __init__(self, shape: torch.Size = SHAPE) -> None:
        super().__init__(batch_size=shape, device=CPU)
        self.random = PopulationRandom(range(shape[0]), CPU)
        self.state = self.draw()
        self.last = torch.zeros_like(self.state)
        seen = {name: Unbounded((*shape, 3)) for name in ("observation", "critic_observation")}
        self.observation_spec = Composite(**seen, shape=shape)
        self.action_spec, self.reward_spec = Unbounded((*shape, 2)), Unbounded((*shape, 1))
        flag = Binary(1, (*shape, 1), dtype=torch.bool)
        self.done_spec = Composite({name: flag.clone() for name in ("done", "terminated", "truncated")}, shape=shape)

    def draw(self) -> torch.Tensor:
        return self.random.uniform(self.batch_size[1], 3)

    def begin_step(self, action):
        return action

    def simulate(self, inputs):
        self.last, self.state = self.state, self.draw()

    def end_step(self, action):
        never = torch.zeros(*self.batch_size, 1, dtype=torch.bool)
        return self.last, {"terminated": never, "truncated": never, "done": never}

    def rewards(self, steps):
        return torch.stack(list(steps)).sum(-1)

    def observations(self):
        return {"observation": self.state, "critic_observation": self.state}

    def channel_values(self):
        return {}

    def start_episodes(self, mask):
        """None ends."""

    def _set_seed(self, seed):
        self.random.seed(seed or 0)
