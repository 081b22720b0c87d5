"""Steps of a velocity env, and randomisation that tests share."""

from __future__ import annotations

import torch
from tensordict import TensorDict

from hts.config import RandomisationConfig

CALM = RandomisationConfig(enabled=False)
MIXED = RandomisationConfig(models=3)


def still(env) -> torch.Tensor:
    return torch.zeros(*env.batch_size, 12)


def step(env, action=None) -> TensorDict:
    """One step without the reset that may follow."""
    data = TensorDict({"action": still(env) if action is None else action}, batch_size=env.batch_size)
    return env.step(data)["next"]


def roll(env, actions, state=None):
    """Steps and resets, as a collector does; every "next" on the way."""
    state = env.reset() if state is None else state
    seen = []
    for action in actions:
        state["action"] = action
        data, state = env.step_and_maybe_reset(state)
        seen.append(data["next"].clone())
    return seen, state


def put(env, world: int, quaternion=(1.0, 0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), height=2.0) -> None:
    """A world of the flat list into the air, in a given attitude, with a given velocity in the world frame."""
    mask = torch.zeros(env.engine.num_worlds, dtype=torch.bool)
    mask[world] = True
    qpos, qvel = env.engine.qpos.clone(), torch.zeros_like(env.engine.qvel)
    qpos[world, 2] = height
    qpos[world, 3:7] = torch.tensor(quaternion)
    qpos[world, 7:] = env.default_pose
    qvel[world, :3] = torch.tensor(velocity)
    env.engine.reset(mask, qpos, qvel)
