"""The pull that the trials say of: when there is none, how large it is, and who trains and judges under it."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest

from hts.config import EnvConfig, FinetuneConfig, RandomisationConfig, SimulationTestConfig
from hts.contracts import VELOCITY, SimulatedCandidate
from hts.evaluation.simulation import SimulatedTrial, trial_seconds
from hts.evaluation.wandering import Wandered
from hts.run import felt_pull as module
from hts.run.felt_pull import MOST, PROBE, felt_pull, pull_line, pulled
from hts.run.judging import _judge, least_valid, needed
from hts.run.learning import _trained_in
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run

TEST = SimulationTestConfig(speeds=(0.5, 0.8), hold_speed=True, measured_pull=True)


def job(test=TEST, trained=False):
    config = SimpleNamespace(simulation_test=test, finetune=SimpleNamespace(measured_pull=trained))
    walked = [SimpleNamespace(role="reference"), SimpleNamespace(role="policy")]
    return SimpleNamespace(
        config=config,
        read=lambda stage, iteration: {"recordings": [f"{stage} {iteration}"]},
        recordings=lambda ids: walked if ids else [],
        robot=SimpleNamespace(task=lambda: VELOCITY, spec=SimpleNamespace(control_rate_hz=50.0)),
    )


@pytest.fixture
def wandered(monkeypatch):
    """Set what is measured, in how many sessions, and what simulation answers to the probe, W at each speed."""

    def set_to(measured, simulated, sessions=2):
        seen = []
        rows = {speed: Wandered(size, sessions) for speed, size in measured.items()}
        monkeypatch.setattr(module.wandering, "measured", lambda walked, task: seen.append(walked) or rows)
        monkeypatch.setattr(module, "_answer", lambda of: simulated)
        return seen

    return set_to


def test_the_pull_grows_as_the_speed_wanders_and_the_reference_alone_says_it(wandered):
    seen = wandered({0.5: 4e-4, 0.8: 8e-4}, {0.5: 1e-4, 0.8: 2e-4})
    assert felt_pull(job(), 1)["pull"] == pytest.approx([2 * PROBE, 2 * PROBE])
    assert [one.role for one in seen[0]] == ["reference"]


def test_each_speed_is_pulled_half_by_its_own_and_half_by_all(wandered):
    wandered({0.5: 9e-4, 0.8: 1e-4}, {0.5: 1e-4, 0.8: 1e-4})  # ratios 9 and 1, together 5
    assert felt_pull(job(), 1)["pull"] == pytest.approx([PROBE * 7**0.5, PROBE * 3**0.5])


def test_what_was_found_is_said_in_one_line():
    said = pull_line({"pull": [0.34, 0.0]}, (0.5, 0.8))
    assert said.endswith("in m/s²: 0.34 at 0.5 m/s, 0.00 at 0.8 m/s (a slope of 2.0° at most)")


def test_less_than_nothing_is_no_pull_and_there_is_a_most(wandered):
    wandered({0.5: -1e-5}, {0.5: 1e-4, 0.8: 1e-4})
    assert felt_pull(job(), 1)["pull"] == [0.0, 0.0]
    wandered({0.5: 1.0}, {0.5: 1e-4, 0.8: 1e-4})
    assert felt_pull(job(), 1)["pull"] == [MOST, MOST]


def test_speeds_that_were_not_tried_or_not_walked_in_simulation_get_what_the_others_say(wandered):
    wandered({0.5: 1e-4, 1.3: 9.0}, {0.5: 1e-4, 0.8: 1e-4})
    found = felt_pull(job(), 1)
    assert found.pop("pull") == pytest.approx([PROBE, PROBE])
    assert found.pop("steps") == round(50 * trial_seconds(TEST)) * TEST.num_envs * 2
    assert found == {"measured": {"0.5": 1e-4}, "simulated": {"0.5": 1e-4}, "sessions": {"0.5": 2}}
    wandered({0.5: 1e-4, 0.8: 5.0}, {0.5: 1e-4, 0.8: float("nan")})
    assert felt_pull(job(), 1)["pull"] == pytest.approx([PROBE, PROBE])


@pytest.mark.parametrize(
    "settings", [{"measured_pull": False}, {"hold_speed": False}], ids=["not asked for", "nothing held"]
)
def test_there_is_none_where_nothing_asks_for_it(wandered, settings):
    wandered({0.5: 1e-4}, {0.5: 1e-4, 0.8: 1e-4})
    assert felt_pull(job(TEST.model_copy(update=settings)), 1) is None


def test_there_is_none_before_trials_and_in_an_env_without_pulls(wandered):
    wandered({}, {0.5: 1e-4, 0.8: 1e-4})
    assert felt_pull(job(), 0) is None
    wandered({0.5: 1e-4}, {0.5: 1e-9, 0.8: 1e-9})
    assert felt_pull(job(), 1) is None


def test_training_takes_what_was_measured_in_turns_and_no_less_than_what_is_configured():
    config = FinetuneConfig(env=EnvConfig(randomisation=RandomisationConfig(pull=0.1)), measured_pull=True)
    assert _trained_in(config, {"pull": [0.3, 0.05]}).env.randomisation.pull == (0.3, 0.1)
    assert _trained_in(config, None) is config
    alone = config.model_copy(update={"measured_pull": False})
    assert _trained_in(alone, {"pull": [0.3]}) is alone


def test_an_env_is_pulled_slowly_and_else_as_it_was():
    env = pulled(EnvConfig(), (0.3, 0.1))
    assert (env.randomisation.pull, env.randomisation.pull_seconds) == ((0.3, 0.1), module.SECONDS)
    assert env.randomisation.friction == EnvConfig().randomisation.friction and env.commands == EnvConfig().commands


def trials(*valid):
    return [SimulatedTrial(speed, 4, 0, speed, share) for speed, share in zip((0.5, 0.8), valid, strict=True)]


def test_who_holds_its_speed_in_too_few_seconds_comes_after_those_that_do():
    row = {"id": "00-00", "stopped": None}
    judged = [_judge(row, trials(*valid), 0.1, share=0.7) for valid in ((0.7, 0.9), (0.69, 1.0))]
    assert [one.tracked for one in judged] == [True, False]
    assert isinstance(judged[0], SimulatedCandidate)


def test_where_nobody_does_the_steadiest_is_enough():
    walks = {"a": trials(0.9, 0.55), "b": trials(0.6, 0.65), "c": trials(0.9, 0.75)}
    rows = [{"id": name, "stopped": None} for name in walks]
    reached = {name: least_valid(walked) for name, walked in walks.items()}
    assert needed(0.7, rows[:2], reached) == 0.6
    assert needed(0.7, rows[2:], reached) == 0.7 and needed(0.7, [], reached) == 0.0
    stopped = {"id": "c", "stopped": "it was stopped"}
    assert needed(0.7, [*rows[:2], stopped], reached) == 0.6, "who stands at its anchor is steady, and nobody to try"


def test_a_run_whose_env_knows_no_pulls_goes_on_without_one(tmp_path):
    held = {"evaluation.hold_speed": True, "simulation_test.measured_pull": True, "iterations": 2}
    with kit_installed():
        run = tiny_run(tmp_path / "run", settings=held)
    tuned = json.loads((run.folder / "iterations/01/finetune.json").read_text())
    assert "pull" not in tuned and run.summary["final"]["objectives"]


def test_the_shipped_policy_wanders_under_the_probe_and_not_without(monkeypatch):
    pytest.importorskip("hts_go1", reason="the robot of this test is not installed")
    from hts.policies.files import load_policy
    from hts_go1.robot import Go1, Go1Settings

    robot = Go1(Go1Settings())
    finetune = FinetuneConfig(env=EnvConfig(randomisation=RandomisationConfig(models=2)))
    test = TEST.model_copy(update={"num_envs": 4, "seconds": 6.0, "speeds": (0.8,)})
    real = SimpleNamespace(
        config=SimpleNamespace(finetune=finetune, simulation_test=test, engine="mujoco"),
        seed=lambda *what: 1,
        robot=robot,
        policy=lambda name: load_policy(robot.pretrained_policy(), robot.spec),
    )
    answer = module._answer(real)[0.8]
    monkeypatch.setattr(module, "pulled", lambda config, pull: config)
    still = module._answer(real)[0.8]
    assert answer > 5 * still and answer > module.LEAST_ANSWER
