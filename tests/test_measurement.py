"""Measurement models: fitting, files, checks, and the transform inside an env."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import check_env_specs

from hts.channels import Channel
from hts.config import Command, MeasurementConfig, ScheduleConfig
from hts.contracts import Comparison, Objective
from hts.errors import ConfigError, PolicyError, RecordingError, RunError, SimulationError
from hts.measurement import checks, files, fit_command
from hts.measurement.baseline import check_proxy, fit_proxy, shifted
from hts.measurement.fit import fit
from hts.measurement.models import MeasurementModel, MeasurementModelConfig, stack_channels
from hts.measurement.transform import MeasurementTransform, ProxyTransform
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


# ----------------------------------------------------------------------------------------------- the model


@pytest.mark.parametrize("layers", [1, 2])
@pytest.mark.parametrize("products", [False, True])
def test_step_by_step_and_whole_sequence_give_the_same_prediction(layers, products):
    config = MeasurementModelConfig(inputs=("a", "b"), target="y", hidden=8, layers=layers, products=products)
    model = MeasurementModel(config, (3, 3), 50.0, seed=1)
    data = 4.0 + 3.0 * torch.randn(5, 40, 6, generator=torch.Generator().manual_seed(0))
    model.set_normaliser(data.flatten(0, 1), data[..., 0].flatten() * 2.0)
    model.eval()
    whole, final = model.sequence(data)
    state, steps = model.initial_state(5), []
    for t in range(40):
        prediction, state = model.step(data[:, t], state)
        steps.append(prediction)
    torch.testing.assert_close(torch.stack(steps, 1), whole.detach(), atol=2e-5, rtol=1e-4)
    torch.testing.assert_close(state, final.detach(), atol=2e-5, rtol=1e-4)
    continued, _ = model.sequence(data[:, 20:], model.sequence(data[:, :20])[1])
    torch.testing.assert_close(continued, whole[:, 20:])


@pytest.mark.parametrize("layers", [1, 2])
@pytest.mark.parametrize("products", [False, True])
def test_many_steps_at_once_are_the_single_steps_to_the_bit_also_where_episodes_end(layers, products):
    config = MeasurementModelConfig(inputs=("a", "b"), target="y", hidden=8, layers=layers, products=products)
    model = MeasurementModel(config, (3, 3), 50.0, seed=1)
    data = 4.0 + 3.0 * torch.randn(12, 5, 6, generator=torch.Generator().manual_seed(0))
    model.set_normaliser(data.flatten(0, 1), data[..., 0].flatten() * 2.0)
    model.requires_grad_(False).eval()
    ended = torch.zeros(12, 5, dtype=torch.bool)
    ended[3, 1] = ended[3, 4] = ended[7, 0] = ended[11, 2] = True
    data[3, 4] = torch.nan  # a world that ends in NaN starts clean
    state, expected = model.initial_state(5), []
    for inputs, end in zip(data, ended, strict=True):
        prediction, state = model.step(inputs, state)
        expected.append(prediction)
        state = state.masked_fill(end, 0.0)
    found, memory = model.steps(data, model.initial_state(5), ended)
    assert torch.equal(found.nan_to_num(1e9), torch.stack(expected).nan_to_num(1e9))
    assert torch.equal(memory, state) and bool(memory.isfinite().all())


def test_products_are_squares_and_place_by_place_products_of_inputs_of_one_size():
    config = MeasurementModelConfig(inputs=("a", "b", "c"), target="y", products=True)
    model = MeasurementModel(config, (2, 1, 2), 50.0)
    features = model.features(torch.tensor([1.0, 2.0, 10.0, 3.0, 4.0]))
    # inputs; a·a, a·c, b·b, c·c
    assert features.tolist() == [1, 2, 10, 3, 4, 1, 4, 3, 8, 100, 9, 16]
    assert model.num_features == 12


def test_making_a_model_does_not_touch_the_global_random_generator():
    torch.manual_seed(5)
    expected = torch.rand(1)
    torch.manual_seed(5)
    MeasurementModel(SMALL, (3, 3), 50.0, seed=9)
    assert torch.equal(torch.rand(1), expected)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_bad_input_makes_that_worlds_prediction_nan_and_no_other(bad):
    model = MeasurementModel(SMALL, (3, 3), 50.0).eval()
    inputs = torch.zeros(4, 6)
    inputs[2, 1] = bad
    prediction, _ = model.step(inputs, model.initial_state(4))
    assert torch.isnan(prediction).tolist() == [False, False, True, False]


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


# -------------------------------------------------------------------------------------------------- the env


class FakeEnv(EnvBase):
    """[P, N] worlds whose effort counts their steps; world (0, 1) is over after 3 steps."""

    def __init__(self, candidates=2, worlds=3):
        super().__init__(batch_size=torch.Size([candidates, worlds]))
        shape = self.batch_size
        channels = Composite(effort=Unbounded((*shape, 3)), rate=Unbounded((*shape, 3)), shape=shape)
        self.observation_spec = Composite(observation=Unbounded((*shape, 1)), channels=channels, shape=shape)
        self.action_spec = Unbounded((*shape, 3))
        self.reward_spec = Unbounded((*shape, 1))
        flag = Binary(1, (*shape, 1), dtype=torch.bool)
        self.done_spec = Composite(done=flag.clone(), terminated=flag.clone(), truncated=flag.clone(), shape=shape)
        self.count = torch.zeros(*shape, 1)

    def _set_seed(self, seed):
        pass

    def _out(self, action):
        flags = {name: torch.zeros_like(self.count, dtype=torch.bool) for name in ("done", "terminated", "truncated")}
        channels = TensorDict({"effort": self.count.expand(-1, -1, 3) + 0.0, "rate": action}, self.batch_size)
        return TensorDict({"observation": self.count + 0.0, "channels": channels, **flags}, self.batch_size)

    def _reset(self, tensordict=None):
        mask = None if tensordict is None else tensordict.get("_reset", None)
        self.count = torch.zeros_like(self.count) if mask is None else self.count * ~mask
        return self._out(torch.zeros(*self.batch_size, 3))

    def _step(self, tensordict):
        self.count = self.count + 1
        out = self._out(tensordict["action"])
        out["reward"] = torch.zeros_like(self.count)
        over = torch.zeros_like(self.count, dtype=torch.bool)
        over[0, 1:2] = self.count[0, 1:2] >= 3
        out["terminated"], out["done"] = over, over.clone()
        return out


def fake_env(model, candidates=2, worlds=3):
    return TransformedEnv(FakeEnv(candidates, worlds), MeasurementTransform.of(Heat(), model))


@pytest.fixture
def model(fitted):
    return files_copy(fitted[0].model)


def test_an_env_with_the_model_keeps_its_specs(model):
    check_env_specs(fake_env(model))
    check_env_specs(TransformedEnv(FakeEnv(), ProxyTransform(Heat())))


def test_the_transform_predicts_what_the_model_predicts_and_rewards_less(model):
    env = fake_env(model)
    rollout = env.rollout(3, break_when_any_done=False)
    data = torch.cat((rollout["next", "channels", "effort"], rollout["next", "channels", "rate"]), -1)
    expected, _ = model.sequence(data.flatten(0, 1))
    measured = rollout["next", "measured", "heat"]
    torch.testing.assert_close(measured, expected.view(2, 3, 3, 1), atol=1e-5, rtol=1e-4)
    assert torch.equal(rollout["next", "real_reward", "cool"], -measured)
    assert (rollout["measured", "heat"][:, :, 0] == 0).all()  # nothing measured before the first step


def test_a_world_that_begins_again_forgets_and_the_others_do_not(model):
    env = fake_env(model)
    rollout = env.rollout(6, policy=lambda td: td.set("action", torch.ones(2, 3, 3)), break_when_any_done=False)
    measured = rollout["next", "measured", "heat"][..., 0]
    torch.testing.assert_close(measured[0, 1, 3:], measured[0, 1, :3])
    assert not torch.allclose(measured[0, 0, 3:], measured[0, 0, :3])
    torch.testing.assert_close(measured[0, 0], measured[1, 2])


def test_a_world_beside_others_is_predicted_as_if_alone(model):
    def ones(td):
        return td.set("action", torch.ones(*td.batch_size, 3))

    crowd = fake_env(model, 2, 3).rollout(3, ones)["next", "measured", "heat"]
    alone = fake_env(model, 1, 1).rollout(3, ones)["next", "measured", "heat"]
    torch.testing.assert_close(crowd[1, 2], alone[0, 0])


def test_nan_stays_nan_until_the_world_begins_again(model):
    env = fake_env(model)
    td = env.reset()
    for step in range(4):
        td["action"] = torch.full((2, 3, 3), math.nan if step == 0 else 1.0)
        td, following = env.step_and_maybe_reset(td)
        broken = torch.isnan(td["next", "real_reward", "cool"])
        assert broken.sum() == (6 if step < 3 else 5)  # (0, 1) began again after step 3
        td = following


def test_memory_is_part_of_the_state_and_resumes_exactly(model):
    def ones(td):
        return td.set("action", torch.ones(*td.batch_size, 3))

    env = fake_env(model)
    env.rollout(2, ones)
    saved = {name: value.clone() for name, value in env.state_dict().items()}
    assert sum(value.numel() for value in saved.values()) == 2 * 16 * 6  # the memory alone, not the weights
    other = fake_env(model)
    other.load_state_dict(saved)
    channels = TensorDict({"effort": torch.ones(2, 3, 3), "rate": torch.ones(2, 3, 3)}, [2, 3])
    steps = [
        e.transform._step(TensorDict({}, [2, 3]), TensorDict({"channels": channels}, [2, 3])) for e in (env, other)
    ]
    assert torch.equal(steps[0]["measured", "heat"], steps[1]["measured", "heat"])
    fresh = fake_env(model)
    fresh.load_state_dict(fake_env(model).state_dict())  # nothing measured yet: nothing to load


def test_inputs_outside_the_data_are_counted(model):
    low, high = model.input_low.clone(), model.input_high.clone()
    inputs = torch.stack((low, high, high + 1.0, torch.full_like(low, math.nan)))
    inputs[2, :3] = 0.0
    assert model.outside(inputs).tolist() == [0.0, 0.0, 0.5, 1.0]
    rollout = fake_env(model).rollout(3, break_when_any_done=False)
    assert rollout["next", "outside", "heat"].shape == (2, 3, 3, 1)


def test_the_stand_in_as_reward_is_minus_the_stand_in():
    env = TransformedEnv(FakeEnv(), ProxyTransform(Heat()))
    rollout = env.rollout(2, lambda td: td.set("action", torch.full((2, 3, 3), 2.0)))
    assert rollout["next", "real_reward", "cool"][0, 0, :, 0].tolist() == [-6.0, -12.0]


def test_a_channel_the_env_does_not_write_is_named(model):
    model.config = model.config.model_copy(update={"inputs": ("effort", "rates")})
    env = TransformedEnv(FakeEnv(), MeasurementTransform.of(Heat(), model))
    with pytest.raises(SimulationError, match="'rates'. Did you mean 'rate'"):
        _ = env.observation_spec
