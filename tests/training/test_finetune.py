"""Fine-tuning of a group: what a candidate that had to be stopped looks like, also after a checkpoint."""

from __future__ import annotations

import errno
import shutil

import pytest
import torch

from hts.config import EnvConfig, FinetuneConfig, PPOConfig, RandomisationConfig
from hts.policies.files import load_policy
from hts.training import finetune as module
from hts.training.checkpoint import load_notes, save_checkpoint
from hts.training.sweep import Candidate
from hts.training.trainer import PopulationTrainer

CONFIG = FinetuneConfig(
    num_envs=2,
    steps=64,  # 4 batches
    ppo=PPOConfig(horizon=8, epochs=1, minibatches=1),
    env=EnvConfig(randomisation=RandomisationConfig(models=1), threads=1),
)
GROUP = [Candidate("00-00", "pretrained", {}, 0.5), Candidate("00-01", "pretrained", {}, 1.0)]


class Poisoned(PopulationTrainer):
    """The first candidate's numbers go bad in the first batch."""

    def learn(self, data):
        if self.batches == 0:
            data["next", "reward"][0, 0, 3] = float("nan")
        return super().learn(data)


@pytest.fixture
def tune(monkeypatch, tmp_path):
    pytest.importorskip("hts_go1", reason="the robot of this test is not installed")
    from hts_go1.robot import Go1, Go1Settings

    robot = Go1(Go1Settings())
    anchors = {"pretrained": load_policy(robot.pretrained_policy(), robot.spec)}
    monkeypatch.setattr(module, "PopulationTrainer", Poisoned)

    def tune(checkpoint=None):
        return module.finetune(robot, "mujoco", CONFIG, GROUP, anchors, list, (), seed=3, checkpoint=checkpoint)

    return tune


def test_a_stopped_candidate_keeps_its_reason_and_its_history_through_a_checkpoint(tune, monkeypatch, tmp_path):
    (whole, other), steps = tune()
    assert whole.stopped == "candidate 00-00: r_sim is not finite at control step 3 (batch 0) in 1 of its worlds"
    assert other.stopped is None
    assert [row["steps"] for row in other.history] == [16, 32, 48, 64]
    assert whole.kl == pytest.approx(0.0, abs=1e-6)  # put back to its anchor

    def save_and_stop(*arguments, really=module.save_checkpoint):
        really(*arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "CHECKPOINT_SECONDS", 0.0)
    monkeypatch.setattr(module, "save_checkpoint", save_and_stop)
    place = tmp_path / "checkpoint"
    for _ in range(2):  # stopped after the first batch, then after the second
        with pytest.raises(KeyboardInterrupt):
            tune(place)
    assert len(load_notes(tmp_path / "checkpoint-0")["history"]) == 2
    monkeypatch.undo()
    monkeypatch.setattr(module, "PopulationTrainer", Poisoned)

    (resumed, neighbour), resumed_steps = tune(place)
    assert resumed_steps == steps
    assert resumed.stopped == whole.stopped
    assert [repr(row) for row in resumed.history] == [repr(row) for row in whole.history]  # NaN is not NaN
    assert neighbour.history == other.history and neighbour.kl == other.kl


def test_an_env_for_which_no_training_can_be_made_is_closed(tune, monkeypatch):
    from hts.envs.velocity import VelocityEnv

    closed, really = [], VelocityEnv.close

    def close(env, **kwargs):
        closed.append(env)
        really(env, **kwargs)

    def refuse(*arguments, **options):
        raise ValueError("no trainer")

    monkeypatch.setattr(VelocityEnv, "close", close)
    monkeypatch.setattr(module, "PopulationTrainer", refuse)
    with pytest.raises(ValueError, match="no trainer"):
        tune()
    assert len(closed) == 1


def test_a_checkpoint_that_would_not_fit_is_refused_before_the_old_one_is_touched(monkeypatch, tmp_path):
    """Writing it would end the process: torchrl.checkpoint writes through memory maps."""
    place = tmp_path / "checkpoint-0"
    save_checkpoint(place, {"numbers": torch.zeros(10)}, {"robot": "dog"})
    before = place.read_bytes()
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=2 * 4_000_000))
    with pytest.raises(OSError, match="No space left") as caught:
        save_checkpoint(place, {"numbers": torch.zeros(1_000_000)}, {"robot": "dog"})  # 4 MB, written twice
    assert (caught.value.errno, caught.value.filename) == (errno.ENOSPC, str(place))
    assert place.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["checkpoint-0"]
