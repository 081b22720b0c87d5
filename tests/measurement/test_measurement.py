"""Measurement models: fitting, files and checks."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

from hts.channels import Channel
from hts.config import Command, MeasurementConfig, ScheduleConfig
from hts.contracts import Comparison, Objective
from hts.errors import ConfigError, PolicyError, RecordingError, RunError
from hts.measurement import checks, files, fit_command
from hts.measurement.baseline import check_proxy, fit_proxy, shifted
from hts.measurement.fit import fit
from hts.measurement.models import MeasurementModel, MeasurementModelConfig, stack_channels
from hts.recordings.recording import Recording, Series

EFFORT, RATE, HEAT = Channel("effort", "N*m", (3,)), Channel("rate", "rad/s", (3,)), Channel("heat", "W")
SMALL = MeasurementModelConfig(inputs=("effort", "rate"), target="heat", hidden=16, products=True, stream=250, batch=4)


class Heat(Objective):
    """Reward less of the fake channel `heat`; the stand-in is right but for scale, offset, delay and smoothing."""

    name, unit, inputs, target = "cool", "1", ("effort", "rate"), HEAT

    def measurement_model(self):
        return SMALL

    def reward(self, prediction):
        return -prediction

    def score(self, segments):
        return {"heat": segments.values("heat").mean(1)}

    def compare(self, policy, reference):
        saving = 1.0 - policy["heat"] / reference["heat"]
        return Comparison(saving, saving)

    def proxy(self, channels):
        return (channels["effort"] * channels["rate"]).sum(-1)


def recording(seed: int, policy: str = "a", seconds: float = 20.0, speed: float = 0.8, gait: float = 1.0, **changes):
    """heat(t) = 5 + 2 · mean over 5 samples of Σ effort·rate, 2 samples late; a gait of random size and phase."""
    rng = np.random.default_rng(seed)
    count = round(seconds * 50)
    phase = 2 * np.pi * 2.2 * np.arange(count + 20) / 50 + rng.normal(0, 0.2, count + 20).cumsum() * 0.3
    phase = phase[:, None] + np.array([0.0, 2.0, 4.0])
    swell = 1.0 + 0.4 * np.sin(np.arange(count + 20) / 60 + seed)[:, None]
    effort = gait * swell * np.sin(phase) + rng.normal(0, 0.2, (count + 20, 3))
    rate = gait * swell * np.sin(phase + 0.7) + rng.normal(0, 0.2, (count + 20, 3))
    instant = (effort * rate).sum(1)
    heat = 5.0 + 2.0 * np.convolve(instant, np.full(5, 0.2))[: count + 20]
    values = {EFFORT: effort[20:], RATE: rate[20:], HEAT: heat[18:-2]}
    fields = {
        "robot": "fake", "world": "bench", "policy_hash": policy, "iteration": 0, "joint_names": ("x", "y", "z"),
        "kp": (1.0,) * 3, "kd": (0.1,) * 3, "rate_hz": 50.0, "idle": {"heat": 5.0}, "clock": "simulated",
        "schedule": ScheduleConfig(commands=(Command(seconds=seconds, vx=speed),)),
        "time": np.arange(count) / 50, "channels": {c.name: Series(c, v) for c, v in values.items()},
    }  # fmt: skip
    return Recording(**(fields | changes))


@pytest.fixture(scope="module")
def fitted():
    training = [recording(seed, policy) for seed, policy in ((1, "a"), (2, "a"), (3, "b"))]
    return fit(SMALL, training, epochs=15, seed=3), training


def inputs_of(r: Recording) -> torch.Tensor:
    return torch.from_numpy(stack_channels({n: r.values(n) for n in SMALL.inputs}, SMALL.inputs))


def test_new_statistics_leave_a_fitted_model_the_same_function(fitted):
    model = files_copy(fitted[0].model)
    data = inputs_of(recording(1))
    before = model.denormalise(model.sequence(data[None])[0])
    model.set_normaliser(3.0 * data + 1.0, 40.0 + 7.0 * data[:, 0])
    assert model.target_mean == pytest.approx(40.0 + 7.0 * float(data[:, 0].mean()), rel=1e-4)
    torch.testing.assert_close(model.denormalise(model.sequence(data[None])[0]), before, atol=2e-3, rtol=1e-3)


def files_copy(model: MeasurementModel) -> MeasurementModel:
    copy = MeasurementModel(model.config, model.input_sizes, model.rate_hz)
    copy.load_state_dict(model.state_dict())
    return copy.eval()


# ------------------------------------------------------------------------------------------------- fitting


def test_a_filtered_and_delayed_product_is_learned_and_predicted_for_a_new_policy(fitted):
    result, training = fitted
    new = [recording(50, "stranger", gait=1.15), recording(51, "stranger", gait=0.9)]
    report = checks.check(Heat(), result.model, new, training)
    assert report["r2"] > 0.9
    assert report["r2_policies"] == report["r2"]
    assert report["proxy"]["plain"]["r2"] < report["r2"]


def test_the_same_seed_gives_the_same_model_and_another_seed_another():
    data = [recording(1, seconds=8.0)]
    first, again, other = (fit(SMALL, data, epochs=1, seed=seed).model.state_dict() for seed in (0, 0, 1))
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not torch.equal(first["head.weight"], other["head.weight"])


def test_fitting_leaves_the_number_of_threads_as_it_was():
    before = torch.get_num_threads()
    fit(SMALL, [recording(1, seconds=4.0)], epochs=1)
    assert torch.get_num_threads() == before


def test_a_warm_start_begins_better_than_a_cold_one(fitted):
    data = [recording(7, "c", seconds=10.0)]
    cold = fit(SMALL, data, epochs=1)
    warm = fit(SMALL, data, epochs=1, warm_start=fitted[0].model)
    assert warm.report["warm_started"] and not cold.report["warm_started"]
    assert warm.report["curve"][0]["validation"] < cold.report["curve"][0]["validation"]


def test_a_model_of_another_shape_is_no_warm_start(fitted):
    other = SMALL.model_copy(update={"hidden": 8})
    assert not fit(other, [recording(1, seconds=4.0)], epochs=1, warm_start=fitted[0].model).report["warm_started"]


def test_time_running_out_ends_the_fit_after_the_epoch_and_says_so():
    report = fit(SMALL, [recording(1, seconds=4.0)], epochs=50, max_seconds=1e-9).report
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
    ],
)
def test_recordings_that_cannot_be_learned_from_are_refused_in_one_line(broken, said):
    with pytest.raises(RecordingError, match=said):
        fit(SMALL, broken(recording(1, seconds=4.0)), epochs=1)


# --------------------------------------------------------------------------------------------------- files


def test_a_saved_model_comes_back_equal(fitted, tmp_path):
    path = files.save(fitted[0].model, tmp_path / "model", {"dataset": "d1"})
    loaded = files.load(path)
    data = inputs_of(recording(9))[None]
    torch.testing.assert_close(loaded.sequence(data)[0], fitted[0].model.sequence(data)[0], rtol=0, atol=0)
    assert files.read_card(path)["notes"] == {"dataset": "d1"}
    assert loaded.rate_hz == 50.0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["model.json", "model.safetensors"]


def test_damaged_model_files_are_refused_in_one_line(fitted, tmp_path):
    path = files.save(fitted[0].model, tmp_path / "model")
    whole, card = path.read_bytes(), json.loads(path.with_suffix(".json").read_text())

    def refused(numbers: bytes, text: str, said: str) -> None:
        path.write_bytes(numbers)
        path.with_suffix(".json").write_text(text)
        with pytest.raises(PolicyError, match=said) as caught:
            files.load(path)
        assert "\n" not in str(caught.value)

    refused(whole[:-100], json.dumps(card), "truncated")
    refused(whole, json.dumps(card)[:50], "not JSON")
    refused(whole, json.dumps(card | {"format": "other"}), "'other'")
    refused(whole, json.dumps(card | {"version": 99}), "version 99")
    refused(whole, json.dumps({k: v for k, v in card.items() if k != "config"}), "'config' is missing")
    refused(whole, json.dumps(card | {"input_sizes": [3, 4]}), "not a measurement model")
    with pytest.raises(PolicyError, match="cannot be read"):
        files.load(tmp_path / "nowhere")


# -------------------------------------------------------------------------------------------------- checks


def test_r2_is_the_share_of_variance_explained():
    assert checks.r2(np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0, 3.0])) == 1.0
    assert checks.r2(np.array([1.0, 2.0, 3.0]), np.array([2.0, 2.0, 2.0])) == 0.0
    assert checks.r2(np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0, 4.0])) == 0.5
    assert checks.r2(np.array([2.0, 2.0]), np.array([2.0, 2.0])) is None


def test_rank_correlation_is_of_ranks_and_null_for_one_policy():
    assert checks.spearman([1.0, 2.0, 30.0], [5.0, 6.0, 7.0]) == pytest.approx(1.0)
    assert checks.spearman([1.0, 2.0, 3.0], [3.0, 2.0, 1.0]) == pytest.approx(-1.0)
    assert checks.spearman([1.0], [1.0]) is None


def test_policies_are_ranked_at_the_speed_most_of_them_share():
    def trace(policy, speed, measured, predicted):
        r = recording(1, policy, seconds=2.0, speed=speed)
        return checks.Trace(r, np.full(50, measured), np.full(50, predicted))

    costs = checks.policy_costs([
        trace("a", 0.8, 3.0, 2.0), trace("b", 0.8, 1.0, 1.0), trace("a", 1.1, 9.0, 9.0), trace("b", 0.8, 2.0, 3.0),
    ])  # fmt: skip
    assert [(c.policy, c.speed, c.measured, c.predicted, c.samples) for c in costs] == [
        ("b", 0.8, 1.5, 2.0, 100), ("a", 0.8, 3.0, 2.0, 50),
    ]  # fmt: skip


def test_commanded_speed_follows_the_schedule():
    schedule = ScheduleConfig(commands=(Command(seconds=1.0, vx=0.5), Command(seconds=1.0, vx=1.1)))
    speeds = checks.commanded_speed(recording(1, seconds=3.0, schedule=schedule))
    assert speeds.tolist() == [0.5] * 50 + [1.1] * 100


def test_split_holds_out_whole_policies_but_never_those_to_keep():
    recordings = [recording(i, policy, seconds=1.0) for i, policy in enumerate("aaaaaabbccddee")]
    for seed in range(5):
        training, held = checks.split(recordings, 0.25, seed, keep=("b",))
        assert len(training) + len(held) == 14 and 3 <= len(held) <= 4
        seen = {r.policy_hash for r in training}
        assert {"a", "b"} <= seen
        assert {r.policy_hash for r in held} - seen
    assert checks.split(recordings, 0.25, 1) == checks.split(recordings, 0.25, 1)


def test_split_of_two_recordings_of_one_policy_keeps_one_for_fitting():
    training, held = checks.split([recording(1, seconds=1.0), recording(2, seconds=1.0)], 0.2)
    assert (len(training), len(held)) == (1, 1)


def test_of_a_single_recording_the_end_is_held_out():
    training, held = checks.split([recording(1, seconds=10.0)], 0.2)
    assert (training[0].num_samples, held[0].num_samples) == (400, 100)
    assert held[0].time[0] == pytest.approx(8.0)


def test_a_moving_average_looks_back_over_its_window_after_its_delay():
    series = np.array([0.0, 0.0, 6.0, 0.0, 0.0, 0.0])
    assert shifted(series, 0, 1).tolist() == series.tolist()
    assert shifted(series, 1, 3).tolist() == [0.0, 0.0, 0.0, 2.0, 2.0, 2.0]


def test_the_stand_ins_scale_offset_and_delay_are_found():
    fitted = fit_proxy(Heat(), [recording(1), recording(2)], windows=(0.0, 0.06, 0.1))
    assert (fitted.delay_samples, fitted.window_samples) == (2, 5)
    assert fitted.scale == pytest.approx(2.0, rel=1e-4)
    assert fitted.offset == pytest.approx(5.0, rel=1e-4)
    report = check_proxy(Heat(), [recording(3)], [recording(1)])
    assert report["smoothed"]["r2"] == pytest.approx(1.0, abs=1e-6) and report["plain"]["r2"] < 0.9


def test_checks_are_plain_json(fitted):
    result, training = fitted
    report = checks.check(Heat(), result.model, [recording(8, "b"), recording(9, "a")], training)
    assert json.loads(json.dumps(report, allow_nan=False))["unit"] == "W"
    assert report["r2_policies"] is None  # both policies were seen


# ------------------------------------------------------------------------------------------------ hts fit


class _Registry:
    def make_objective(self, name, settings):
        return Heat()


@pytest.fixture
def store(tmp_path, monkeypatch):
    from hts import plugins
    from hts.recordings.store import RecordingStore

    monkeypatch.setattr(plugins, "load", _Registry)
    made = RecordingStore(tmp_path / "data.zarr", create=True)
    for seed in (1, 2, 3):
        made.write(recording(seed))
    blind = recording(4)
    made.write(blind.replace(channels={n: s for n, s in blind.channels.items() if n != "heat"}, idle={}))
    return made


def test_fit_writes_a_model_and_its_checks_and_overwrites_nothing(store, tmp_path):
    few = ("measurement.epochs=3", "measurement.held_out=0.3")
    path = fit_command.fit_store("cool", store.path, tmp_path / "out", overrides=few)
    report = json.loads(path.read_text())
    assert path == tmp_path / "out" / "fit.json"
    assert len(report["training"]) == 2 and len(report["held_out"]["recordings"]) == 1
    assert report["fit"]["epochs"] == 3 and report["rank_correlation"] is None
    assert list(report["left_out"].values()) == ["has no channel 'heat'"]
    assert report["dataset"] == store.dataset([i for i in store.ids() if i not in report["left_out"]]).sha256
    assert files.load(tmp_path / "out" / "model").config == SMALL
    assert "R²" in fit_command.summary_line(report)
    with pytest.raises(RunError, match="nothing is overwritten"):
        fit_command.fit_store("cool", store.path, tmp_path / "out")


@pytest.mark.parametrize("text", ["epochs=3", "measurement.epoch=3", "objectives.warm.x=1", "measurement.epochs=0"])
def test_a_wrong_setting_of_fit_is_one_line(store, tmp_path, text):
    with pytest.raises(ConfigError, match="--set") as caught:
        fit_command.fit_store("cool", store.path, tmp_path / "out", overrides=(text,))
    assert "\n" not in str(caught.value)


def test_fit_and_check_uses_the_given_configuration():
    config = MeasurementConfig(epochs=2, held_out=0.5)
    report = fit_command.fit_and_check(Heat(), [recording(1, seconds=6.0), recording(2, seconds=6.0)], config).report
    assert report["fit"]["epochs"] == 2
    assert report["held_out_r2"] == report["held_out"]["r2"]
