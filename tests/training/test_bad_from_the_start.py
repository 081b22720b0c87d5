"""A measured reward that is no number for anybody before anybody has learned is no fault of the training."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Composite, Unbounded
from torchrl.envs import EnvBase

from hts.channels import Channel
from hts.contracts import ModelContext, Signals
from hts.errors import SimulationError
from hts.measurement.transform import MeasurementTransform, ProxyTransform
from hts.plugins import load
from hts.testing.examples.objective.objective import Fake
from hts.training.finetune import measured_env
from hts.training.trainer import PopulationTrainer

CALM = ("real_reward", "calm")


class Still(EnvBase):
    """Two candidates in three worlds whose joints turn at 1 rad/s."""

    def __init__(self) -> None:
        super().__init__(batch_size=torch.Size([2, 3]))
        entries = {name: Unbounded((2, 3, 2)) for name in ("joint_torque", "joint_velocity")}
        self.observation_spec = Composite(channels=Composite(entries, shape=(2, 3)), shape=(2, 3))
        self.action_spec, self.reward_spec = Unbounded((2, 3, 1)), Unbounded((2, 3, 1))

    def _look(self, **entries: torch.Tensor) -> TensorDict:
        channels = {name: torch.ones(2, 3, 2) for name in ("joint_torque", "joint_velocity")}
        return TensorDict({"channels": channels, **entries}, batch_size=self.batch_size)

    def _reset(self, tensordict=None, **kwargs):
        return self._look()

    def _step(self, tensordict):
        done = torch.zeros(2, 3, 1, dtype=torch.bool)
        return self._look(reward=torch.zeros(2, 3, 1), done=done, terminated=done)

    def _set_seed(self, seed):
        """Nothing is random."""


def looked_at(env, real: torch.Tensor, outcome: TensorDict, name: str = "calm", batches: int = 0) -> None:
    PopulationTrainer._refuse_all_bad(SimpleNamespace(batches=batches, env=env), name, real, outcome)


def poisoned(bad: list[tuple[int, int, int]], batches: int = 0) -> None:
    """bad: candidate, world and step that are NaN; of two candidates in three worlds over five steps."""
    real = torch.zeros(2, 3, 5)
    for place in bad:
        real[place] = math.nan
    looked_at(Still(), real, TensorDict({CALM: real.unsqueeze(-1)}, batch_size=[2, 3, 5]), batches=batches)


def said_of(transform) -> str:
    """What is said of a batch of an env with this transform in it."""
    env = measured_env(Still(), [transform])
    outcome = env.rollout(5)["next"]
    with pytest.raises(SimulationError) as told:
        looked_at(env, outcome["real_reward", "fake"].squeeze(-1), outcome, "fake")
    return str(told.value)


def fitted(weight: float):
    """`linear` of the objective's channels, unfitted but for one number that all its predictions are multiplied by."""
    objective = Fake()
    inputs = tuple(Channel(name, unit, (2,)) for name, unit in (("joint_torque", "N·m"), ("joint_velocity", "rad/s")))
    signals = Signals(inputs, objective.target, 50.0)
    model = load().make_measurement_model("linear", {}, ModelContext(signals))
    model.load_tensors({name: value * weight for name, value in model.tensors().items()})
    return objective, model


def test_where_nobody_has_a_reward_from_the_start_its_maker_is_named_once_and_no_learning_rate():
    with pytest.raises(
        SimulationError, match="r_real of calm is not finite at control step 3, in all candidates"
    ) as told:
        poisoned([(0, 1, 4), (1, 2, 3)])
    said = str(told.value)
    assert said.endswith("Look at Still, which wrote it.")
    assert "learning_rate" not in said and said.count("is not finite") == 1


def test_a_measurement_model_that_predicts_nan_is_named():
    objective, model = fitted(math.nan)
    said = said_of(MeasurementTransform.of(objective, model))
    assert said.endswith("Look at step() of measurement model 'linear', whose predictions are not finite.")


def test_a_reward_that_makes_nan_of_what_was_predicted_is_named_and_the_model_is_not_blamed():
    _, model = fitted(1.0)
    said = said_of(MeasurementTransform(model, lambda z: z * math.nan, "fake"))
    assert said.endswith(
        "Look at reward() of objective 'fake', given finite predictions of measurement model 'linear'."
    )


def test_a_stand_in_that_gives_nan_is_named_and_so_is_a_reward_of_it():
    class Broken(Fake):
        def proxy(self, channels):
            return super().proxy(channels) * math.nan

    class Rewarded(Fake):
        def reward(self, prediction):
            return prediction * math.nan

    assert said_of(ProxyTransform(Broken())).endswith("Look at proxy() of objective 'fake'.")
    assert said_of(ProxyTransform(Rewarded())).endswith("Look at reward() of objective 'fake'.")


def test_one_of_them_or_all_of_them_later_are_stopped_by_name():
    poisoned([(0, 1, 4)])
    poisoned([(0, 1, 4), (1, 2, 3)], batches=1)
