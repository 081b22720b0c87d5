"""Mistakes of somebody who folds an env of their own: each is one line: what is there, and what was expected."""

from __future__ import annotations

import re

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import Compose, EnvBase, RewardSum, TransformedEnv, VecGymEnvTransform

from hts.channels import Channel
from hts.envs.folded import FoldedEnv
from hts.errors import ConfigError, HtsError, PluginError

WORLDS = 4


class Inner(EnvBase):
    """Four worlds that stand still; flags: which of them it has."""

    def __init__(self, flags=("done", "terminated", "truncated")):
        super().__init__(batch_size=[WORLDS], device="cpu")
        self.flags = flags
        self.observation_spec = Composite(position=Unbounded((WORLDS, 3)), height=Unbounded((WORLDS,)), shape=(WORLDS,))
        self.action_spec = Unbounded((WORLDS, 2))
        self.reward_spec = Unbounded((WORLDS, 1))
        flag = Binary(1, (WORLDS, 1), dtype=torch.bool)
        self.done_spec = Composite({name: flag.clone() for name in flags}, shape=(WORLDS,))

    def _reset(self, tensordict=None, **kwargs):
        flags = {name: torch.zeros(WORLDS, 1, dtype=torch.bool) for name in self.flags}
        return TensorDict({"position": torch.zeros(WORLDS, 3), "height": torch.ones(WORLDS), **flags}, [WORLDS])

    def _step(self, tensordict):
        return self._reset().set("reward", torch.zeros(WORLDS, 1))

    def _set_seed(self, seed):
        """Nothing is random."""


def folded(
    values=lambda step, action: {"push": torch.zeros(WORLDS, 2)}, inner=None, observation=("position",), dt=0.1, **more
):
    channels = {"push": Channel("push", "N", (2,))}
    return FoldedEnv(inner or Inner(), 2, dt=dt, observation=observation, channels=channels, values=values, **more)


def refusal(kind: type[HtsError], **given) -> str:
    with pytest.raises(kind) as caught:
        folded(**given).reset()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_an_env_without_a_mistake_is_folded():
    state = folded(observation=("position", "height")).reset()
    assert state["observation"].shape == (2, 2, 4)  # three numbers and one
    assert state["channels", "push"].shape == (2, 2, 2)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"dt": 20}, r"dt is 20, expected the control step in s, above 0 and up to 1 \(not in ms\)"),
        ({"dt": -0.02}, "dt is -0.02, expected"),
        ({"action_limit": [1.0, 2.0]}, r"action_limit is \[1.0, 2.0\], expected one number above 0"),
        ({"action_limit": 0.0}, "action_limit is 0.0, expected one number above 0"),
    ],
)
def test_a_step_in_ms_and_a_limit_that_is_no_number_are_said(given, words):
    assert re.search(words, refusal(ConfigError, **given))


def test_a_misspelt_observation_is_answered_with_the_closest():
    assert "Did you mean 'position'? Known: height, position." in refusal(ConfigError, observation=("positon",))


def test_a_flag_that_is_not_there_is_named():
    text = refusal(ConfigError, inner=Inner(("done", "terminated")))
    assert "no flag 'truncated' (it has done, terminated)" in text


def test_a_channel_that_values_does_not_give_is_named():
    text = refusal(PluginError, values=lambda step, action: {"puhs": torch.zeros(WORLDS, 2)})
    assert "No channel named 'push'. Did you mean 'puhs'?" in text


@pytest.mark.parametrize("shape", [(WORLDS, 3), (2, 2, 2), (2 * WORLDS,), ()])
def test_a_channel_of_another_shape_is_told_with_both(shape):
    text = refusal(PluginError, values=lambda step, action: {"push": torch.zeros(shape)})
    assert f"has shape {shape}, expected (4, 2)" in text


def test_values_that_are_no_tensors_are_told():
    assert "is a list, expected a tensor" in refusal(PluginError, values=lambda step, action: {"push": [0.0]})
    assert "gives a Tensor, expected a mapping" in refusal(PluginError, values=lambda step, action: torch.zeros(4, 2))


def test_an_env_that_begins_episodes_by_itself_is_refused():
    """What it says of the last step of an episode is a placeholder: zeros, or NaN."""
    text = refusal(ConfigError, inner=TransformedEnv(Inner(), Compose(RewardSum(), VecGymEnvTransform())))
    assert "begins episodes anew by itself" in text and "AutoresetMode.DISABLED" in text
    assert folded(inner=TransformedEnv(Inner(), RewardSum())).reset()["observation"].shape == (2, 2, 3)
