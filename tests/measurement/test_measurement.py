"""Fitting a measurement model, and the checks that say how far it can be trusted."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import torch

from hts.channels import Channel
from hts.config import Command, MeasurementConfig, ScheduleConfig
from hts.errors import RecordingError
from hts.measurement import checks, fit_command, fit_report
from hts.measurement.baseline import check_proxy, fit_proxy, shifted
from hts.measurement.data import input_tensor
from hts.measurement.lstm import LSTM, LSTMSettings
from hts.measurement.scoring import Trace, calibration, commanded_speed, policy_costs, r2, r2_interval, spearman
from hts.measurement.split import split
from hts.recordings.recording import Recording, Series
from hts.testing.known_signals import HEAT, SIGNALS, KnownHeat
from hts.testing.known_signals import known_heat as recording

NEWTONS = Channel("effort", "N", (3,))
SMALL = LSTMSettings(hidden=16, products=True, stream=250, batch=4)


def fit(recordings, config=SMALL, **how):
    """A fitted LSTM and its report."""
    model = LSTM(config, SIGNALS)
    return model, model.fit(recordings, **how)


@pytest.fixture(scope="module")
def fitted():
    training = [recording(seed, policy) for seed, policy in ((1, "a"), (2, "a"), (3, "b"))]
    return fit(training, epochs=15, seed=3)[0], training


def inputs_of(r: Recording) -> torch.Tensor:
    return input_tensor(SIGNALS, r)


def copy_of(model: LSTM) -> LSTM:
    copy = LSTM(model.config, model.signals)
    copy.load_tensors(model.tensors())
    return copy


def test_new_statistics_leave_a_fitted_model_the_same_function(fitted):
    model = copy_of(fitted[0])
    data = inputs_of(recording(1))
    before = model.denormalise(model.sequence(data[None])[0].mean)
    model.set_statistics(3.0 * data + 1.0, 40.0 + 7.0 * data[:, 0])
    assert model.target_mean == pytest.approx(40.0 + 7.0 * float(data[:, 0].mean()), rel=1e-4)
    torch.testing.assert_close(model.denormalise(model.sequence(data[None])[0].mean), before, atol=2e-3, rtol=1e-3)


# ------------------------------------------------------------------------------------------------- fitting


def test_a_filtered_and_delayed_product_is_learned_and_predicted_for_a_new_policy(fitted):
    model, training = fitted
    new = [recording(50, "stranger", gait=1.15), recording(51, "stranger", gait=0.9)]
    report = checks.check(KnownHeat(), model, new, training)
    assert report["r2"] > 0.9
    assert report["r2_policies"] == report["r2"]
    assert report["proxy"]["plain"]["r2"] < report["r2"]


def test_the_same_seed_gives_the_same_model_and_another_seed_another():
    data = [recording(1, seconds=8.0)]
    first, again, other = (fit(data, epochs=1, seed=seed)[0].tensors() for seed in (0, 0, 1))
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not torch.equal(first["head.weight"], other["head.weight"])


def test_fitting_leaves_the_number_of_threads_as_it_was():
    before = torch.get_num_threads()
    fit([recording(1, seconds=4.0)], epochs=1)
    assert torch.get_num_threads() == before


def test_a_warm_start_begins_better_than_a_cold_one(fitted):
    data = [recording(7, "c", seconds=10.0)]
    _, cold = fit(data, epochs=1)
    _, warm = fit(data, epochs=1, warm_start=fitted[0])
    assert warm["warm_started"] and not cold["warm_started"]
    assert warm["curve"][0]["validation"] < cold["curve"][0]["validation"]


def test_a_model_of_another_shape_is_no_warm_start(fitted):
    other = SMALL.model_copy(update={"hidden": 8})
    assert not fit([recording(1, seconds=4.0)], other, epochs=1, warm_start=fitted[0])[1]["warm_started"]


def test_time_running_out_ends_the_fit_after_the_epoch_and_says_so():
    _, report = fit([recording(1, seconds=4.0)], epochs=50, max_seconds=1e-9)
    assert (report["epochs"], report["stopped"]) == (1, "time")


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        (lambda r: [], "No recordings"),
        (lambda r: [r, r.replace(rate_hz=100.0)], "100 Hz"),
        (lambda r: [r, r.replace(joint_names=("x", "z", "y"))], "joint order"),
        (
            lambda r: [r.replace(channels={**r.channels, "heat": Series(HEAT, np.full(200, 3.0))})],
            "3 in all 200 samples",
        ),
        (lambda r: [r.replace(channels={**r.channels, "heat": Series(HEAT, np.full(200, np.nan))})], "not finite"),
        (
            lambda r: [r.replace(channels={n: s for n, s in r.channels.items() if n != "rate"})],
            "No channel named 'rate'",
        ),
        (
            lambda r: [r, r.replace(channels={**r.channels, "effort": Series(NEWTONS, r.values("effort"))})],
            "'effort' is in N, the model reads N.m",
        ),
    ],
)
def test_recordings_that_cannot_be_learned_from_are_refused_in_one_line(broken, said):
    with pytest.raises(RecordingError, match=said):
        fit(broken(recording(1, seconds=4.0)), epochs=1)


# -------------------------------------------------------------------------------------------------- checks


def test_r2_is_the_share_of_variance_explained():
    assert r2(np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0, 3.0])) == 1.0
    assert r2(np.array([1.0, 2.0, 3.0]), np.array([2.0, 2.0, 2.0])) == 0.0
    assert r2(np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0, 4.0])) == 0.5
    assert r2(np.array([2.0, 2.0]), np.array([2.0, 2.0])) is None
    assert r2(np.full(3, 0.1), np.zeros(3)) is None  # their mean is 0.1 and a rounding error
    assert r2(1e5 + np.array([0.0, 1.0]), 1e5 + np.array([0.0, 1.0])) == 1.0


def test_rank_correlation_is_of_ranks_and_null_for_one_policy():
    assert spearman([1.0, 2.0, 30.0], [5.0, 6.0, 7.0]) == pytest.approx(1.0)
    assert spearman([1.0, 2.0, 3.0], [3.0, 2.0, 1.0]) == pytest.approx(-1.0)
    assert spearman([1.0], [1.0]) is None
    # Ranks 1, 2.5, 2.5, 4 and 1, 2, 3, 4: 4.5 of the root of 4.5 times 5.
    assert spearman([0.0, 1.0, 1.0, 7.0], [1.0, 2.0, 3.0, 4.0]) == pytest.approx(math.sqrt(0.9))
    assert math.isnan(spearman([1.0, math.nan], [1.0, 2.0]))


def test_policies_are_ranked_at_the_speed_most_of_them_share():
    def trace(policy, speed, measured, predicted):
        r = recording(1, policy, seconds=2.0, speed=speed)
        return Trace(r, np.full(50, measured), np.full(50, predicted))

    costs = policy_costs(
        [
            trace("a", 0.8, 3.0, 2.0),
            trace("b", 0.8, 1.0, 1.0),
            trace("a", 1.1, 9.0, 9.0),
            trace("b", 0.8, 2.0, 3.0),
        ]
    )
    assert [(c.policy, c.speed, c.measured, c.predicted, c.samples) for c in costs] == [
        ("b", 0.8, 1.5, 2.0, 100),
        ("a", 0.8, 3.0, 2.0, 50),
    ]


@pytest.mark.parametrize("seconds", [0.5, 1.0, 1.16])
def test_of_a_short_recording_the_first_quarter_is_not_scored(fitted, seconds):
    model, training = fitted
    report = checks.check(KnownHeat(), model, [recording(50, "stranger", seconds=seconds)], training)
    count = round(seconds * 50)
    assert report["samples"] == count - count // 4
    assert report["seconds"] == pytest.approx(report["samples"] / 50)
    assert report["policies"][0]["samples"] == report["samples"]


def test_the_interval_of_r2_holds_the_r2_of_all_and_is_narrow_where_errors_are_alike():
    rng = np.random.default_rng(0)
    r = recording(1, "a", seconds=60.0)
    measured = r.values("heat").astype(float)
    noisy = measured + rng.normal(0, 0.5 * measured.std(), len(measured))
    low, high = r2_interval([Trace(r, measured, noisy)])
    assert low < 0.75 < high and high - low < 0.1  # 1 − 0.5²
    # the same noise in one part only: much hangs on whether that part is drawn
    part = np.where(np.arange(len(measured)) < 300, measured + 5.0, measured)
    low, high = r2_interval([Trace(r, measured, part)])
    assert low < r2(measured, part) < high and high - low > 0.2
    assert r2_interval([Trace(r, measured[:150], noisy[:150])]) is None  # three blocks say nothing


def test_the_interval_covers_what_another_draw_of_the_same_world_gives():
    rng, inside = np.random.default_rng(1), 0
    r = recording(1, "a", seconds=40.0)
    for _ in range(60):
        measured = rng.normal(size=2000)
        low, high = r2_interval([Trace(r, measured, measured + rng.normal(0, 0.5, 2000))])
        inside += low < 0.75 < high
    assert 50 <= inside <= 60  # 95 % of 60 is 57


def test_commanded_speed_follows_the_schedule():
    schedule = ScheduleConfig(commands=(Command(seconds=1.0, vx=0.5), Command(seconds=1.0, vx=1.1)))
    speeds = commanded_speed(recording(1, seconds=3.0, schedule=schedule))
    assert speeds.tolist() == [0.5] * 50 + [1.1] * 100


def test_split_holds_out_whole_policies_but_never_those_to_keep():
    recordings = [recording(i, policy, seconds=1.0) for i, policy in enumerate("aaaaaabbccddee")]
    for seed in range(5):
        training, held = split(recordings, 0.25, seed, keep=("b",))
        assert len(training) + len(held) == 14 and 3 <= len(held) <= 4
        seen = {r.policy_hash for r in training}
        assert {"a", "b"} <= seen
        assert {r.policy_hash for r in held} - seen
    assert split(recordings, 0.25, 1) == split(recordings, 0.25, 1)


def test_split_of_two_recordings_of_one_policy_keeps_one_for_fitting():
    training, held = split([recording(1, seconds=1.0), recording(2, seconds=1.0)], 0.2)
    assert (len(training), len(held)) == (1, 1)


def test_of_policies_with_one_recording_each_only_one_that_is_not_kept_is_held_out():
    for policies in ("ab", "abc", "abcd"):
        each = [recording(seed, policy, seconds=1.0) for seed, policy in enumerate(policies)]
        for seed in range(20):
            _, held = split(each, 0.2, seed, keep=("a",))
            assert len(held) == 1 and held[0].policy_hash != "a"


def test_where_all_policies_are_kept_and_have_one_recording_nothing_is_held_out():
    each = [recording(seed, policy, seconds=4.0) for seed, policy in enumerate("ab")]
    assert split(each, 0.2, keep=("a", "b")) == (each, [])
    report = fit_command.fit_and_check(KnownHeat(), each, MeasurementConfig(epochs=1), keep=("a", "b")).report
    line = fit_report.summary_line(report)
    assert "fitted to 2 recordings, each the only one of a policy that is kept, so none was held out" in line


def test_of_a_single_recording_nothing_is_held_out_and_nothing_is_claimed():
    only = recording(1, seconds=4.0)
    training, held = split([only], 0.2)
    assert (training, held) == ([only], [])
    report = fit_command.fit_and_check(KnownHeat(), [only], MeasurementConfig(epochs=1)).report
    assert report["held_out_r2"] is None and report["rank_correlation"] is None
    assert report["held_out"]["linear"]["r2"] is None and report["held_out"]["samples"] == 0
    line = fit_report.summary_line(report)
    assert "fitted to one recording, so none was held out" in line and "R²" not in line


def test_a_moving_average_looks_back_over_its_window_after_its_delay():
    series = np.array([0.0, 0.0, 6.0, 0.0, 0.0, 0.0])
    assert shifted(series, 0, 1).tolist() == series.tolist()
    assert shifted(series, 1, 3).tolist() == [0.0, 0.0, 0.0, 2.0, 2.0, 2.0]


def test_the_stand_ins_scale_offset_and_delay_are_found():
    fitted = fit_proxy(KnownHeat(), [recording(1), recording(2)], windows=(0.0, 0.06, 0.1))
    assert (fitted.delay_samples, fitted.window_samples) == (2, 5)
    assert fitted.scale == pytest.approx(2.0, rel=1e-4)
    assert fitted.offset == pytest.approx(5.0, rel=1e-4)
    report = check_proxy(KnownHeat(), [recording(3)], [recording(1)])
    assert report["smoothed"]["r2"] == pytest.approx(1.0, abs=1e-6) and report["plain"]["r2"] < 0.9


def test_checks_are_plain_json(fitted):
    model, training = fitted
    report = checks.check(KnownHeat(), model, [recording(8, "b"), recording(9, "a")], training)
    assert json.loads(json.dumps(report, allow_nan=False))["unit"] == "W"
    assert report["r2_policies"] is None  # both policies were seen


def test_one_unit_may_be_spelled_in_two_ways():
    r = recording(1, seconds=4.0)
    spelled = Series(Channel("effort", "N m", (3,)), r.values("effort"))
    fit([r, r.replace(channels={**r.channels, "effort": spelled})], epochs=1)


# --------------------------------------------------------------------------------------------- linear beside it


def test_every_check_has_the_linear_model_on_the_same_split(fitted):
    model, training = fitted
    new = [recording(50, "stranger")]
    report = checks.check(KnownHeat(), model, new, training)
    reference = checks.fit_linear(model, training)
    (trace,) = checks.traces_of(reference, "heat", new)
    assert report["linear"]["r2"] == r2(trace.measured, trace.predicted)
    assert report["linear"]["samples"] == report["samples"]
    assert report["spread"] is None  # an LSTM knows no spread
    own = checks.check(KnownHeat(), reference, new, training)
    assert own["r2"] == own["linear"]["r2"] == report["linear"]["r2"]


def test_calibration_counts_errors_within_one_and_two_standard_deviations():
    r = recording(1, "a", seconds=2.0)
    measured, off = np.zeros(4), np.array([0.5, 1.5, 3.0, 0.0])
    found = calibration([Trace(r, measured, measured + off, np.ones(4))])
    assert (found["within_1"], found["within_2"]) == (0.5, 0.75)
    assert found["error_over_spread"] == pytest.approx(np.sqrt((0.25 + 2.25 + 9.0) / 4))
    # the policy's mean is 1.25 too high, its mean spread is 1
    assert found["policies"] == [{"policy": "a", "error": 1.25, "spread": 1.0}]
    assert (found["policies_within_1"], found["policies_within_2"]) == (0.0, 1.0)
    assert calibration([Trace(r, measured, measured)]) is None
