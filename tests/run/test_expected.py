"""What saving to expect from runs on several realities, and predicted against measured."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hts.atomic import atomic_write
from hts.config_loading import dump_config, load_config
from hts.errors import RunError
from hts.run import with_engine
from hts.run.expected import compared, expect, pooled, prediction, shown, shown_compared


def summary(*improvements, policy="00-01", speeds=(0.5, 0.8), samples=1000):
    """Of a run that saved so much at each speed; None: refused there."""
    found = {
        f"{speed:g}": {"improvement": value, "improvement_ci95": [value - 0.01, value + 0.01]}
        for speed, value in zip(speeds, improvements, strict=True)
        if value is not None
    }
    return {
        "objectives": ["power"],
        "robot": "go1",
        "preset": "smoke",
        "engine": "mujoco",
        "seed": 7,
        "iterations": [],
        "front": {"units": {"power": "1"}},
        "real_samples": samples,
        "world_identity": {"reality": "x", "reality_sha256": "ab"},
        "final": {"policy": policy, "objectives": {"power": {"unit": "1", "speeds": found}}},
    }


def nothing_better():
    return {**summary(None, None, policy="pretrained"), "final": {"policy": "pretrained", "objectives": {}}}


def test_the_interval_is_for_the_next_value():
    # m = 0.2, s = 0.1 over three: t_2 = 4.303, 4.303 x 0.1 x sqrt(4/3) = 0.4968
    found = prediction([0.1, 0.2, 0.3])
    assert found["mean"] == pytest.approx(0.2)
    assert found["interval95"] == pytest.approx([0.2 - 0.4968, 0.2 + 0.4968], abs=1e-3)
    assert found["quantiles"]["0.5"] == pytest.approx(0.2)
    assert prediction([0.1])["interval95"] is None and (prediction([])["runs"], prediction([])["mean"]) == (0, None)


def test_it_holds_the_next_value_in_95_of_100_cases():
    rng = np.random.default_rng(5)
    held = 0
    for values in rng.normal(0.2, 0.05, (2000, 5)):
        low, high = prediction(values[:4])["interval95"]
        held += low <= values[4] <= high
    assert held / 2000 == pytest.approx(0.95, abs=0.015)


def test_draws_that_weigh_more_count_more_and_are_worth_fewer():
    equal, plain = prediction([0.1, 0.2, 0.3], [2.0, 2.0, 2.0]), prediction([0.1, 0.2, 0.3])
    assert equal["mean"] == pytest.approx(plain["mean"]) and equal["worth"] == pytest.approx(3)
    assert equal["interval95"] == pytest.approx(plain["interval95"])
    found = prediction([0.1, 0.2, 0.2], [0.5, 0.25, 0.25])
    assert found["mean"] == pytest.approx(0.15) and found["worth"] == pytest.approx(1 / (1 / 4 + 2 / 16))
    # s² = 0.05² n / (n - 1) = 0.004, n = 8/3: wider than the 4.303 of two degrees of freedom gives
    low, high = found["interval95"]
    assert (low + high) / 2 == pytest.approx(0.15)
    assert high - 0.15 > 4.303 * np.sqrt(0.004 * (1 + 3 / 8))
    assert prediction([0.1, 0.2], [1.0, 0.0])["interval95"] is None


@pytest.fixture
def configs():
    """Two runs that only differ in their reality."""
    made = {}
    for name in ("dev-00", "dev-01"):
        made[name] = load_config(
            objectives=["power"],
            robot="go1",
            preset="smoke",
            engine="mujoco",
            overrides=[f"world.reality={name}", "evaluation.speeds=[0.5,0.8]"],
        )
    return made


def stand_in(results, asked):
    """Instead of a run: its configuration and a summary."""

    def run(config, folder):
        asked.append(folder.name)
        folder.mkdir(parents=True, exist_ok=True)
        atomic_write(folder / "config.yaml", dump_config(config))
        atomic_write(folder / "summary.json", json.dumps(results[folder.name]))

    return run


def test_runs_are_pooled_and_a_run_that_found_nobody_saved_nothing(tmp_path, configs):
    asked = []
    results = {"dev-00": summary(0.2, None), "dev-01": nothing_better()}
    found = expect(configs, tmp_path, lambda line: None, stand_in(results, asked))
    assert asked == ["dev-00", "dev-01"]
    speeds = found["expected"]["power"]["speeds"]
    assert speeds["0.5"]["mean"] == pytest.approx(0.1) and speeds["0.5"]["runs"] == 2
    assert (speeds["0.8"]["runs"], speeds["0.8"]["refused"]) == (1, 1)
    assert json.loads((tmp_path / "expected.json").read_text())["expected"]["power"]["speeds"]["0.5"]["runs"] == 2
    lines = shown(found)
    assert "power at 0.5 m/s: 10.0 %" in lines[1] and "from 2 runs" in lines[1] and "refused in 1" in lines[2]


def test_weights_of_draws_come_into_what_is_expected(tmp_path, configs):
    results = {"dev-00": summary(0.2, 0.2), "dev-01": summary(0.1, 0.1)}
    weights = {"dev-00": 0.75, "dev-01": 0.25, "not run": 0.5}
    found = expect(configs, tmp_path, lambda line: None, stand_in(results, []), weights)
    assert found["expected"]["power"]["speeds"]["0.5"]["mean"] == pytest.approx(0.175)
    assert [row["weight"] for row in found["runs"]] == [0.75, 0.25]


def test_a_finished_run_is_not_done_again_and_another_one_is_refused(tmp_path, configs):
    asked = []
    run = stand_in({name: summary(0.1, 0.2) for name in configs}, asked)
    first = expect(configs, tmp_path, lambda line: None, run)

    def never(config, folder):
        assert (folder / "summary.json").exists()

    assert expect(configs, tmp_path, lambda line: None, never) == first
    others = {name: with_engine(one).model_copy(update={"seed": 7}) for name, one in configs.items()}
    with pytest.raises(RunError, match="dev-00: holds a run with other settings"):
        expect(others, tmp_path, lambda line: None, run)


def test_predicted_against_measured_says_whether_it_lay_inside():
    rows = [{"objectives": {"power": {"unit": "1", "speeds": {"0.5": v, "0.8": v}}}} for v in (0.10, 0.12, 0.14)]
    expected = {"expected": pooled(rows)}
    inside, outside = compared(expected, summary(0.13, 0.5))
    assert inside["inside"] is True and inside["error"] == pytest.approx(0.01)
    assert outside["inside"] is False and outside["measured_ci95"] == [0.49, 0.51]
    assert "OUTSIDE" in shown_compared([outside])[1]
    assert [row["measured"] for row in compared(expected, nothing_better())] == [0.0, 0.0]
    with pytest.raises(RunError, match="Nothing to compare"):
        compared(expected, summary(0.1, 0.1, speeds=(0.3, 0.4)))
