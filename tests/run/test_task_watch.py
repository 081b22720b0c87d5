"""The scale of λ from the first batch, and one line when elites stop doing the task."""

from __future__ import annotations

import math

import pytest

from hts.report.outcome import closing
from hts.run.task_watch import gave_up, gave_up_line, reward_scale, scale_lines
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run


def rows(task: float, measured: float, weights=(0.1, 0.5)):
    first = {"spread/task": task, "spread/effort": measured}
    return [{"id": f"00-{n:02d}", "weights": {"effort": w}, "curve": [first, {}]} for n, w in enumerate(weights)]


def test_both_rewards_weigh_the_same_where_lambda_is_the_ratio_of_their_spreads():
    found = reward_scale(rows(0.12, 1.5), ["effort", "unknown"])
    assert list(found) == ["effort"]
    assert found["effort"]["equal_weight"] == pytest.approx(0.08)
    assert found["effort"]["suggested"] == [0.008, 0.024, 0.08]


def test_a_candidate_that_was_stopped_in_its_first_batch_says_nothing_of_the_scale():
    bad = rows(math.nan, 1.0)[:1]
    assert reward_scale([*bad, *rows(0.3, 1.0)], ["effort"])["effort"]["equal_weight"] == pytest.approx(0.3)
    assert reward_scale(bad, ["effort"]) == {}
    assert reward_scale([{"weights": {"effort": 1.0}, "curve": [{}]}], ["effort"]) == {}


def test_weights_far_above_the_equal_one_are_worth_a_line_and_others_none():
    far, near = rows(0.01, 1.0, (0.5, 5.0)), rows(0.7, 1.0, (0.5, 5.0))
    (line,) = scale_lines(reward_scale(far, ["effort"]), far)
    assert "weigh the same at λ = 0.01; tried: 0.5, 5" in line and "\n" not in line
    assert line.endswith("--set sweep.weights.effort=[0.001,0.003,0.01]")
    assert scale_lines(reward_scale(near, ["effort"]), near) == []


def simulated(**changes):
    return {
        "tracked": {"00-00": True, "00-01": False, "00-02": True},
        "pretrained_tracked": True,
        "task_rewards": {"pretrained": 0.9, "00-00": 0.8, "00-01": 0.1, "00-02": 0.3},
        "trials": {name: [{"mean_speed": 0.05}] for name in ("00-00", "00-01", "00-02")},
        **changes,
    }


ELITES = ["00-00", "00-01", "00-02"]


def test_an_elite_that_leaves_its_task_or_earns_less_than_half_of_its_reward_gave_it_up():
    assert gave_up(ELITES, simulated()) == ["00-01", "00-02"]
    scale = reward_scale(rows(0.12, 1.5), ["effort"])
    line = gave_up_line(ELITES, simulated(), scale, "forward speed", "m/s")
    assert line.startswith("2 of 3 elites stopped doing the task in simulation (00-01: forward speed 0.05 m/s, task ")
    assert "0.1 of the pretrained policy's 0.9 per second" in line and "\n" not in line
    assert "--set sweep.weights.effort=[0.008,0.024,0.08]" in line
    assert gave_up_line(ELITES[:1], simulated(), scale, "forward speed", "m/s") is None


def test_lambda_is_not_blamed_where_the_pretrained_policy_does_not_do_the_task_either():
    assert gave_up(ELITES, simulated(pretrained_tracked=False)) == []


def test_a_task_reward_below_zero_is_no_measure_of_the_task():
    rewards = {"pretrained": -1.0, "00-00": -3.0, "00-01": -3.0, "00-02": -3.0}
    assert gave_up(ELITES, simulated(task_rewards=rewards)) == ["00-01"]


def test_a_run_whose_elites_stop_driving_says_so_once_everywhere(tmp_path, capsys, monkeypatch):
    """The cart is told that its elites stand; the pretrained one drives."""
    from hts.run import judging

    really = judging.trials

    def stood(*given):
        pretrained, *others = really(*given)
        return [pretrained, *([judging.replace(t, mean_speed=0.0, task_reward=0.0) for t in row] for row in others)]

    monkeypatch.setattr(judging, "trials", stood)
    with kit_installed():
        run = tiny_run(tmp_path / "run", settings={"simulation_test.speed_tolerance": 0.5})
    (iteration,) = run.summary["iterations"]
    assert iteration["gave_up"] == ["00-00"]
    (line,) = (one for one in iteration["warnings"] if "stopped doing the task" in one)
    assert "1 of 1 elites stopped doing the task in simulation (00-00: forward speed 0 m/s" in line
    found = iteration["reward_scale"]["fake"]
    assert found["equal_weight"] == pytest.approx(found["task_spread"] / found["measured_spread"])
    said = capsys.readouterr().out
    assert f"iteration 00: {line}" in said and f"Iteration 00: {line}" in closing(run.summary)
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "stopped doing the task" in page and "they weigh the same at λ" in page
