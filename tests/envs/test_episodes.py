"""When episodes end: all together, or the first ones spread."""

from __future__ import annotations

import pytest
import torch

from hts.config import EnvConfig
from hts.envs.episodes import time_outs
from hts.evaluation.simulation import test_config as config_of_trials
from hts.plugins import load

CPU = torch.device("cpu")


def ends(spread: bool, steps: int, instances: int = 4) -> torch.Tensor:
    """Time-outs of instances that stand, [steps, candidates, instances]."""
    config = EnvConfig(episode_seconds=0.4, stagger=spread, threads=1)
    env = load().make_robot("go1").make_env("mujoco", 2, instances, config, seeds=[3, 3])
    state, found = env.reset(), []
    for _ in range(steps):
        state["action"] = torch.zeros(env.action_spec.shape)
        data, state = env.step_and_maybe_reset(state)
        found.append(data["next", "truncated"].squeeze(-1).clone())
    env.close()
    return torch.stack(found)


def test_episodes_that_begin_together_end_together_as_configured():
    assert ends(False, 45).all((1, 2)).nonzero().flatten().tolist() == [19, 39]  # 0.4 s are 20 steps


def test_first_episodes_are_spread_and_later_ones_whole():
    found = ends(True, 45)
    assert torch.equal(found[:, 0], found[:, 1])  # the same in each candidate
    for instance in range(found.shape[2]):
        first, second, *_ = found[:, 0, instance].nonzero().flatten().tolist()
        assert second - first == 20 and first < 20
    firsts = {found[:, 0, instance].nonzero()[0].item() for instance in range(found.shape[2])}
    assert len(firsts) == found.shape[2]


@pytest.mark.parametrize("instances", [5, 128, 1024])
def test_they_end_evenly_however_many_there_are(instances):
    found = time_outs(EnvConfig(episode_seconds=20.0, stagger=True), 0.02, (1, instances), CPU)[0]
    in_tenths = torch.histc(found, 10, 0.0, 1000.0)
    assert found.min() >= 1 and found.max() <= 1000
    assert (in_tenths - instances / 10).abs().max() <= 1.5


def test_a_trial_is_walked_whole():
    assert not config_of_trials(EnvConfig(stagger=True), [0.8], 8.0, 0).stagger


def test_a_checkpoint_of_before_goes_on_and_one_that_lacks_more_does_not():
    env = load().make_robot("go1").make_env("mujoco", 1, 2, EnvConfig(threads=1), seeds=[3])
    env.reset()
    state = env.full_state()
    del state["buffers", "time_out"]
    env.load_full_state(state)
    assert (env.time_out == 1000).all()  # 20 s
    del state["buffers", "action"]
    with pytest.raises(KeyError, match="action"):
        env.load_full_state(state)
    env.close()
