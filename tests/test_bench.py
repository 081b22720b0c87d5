"""The benches say what they measured; how fast it was is not a test's business."""

from __future__ import annotations

import itertools
import json

import pytest
import torch

pytest.importorskip("hts_go1", reason="a bench needs an installed robot with a model")
pytest.importorskip("hts_power", reason="a bench needs an installed objective")

from hts.bench import bench_env, bench_fit, bench_sweep, bench_train
from hts.bench.bare import Replay
from hts.bench.setup import find, make_trainer, new_model
from hts.errors import ConfigError

RATES = ("steps_per_s", "bare_steps_per_s", "ratio")


def test_env_reports_rates_their_ratio_and_where_the_time_goes():
    result = bench_env("go1", "power", candidates=2, envs=4, seconds=0.1)
    assert all(result[key] > 0 for key in RATES)
    assert result["steps_per_round"] == 2 * 4 * result["horizon"]
    assert set(result["profile"]) == {"physics", "policy", "measurement", "env", "collector"}
    assert sum(result["profile"].values()) == pytest.approx(1.0, abs=1e-3)
    assert "unfitted" in result["measurement"]
    assert json.loads(json.dumps(result)) == result


def test_train_reports_how_often_each_batch_is_learned_from():
    result = bench_train("go1", "power", candidates=1, envs=4, seconds=0.1)
    assert all(result[key] > 0 for key in RATES)
    assert (result["epochs"], result["minibatches"]) == (5, 4)


def test_sweep_compares_all_together_with_one_after_another():
    result = bench_sweep("go1", "power", envs=2, seconds=0.1)
    assert result["candidates"] == 6
    assert result["steps_per_s"] > 0 and result["one_after_another_steps_per_s"] > 0 and result["speedup"] > 0


def test_fit_counts_samples_times_epochs():
    result = bench_fit("go1", "power", seconds=0.1)
    assert result["samples"] == 5 * 60 * 50  # five recordings of a minute at 50 Hz
    assert result["samples_per_s"] == pytest.approx(result["samples"] * result["epochs"] / result["seconds"])


def test_without_names_the_largest_measurement_model_is_in_the_loop():
    _, largest = find(None, None)
    _, other = find(None, "noise")
    robot, _ = find(None, None)
    assert new_model(largest, robot).num_features >= new_model(other, robot).num_features


def test_a_wrong_name_gets_the_closest_right_one():
    with pytest.raises(ConfigError, match="Did you mean 'go1'"):
        bench_env("go2", "power")


@pytest.fixture
def trainer():
    machine, objective = find("go1", "power")
    made = make_trainer(machine, objective, "mujoco", 1, 3)
    yield made
    made.close()


def test_the_replay_repeats_every_collected_control_step_and_leaves_no_trace(trainer):
    engine = trainer.env.engine
    replay = Replay(engine)
    trainer.collect()
    replay.start()
    trainer.collect()
    before = {name: value.clone() for name, value in engine.state_dict().items()}
    assert replay.seconds() > 0
    assert len(replay.steps) == trainer.config.horizon
    assert all(torch.equal(value, before[name]) for name, value in engine.state_dict().items())


def test_the_replayed_physics_is_the_collected_physics(trainer):
    """Replaying a step alone must end where the collection ended: same state, inputs and models."""
    engine = trainer.env.engine
    replay = Replay(engine)
    replay.start()
    trainer.collect()
    replay.recording = False
    ends = []
    for step, after in itertools.pairwise(replay.steps):
        engine.replay([step])
        ends.append(abs(engine._states[:, -1, 1:] - after[0][:, 1:]).max(1))
    same = sum(int((end == 0).sum()) for end in ends)
    # All but the worlds that were reset or kicked between two steps.
    assert same > 0.9 * 3 * len(ends)
