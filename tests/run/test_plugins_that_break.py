"""A world or an objective of a plugin that raises, or gives something else, ends a run in one line that names it."""

from __future__ import annotations

import pytest

from hts.contracts import Comparison
from hts.errors import EvaluationError, PluginError
from hts.evaluation.head_to_head import _Measured
from hts.run.ready import _check_reward
from hts.testing.known_world import KnownWorld
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run


def broken(*args, **kwargs):
    raise OSError("link down")


@pytest.mark.parametrize("call", ["collect", "head_to_heads_in_session"])
def test_a_world_that_raises_is_named_with_the_call(tmp_path, monkeypatch, call):
    monkeypatch.setattr(KnownWorld, call, broken)
    with kit_installed(), pytest.raises(PluginError, match=rf"World 'known': {call}\(\) failed, OSError: link down"):
        tiny_run(tmp_path / "run", settings={"selection.block_seconds": 10.0})


def test_a_world_owes_a_recording_for_each_policy(tmp_path, monkeypatch):
    plain = KnownWorld.collect
    monkeypatch.setattr(KnownWorld, "collect", lambda self, *args: plain(self, *args)[:-1])
    with (
        kit_installed(),
        pytest.raises(PluginError, match=r"collect\(\) gave \d+ recordings for \d+ policies; expected"),
    ):
        tiny_run(tmp_path / "run")


def without(plain, left_out):
    """A world's call that gives all but some recordings of the first policy."""

    def call(self, *args):
        first, *others = plain(self, *args)
        return [[one for one in first if not left_out(one)], *others]

    return call


@pytest.mark.parametrize(
    ("left_out", "said"),
    [
        (lambda one: one.schedule.commands[0].vx == 0.8, r"none of the policy at 0\.8"),
        (lambda one: one.role == "reference", r"none of the reference at 0\.5"),
        (lambda one: True, "0 recordings and none of the policy"),
    ],
)
def test_a_world_owes_both_roles_at_every_speed_of_a_trial(run_on, tmp_path, monkeypatch, left_out, said):
    call = "head_to_heads_in_session"
    monkeypatch.setattr(KnownWorld, call, without(getattr(KnownWorld, call), left_out))
    settings = {"selection.block_seconds": 10.0, "selection.speeds": [0.5, 0.8]}
    with pytest.raises(PluginError, match=rf"{call}\(\), policy 1 of \d+ gave .*{said}"):
        run_on("iterations/00/test", tmp_path / "run", settings)


def test_a_world_owes_a_list_for_each_policy_and_a_final_every_speed(tmp_path, monkeypatch):
    plain = KnownWorld.head_to_head
    kept = lambda self, *args: [one for one in plain(self, *args) if one.schedule.commands[0].vx != 0.8]
    with kit_installed():
        with monkeypatch.context() as patch:
            patch.setattr(KnownWorld, "head_to_heads_in_session", lambda self, *args: [])
            with pytest.raises(PluginError, match=r"gave 0 lists of recordings for \d+ policies, expected one each"):
                tiny_run(tmp_path / "lists", settings={"selection.block_seconds": 10.0})
        monkeypatch.setattr(KnownWorld, "head_to_head", kept)
        with pytest.raises(PluginError, match=r"head_to_head\(\) gave .* none of the policy at 0\.8"):
            tiny_run(tmp_path / "final", settings={"evaluation.speeds": [0.5, 0.8], "selection.block_seconds": 10.0})


class Broken:
    name = "heat"

    def __init__(self, compare):
        self.compare = compare


@pytest.mark.parametrize(
    ("compare", "error", "said"),
    [
        (lambda one, other: one["absent"], PluginError, r"Objective 'heat': compare\(\) failed, KeyError"),
        (lambda one, other: {"improvement": 0.1}, PluginError, r"compare\(\) gave dict, expected Comparison"),
        (lambda one, other: 1 / 0, EvaluationError, "Check the idle level and the recordings"),
    ],
)
def test_an_objective_that_cannot_compare_is_named(compare, error, said):
    measured = _Measured(Broken(compare), 0.8, {}, {}, ["x"])
    with pytest.raises(error, match=said):
        measured.compared([1.0], [2.0])


def test_an_objective_that_can_compare_is_left_alone():
    found = Comparison(0.1, 0.1)
    assert _Measured(Broken(lambda one, other: found), 0.8, {}, {}, ["x"]).compared([1.0], [2.0]) is found


@pytest.mark.parametrize(
    ("reward", "said"),
    [
        (lambda prediction: -prediction.mean(), r"reward\(\) gave shape \(\) for a prediction of shape \(1, 2, 1\)"),
        (lambda prediction: absent, r"reward\(\) failed, NameError"),  # noqa: F821
        (lambda prediction: prediction * float("nan"), r"reward\(\) is nan for a prediction of 0.5 standard"),
        (lambda prediction: 0.0, r"reward\(\) gave float"),
        (lambda prediction: -prediction.sqrt(), r"reward\(\) is nan for a prediction of -0.5 standard"),
        (lambda prediction: (prediction > 0).int(), r"reward\(\) gave numbers of torch.int32, expected torch.float32"),
    ],
)
def test_an_objective_whose_reward_is_none_for_each_prediction_is_named_before_anything_runs(reward, said):
    objective = Broken(None)
    objective.reward = reward
    with pytest.raises(PluginError, match=rf"Objective 'heat': {said}"):
        _check_reward("heat", objective)


def test_an_objective_that_cannot_score_is_named(tmp_path, monkeypatch):
    """On the robot's own numbers, after what was made up passed."""
    from hts.testing.examples.objective.objective import Fake

    def score(self, segments):
        if len(segments) == 3:  # the made-up ones
            return {"net": segments.values("fake_level").mean(axis=1)}
        raise ValueError("boom")

    monkeypatch.setattr(Fake, "score", score)
    monkeypatch.setattr(Fake, "compare", lambda self, one, other: Comparison(0.0, 0.0))
    with kit_installed(), pytest.raises(PluginError, match=r"Objective 'fake': score\(\).* failed, ValueError: boom"):
        tiny_run(tmp_path / "run", settings={"selection.block_seconds": 10.0})
