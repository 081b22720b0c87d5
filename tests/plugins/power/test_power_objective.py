"""The objective `power`: its reward, its score, what a candidate counts with, its analytic stand-in."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from hts.channels import Channel
from hts.config import Command, EvaluationConfig, ScheduleConfig
from hts.config_loading import load_config
from hts.errors import EvaluationError
from hts.evaluation.head_to_head import HeadToHead, compare
from hts.evaluation.predicted import pieces, predicted_comparison
from hts.evaluation.segments import cut
from hts.recordings.recording import Recording, Series
from hts_power import plugin
from hts_power.objective import Power, PowerSettings
from hts_power.proxy import analytic_power


def recording(current, voltage, speed: float, seconds: int = 4) -> Recording:
    """A robot of 10 kg at a constant speed, idle at 2 A and 15 V."""
    count = 50 * seconds
    base = np.zeros((count, 3))
    base[:, 0] = speed
    series = {
        "base_velocity": Series(Channel("base_velocity", "m/s", (3,)), base),
        "battery_current": Series(Channel("battery_current", "A"), np.resize(current, count)),
        "battery_voltage": Series(Channel("battery_voltage", "V"), np.resize(voltage, count)),
    }
    return Recording(
        robot="r",
        world="w",
        policy_hash="p",
        iteration=0,
        joint_names=(),
        kp=(),
        kd=(),
        rate_hz=50.0,
        schedule=ScheduleConfig(commands=(Command(seconds=seconds, vx=0.8),)),
        idle={"battery_current": 2.0, "battery_voltage": 15.0},
        clock="simulated",
        time=np.arange(count) / 50,
        channels=series,
        mass_kg=10.0,
    )


def test_net_power_is_mean_electrical_power_minus_idle():
    score = Power().score(cut([recording([4.0, 6.0], [20.0, 20.0], 0.8)]))
    assert score["gross_power"] == pytest.approx([100.0, 100.0])  # (4·20 + 6·20)/2
    assert score["net_power"] == pytest.approx([70.0, 70.0])  # less 2 A · 15 V


def test_power_is_the_mean_of_the_product_not_the_product_of_means():
    score = Power().score(cut([recording([4.0, 6.0], [20.0, 10.0], 0.8)]))
    assert score["gross_power"] == pytest.approx([70.0, 70.0])  # (80 + 60)/2, not 5·15 = 75


def test_cost_of_transport_is_net_energy_per_metre_and_newton():
    score = Power().score(cut([recording([5.0], [20.0], 0.75)]))
    assert score["cost_of_transport"] == pytest.approx([70.0 / (10.0 * 9.81 * 0.75)] * 2)


def test_the_voltage_that_goes_with_a_current_is_on_the_line_through_the_means_of_whole_seconds():
    def log(current, voltage) -> Recording:
        series = {"battery_current": ("A", current), "battery_voltage": ("V", voltage)}
        channels = {name: Series(Channel(name, unit), np.array(values)) for name, (unit, values) in series.items()}
        return replace(recording(1.0, 1.0, 0.8), rate_hz=2.0, time=np.arange(len(current)) / 2, channels=channels)

    # Seconds of 2 A at 24 V and 2.5 A at 23.95 V, and half a second more; another recording of 3 A at 23.9 V.
    known = [log([1.0, 3.0, 2.5, 2.5, 90.0], [24.0, 24.0, 24.05, 23.85, 1.0]), log([3.0, 3.0], [23.8, 24.0])]
    found = Power().predicted_channels(np.array([2.0, 5.0]), known)
    assert found["battery_current"].tolist() == [2.0, 5.0]
    assert found["battery_voltage"] == pytest.approx([24.0, 23.7])  # 0.1 V less for each ampere
    assert Power().predicted_channels(np.array([9.0]), known[1:])["battery_voltage"] == pytest.approx([23.9])


def head_to_head(policy: float, reference: float, idle: float, scatter: float = 0.0) -> HeadToHead:
    """A-B-B-A at mean powers, W; scatter: standard deviation from second to second, W."""
    rng = np.random.default_rng(0)
    blocks = []
    for block, role in enumerate(("policy", "reference", "reference", "policy")):
        watts = {"policy": policy, "reference": reference}[role] + scatter * rng.standard_normal(12)
        made = recording(np.repeat(watts, 50) / 20.0, [20.0], 0.8, seconds=12)
        levels = {"battery_current": idle / 20.0, "battery_voltage": 20.0}
        blocks.append(replace(made, role=role, block=block, session="s", policy_hash=f"{role}-hash", idle=levels))
    return compare(Power(), blocks, EvaluationConfig())


@pytest.mark.parametrize(
    ("policy", "reference", "idle", "said"),
    [
        (60.0, 100.0, 80.0, "The policy policy-h drew 60.0 W in the mean and its recordings say 80.0 W idle, -20.0 W"),
        (130.0, 80.0, 120.0, "The reference referenc drew 80.0 W .* 120.0 W idle, -40.0 W net"),
        (100.0, 80.0, 120.0, "motors idle .the robot lying down, motors unpowered."),
        (100.0, 80.0, 80.0, "80.0 W idle, 0.0 W net: expected more than 0 W"),
    ],
)
def test_an_idle_level_above_what_walking_draws_is_refused_as_it_turns_the_sign(policy, reference, idle, said):
    with pytest.raises(EvaluationError, match=said) as caught:
        head_to_head(policy, reference, idle)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("level", [0.0, 2.0, 200.0])
def test_an_idle_voltage_that_is_no_packs_is_refused(level):
    idle = {"battery_current": 1.3, "battery_voltage": level}
    walked = replace(recording([5.0], [20.0], 0.8), idle=idle)
    with pytest.raises(EvaluationError, match=f"battery_voltage is {level:g} V idle, and it was 20 V in the mean"):
        Power().score(cut([walked]))


def test_seconds_below_idle_are_noise_where_the_mean_is_above():
    """Of 10 ± 60 W net many a second, and many a draw of the interval, is below 0."""
    found = head_to_head(92.0, 100.0, 90.0, scatter=60.0)
    assert (found.reference_scores["net_power"] < 0).any() and found.reference_scores["net_power"].mean() > 0
    assert found.improvement_ci95 is not None


def test_what_a_model_predicts_below_idle_is_no_mistake_of_the_idle_level():
    data = [recording([4.0, 6.0], [20.0, 20.0], 0.8)]
    pieces_of = lambda level: pieces(Power(), np.full((3, 50), level), np.full(3, 0.8), 0.8, data)
    assert predicted_comparison(Power(), pieces_of(1.0), pieces_of(5.0)).improvement > 1.0


def comparison(settings: PowerSettings):
    reference = {"gross_power": 100.0, "net_power": 80.0, "cost_of_transport": 1.0}
    return Power(settings).compare({"gross_power": 80.0, "net_power": 60.0, "cost_of_transport": 0.9}, reference)


def test_savings_are_fractions_of_the_reference():
    metrics = comparison(PowerSettings()).metrics
    assert metrics == pytest.approx({"net_reduction": 0.25, "gross_reduction": 0.2, "cost_of_transport_reduction": 0.1})


def test_a_candidate_counts_with_the_smaller_saving_unless_net_is_chosen():
    smaller, net = comparison(PowerSettings()), comparison(PowerSettings(criterion="net"))
    assert smaller.improvement == net.improvement == pytest.approx(0.25)
    assert smaller.selection_score == pytest.approx(0.1)
    assert net.selection_score == pytest.approx(0.25)


def test_less_current_is_more_reward():
    assert Power().reward(torch.tensor([[2.0], [-0.5]])).tolist() == [[-2.0], [0.5]]


def test_the_proxy_adds_mechanical_power_and_copper_loss_and_clips_each_joint_at_zero():
    torque, velocity = torch.tensor([[2.0, 10.0, 1.0]]), torch.tensor([[3.0, 0.0, -5.0]])
    # 2·3 + 0.3·4 = 7.2; 0.3·100 = 30; 1·(−5) + 0.3 < 0 -> 0
    assert analytic_power(torque, velocity).tolist() == pytest.approx([37.2])
    assert Power().proxy({"joint_torque": torque, "joint_velocity": velocity}).tolist() == pytest.approx([37.2])


def test_its_own_weights_are_worth_the_same_behind_every_gauge():
    """Net current is 3 A in both; one gauge averages, the other shows every swing."""
    power = Power(PowerSettings(net_weights=(9.0, 18.0)))
    assert power.weights == (3.0, 6.0)
    for low, high, spread in ((4.0, 6.0, 1.0), (3.0, 7.0, 2.0)):
        data = [recording([low, high], [20.0, 20.0], 0.8), replace(recording([2.5], [20.0], 0.8), role="policy")]
        assert power.weights_for(spread, data) == pytest.approx((9 * spread / 3, 18 * spread / 3))


def test_weights_that_are_given_stay_and_without_an_idle_level_there_is_no_net_current():
    data = [recording([4.0, 6.0], [20.0, 20.0], 0.8)]
    assert Power(PowerSettings(weights=(0.5, 1.0))).weights_for(0.1, data) == (0.5, 1.0)
    unknown, resting = replace(data[0], idle={}), replace(data[0], idle={"battery_current": 5.0})
    for one in (unknown, resting):
        assert Power().weights_for(0.1, [one]) == Power().weights == (3.0,)


@pytest.mark.parametrize("value", [-9.0, float("nan"), float("inf")])
@pytest.mark.parametrize("key", ["weights", "net_weights"])
def test_weights_that_are_none_are_refused_before_anything_is_spent(key: str, value: float) -> None:
    with pytest.raises(ValidationError, match=key):
        PowerSettings.model_validate({key: [1.0, value]})


def test_a_configuration_written_and_read_again_asks_the_data_again():
    settings = PowerSettings()
    assert PowerSettings.model_validate(settings.model_dump(mode="json")) == settings
    assert settings.weights is None


def test_the_sweeps_are_those_of_the_paper():
    exact = plugin.PRESETS["paper-exact"]
    assert exact["weights"] == [0.5, 1.0, 5.0] and exact["baseline_weights"] == [5e-5, 1e-4, 5e-4, 1e-3, 5e-3]
    plugin.make_power({key: value for key, value in exact.items() if key != "model"})


@pytest.mark.parametrize("preset", ["quick", "paper"])
def test_the_baseline_has_as_many_steps_and_tests_as_the_method(preset: str) -> None:
    method, baseline = (
        load_config(objectives=["power"], robot="go1", preset=preset, baseline=baseline) for baseline in (False, True)
    )
    assert baseline.iterations * baseline.selection.elites == method.iterations * method.selection.elites
    power = Power(PowerSettings(**plugin.PRESETS.get(preset, {})))
    trained = [
        config.iterations * len(weights) * len(config.sweep.kl_bounds) * config.finetune.steps
        for config, weights in ((method, power.weights), (baseline, power.baseline_weights))
    ]
    assert trained[1] == pytest.approx(trained[0], rel=0.01)


def test_settings_reach_the_measurement_model_and_wrong_ones_are_refused():
    choice = plugin.make_power({"hidden": 32, "products": False}).measurement_model()
    assert (choice.name, choice.settings) == ("battery_current", {"hidden": 32, "products": False})
    choice = plugin.make_power({"joule_coefficient": 0.1}).measurement_model()
    assert (choice.name, choice.settings) == ("drive_train", {"joule_coefficient": 0.1})
    with pytest.raises(ValidationError, match="criterion"):
        plugin.make_power({"criterion": "gross"})
    with pytest.raises(ValidationError, match="hiden"):
        plugin.make_power({"hiden": 32})


def test_importing_the_plugin_does_not_import_torch():
    code = "import sys, hts_power.plugin; assert 'torch' not in sys.modules and 'mujoco' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_plugin_offers_what_it_says():
    offered = {}
    for hook in (plugin.hts_objectives, plugin.hts_measurement_models, plugin.hts_instruments, plugin.hts_commands):
        hook(register=lambda name, factory, **presets: offered.update({name: factory}))
    assert sorted(offered) == ["battery_current", "battery_gauge", "calibrate-twin", "drive_train", "power"]
    objective = offered["power"]({})
    assert objective.instrument in offered and objective.measurement_model().name in offered
    assert objective.target.unit == "A"


def test_made_up_numbers_before_a_run_are_none_that_power_refuses():
    from hts.plugins import load
    from hts.run.score_check import check_score, gain_of_less

    robot, objective = load().make_robot("go1"), load().make_objective("power")
    assert set(check_score(objective, robot, "hard-to-sim-power").metrics) >= {"gross_reduction"}
    assert gain_of_less(objective, robot) > 0
