"""The benches say what they measured; how fast it was is not a test's business."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
import torch

pytest.importorskip("hts_go1", reason="a bench needs an installed robot with a model")
pytest.importorskip("hts_power", reason="a bench needs an installed objective")

from hts.bench import Sizes, bench_env, bench_fit, bench_sweep, bench_train
from hts.bench.bare import Replay, engines_of
from hts.bench.setup import find, make_population, make_trainer, new_model, size
from hts.bench.sweeping import same_results
from hts.errors import ConfigError

RATES = ("steps_per_s", "bare_steps_per_s", "ratio")


def test_a_robot_that_has_only_its_model_is_told_how_to_get_a_policy(monkeypatch):
    robot, _ = find("go1", "power")
    monkeypatch.setattr(type(robot), "pretrained_policy", lambda self: None)
    with pytest.raises(ConfigError, match=r"'go1' has no pretrained policy to collect with.*`hts pretrain --robot go1"):
        find("go1", "power")


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
    result = bench_sweep("go1", "power", envs=2, seconds=0.1, alone=(2,))
    assert result["candidates"] == 6
    assert result["steps_per_s"] > 0 and result["one_after_another_steps_per_s"] > 0 and result["speedup"] > 0


@pytest.fixture(scope="module")
def several():
    """Three candidates, in whole trainings too."""
    return bench_sweep("go1", "power", envs=2, seconds=0.1, candidates=3, alone=(2, 4), whole=100)


def test_sweep_takes_the_number_of_candidates_and_finds_the_fastest_for_one_alone(several):
    assert several["candidates"] == 3
    assert set(several["alone_steps_per_s"]) == {"2", "4"}
    fastest = several["alone_steps_per_s"][str(several["fastest_alone_envs"])]
    assert fastest == max(several["alone_steps_per_s"].values())
    assert several["speedup_over_fastest"] == pytest.approx(several["steps_per_s"] / fastest)


def test_a_candidate_learns_the_same_alone_and_in_the_crowd():
    machine, objective = find("go1", "power")
    found = same_results(machine, objective, "mujoco", candidates=3, envs=3)
    assert found == {"update_difference": 0.0, "repeat_difference": 0.0}


def test_whole_trainings_count_everything_from_nothing_to_the_last_batch(several):
    assert several["together_batches"] == 3  # 100 steps in batches of 2 x 24
    assert several["one_after_another_batches"] == {2: 3, 4: 2}[several["fastest_alone_envs"]]
    for name in ("together", "one_after_another"):
        assert 0 < several[f"{name}_first_batch_s"] < several[f"{name}_s"]


def test_the_engine_that_ran_is_reported():
    result = bench_train("go1", "power", engine="auto", candidates=1, envs=2, seconds=0.1, sizes=Sizes(device="cpu"))
    assert result["engine"] == "mujoco"


def test_larger_networks_act_like_the_shipped_policy():
    machine, _ = find("go1", "power")
    shipped = make_population(machine, 1)
    observation = torch.randn(1, 64, 45, generator=torch.Generator().manual_seed(0))
    critic_observation = torch.randn(1, 64, 53, generator=torch.Generator().manual_seed(1))
    for hidden in ((512, 256, 128), (256, 256), (300, 128, 128, 130)):
        larger = make_population(machine, 1, hidden)
        assert larger.sizes.hidden == hidden
        torch.testing.assert_close(larger.mean(observation), shipped.mean(observation), atol=1e-4, rtol=1e-4)
        value = larger.value(critic_observation)
        torch.testing.assert_close(value, shipped.value(critic_observation), atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("hidden", [(128, 128), (512,), (512, 64)])
def test_narrower_networks_are_refused(hidden):
    machine, _ = find("go1", "power")
    with pytest.raises(ConfigError, match="none narrower"):
        make_population(machine, 1, hidden)


def test_the_size_of_the_measurement_model_can_be_chosen():
    machine, objective = find("go1", "power")
    assert new_model(objective, machine, 128).settings["hidden"] == 128


@pytest.mark.parametrize("text", ["512,256", "512-", "big", "0-128", "51²"])
def test_hidden_layers_that_are_no_numbers_are_refused(text, capsys):
    from hts.cli.main import main

    assert main(["bench", "train", "--hidden", text]) == 2
    assert "512-256-128" in capsys.readouterr().err


def test_fit_counts_samples_times_epochs():
    result = bench_fit("go1", "power", seconds=0.1)
    assert result["samples"] == 5 * 60 * 50  # five recordings of a minute at 50 Hz
    assert result["samples_per_s"] == pytest.approx(result["samples"] * result["epochs"] / result["seconds"])


def test_fit_takes_samples_and_epochs_and_reads_them_from_a_store():
    result = bench_fit("go1", "power", samples=6000, epochs=2)
    assert (result["samples"], result["epochs"], result["recordings_read"]) == (6000, 2, 2)
    assert result["read_seconds"] > 0 and result["name_seconds"] > 0
    # time (8 bytes) and at least torque and velocity of 12 joints and the target, in single precision
    assert result["store_megabytes"] * 1e6 > 6000 * (8 + 4 * 25)


def test_without_names_the_largest_measurement_model_is_in_the_loop():
    _, largest = find(None, None)
    _, other = find(None, "noise")
    robot, _ = find(None, None)
    assert size(new_model(largest, robot)) >= size(new_model(other, robot))


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
    replay = Replay([engine])
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
    replay = Replay([engine])
    replay.start()
    trainer.collect()
    replay.seconds()
    ends = []
    for step, after in itertools.pairwise(replay.steps):
        engine.replay([step])
        ends.append(abs(engine._states[:, -1, 1:] - after[0][:, 1:]).max(1))
    same = sum(int((end == 0).sum()) for end in ends)
    # All but the worlds that were reset or pushed between two steps.
    assert same > 0.9 * 3 * len(ends)


def test_engines_of_groups_are_replayed_as_one_engine_of_all_worlds():
    machine, objective = find("go1", "power")
    made = make_trainer(machine, objective, "mujoco", 3, 2)
    engines = engines_of(made.env)
    replay = Replay(engines)
    replay.start()
    made.collect()
    assert replay.seconds() > 0 and replay.overhead > 0
    states, inputs = replay.steps[-1]
    assert len(replay.steps) == made.config.horizon and states.shape[0] == inputs.shape[0] == 6
    assert replay.engine.num_worlds == 6 and replay.engine.threads == engines[0].threads
    ends = np.concatenate([engine._states[:, -1] for engine in engines])
    assert np.array_equal(replay.engine._states[:, -1], ends)  # the last step that was taken, again
    made.close()
