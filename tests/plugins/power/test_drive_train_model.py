"""Measurement model `drive_train`: what it learns of made-up drives whose cost is known."""

from __future__ import annotations

import numpy as np
import pytest
import torch

pytest.importorskip("hts_power", reason="the model of this test is not installed")

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.contracts import ModelContext, Signals
from hts.errors import ConfigError, RecordingError
from hts.measurement.checks import predict
from hts.measurement.data import input_tensor
from hts.recordings.recording import Recording, Series
from hts_power.drive_train_model import DriveTrainSettings, computed_inputs, make
from hts_power.drive_train_prior import kinds

RATE, JOINTS = 50.0, 4
NAMES = ("FR_hip", "FR_knee", "FL_hip", "FL_knee")
INPUTS = (Channel("joint_torque", "N*m", (JOINTS,)), Channel("joint_velocity", "rad/s", (JOINTS,)))
TARGET = Channel("battery_current", "A")
SIGNALS = Signals(INPUTS, TARGET, RATE)
COPPER = np.array([0.010, 0.004, 0.010, 0.004])  # A per (N m)^2: hips and knees differ
KP, KD, IDLE = 20.0, 0.5, 1.2
LATE = 6  # samples


def cost(torque, speed):
    return IDLE + torque**2 @ COPPER + 0.04 * (torque * speed).sum(1)


def walk(seed, policy="a", seconds=40, noise=0.0, gait=1.0, gains=1.0) -> Recording:
    """A log of made-up legs: targets swing, the joint follows, and the gauge shows the mean of the last 0.1 s, late."""
    rng = np.random.default_rng(seed)
    steps = round(seconds * RATE)
    time = np.arange(steps) / RATE
    pace = np.repeat(rng.uniform(0.6, 1.4, 5), steps // 5)
    phase = np.cumsum(2 * np.pi * 2.0 * pace / RATE)
    shifts = rng.uniform(0, 2 * np.pi, JOINTS)
    position = 0.2 * gait * pace[:, None] * np.sin(phase[:, None] + shifts) + 0.01 * rng.standard_normal(
        (steps, JOINTS)
    )
    speed = np.gradient(position, axis=0) * RATE
    torque = (
        4 * gait * np.sin(phase[:, None] + shifts + 1.0)
        + rng.uniform(-2, 2, JOINTS)
        + 0.5 * rng.standard_normal((steps, JOINTS))
    )
    target = np.concatenate(((torque / gains + KD * speed)[1:] / KP + position[1:], position[-1:]))
    shown = np.convolve(cost(torque, speed), np.r_[np.zeros(LATE), np.ones(5) / 5])[:steps]
    channels = {
        "joint_torque": Series(INPUTS[0], (torque + noise * rng.standard_normal(torque.shape)).astype(np.float32)),
        "joint_velocity": Series(INPUTS[1], speed.astype(np.float32)),
        "joint_position": Series(Channel("joint_position", "rad", (JOINTS,)), position.astype(np.float32)),
        "joint_target": Series(Channel("joint_target", "rad", (JOINTS,)), target.astype(np.float32)),
        "battery_current": Series(TARGET, (shown + 0.01 * rng.standard_normal(steps)).astype(np.float32)),
    }
    return Recording(
        robot="legs",
        world="made up",
        policy_hash=policy * 64,
        iteration=0,
        joint_names=NAMES,
        kp=(KP,) * JOINTS,
        kd=(KD,) * JOINTS,
        rate_hz=RATE,
        schedule=ScheduleConfig(commands=(Command(seconds=seconds, vx=0.5),)),
        idle={"battery_current": IDLE},
        clock="made up",
        time=time,
        channels=channels,
    )


def fitted(recordings, **settings):
    model = make(settings, ModelContext(SIGNALS))
    return model, model.fit(recordings)


def settled(model, torque, speed):
    """Amperes for torques (T, J) and speeds (T, J)."""
    inputs = torch.from_numpy(np.concatenate((torque, speed), 1)).float()
    return model.denormalise(model.settled(inputs).mean).numpy()


def test_it_learns_what_torque_costs_and_how_late_the_gauge_is():
    model, report = fitted([walk(seed) for seed in range(5)])
    assert report["validation_r2"] > 0.99
    assert report["sensor_delay_seconds"] == pytest.approx((LATE + 2) / RATE, abs=0.5 / RATE)
    at_rest = np.zeros((1, JOINTS))
    assert settled(model, at_rest, at_rest)[0] == pytest.approx(IDLE, abs=0.03)
    hip, knee = ([[3.0 * (joint == which) for joint in range(JOINTS)]] for which in (0, 1))
    for torque in (hip, knee):
        told = settled(model, np.array(torque), at_rest)[0]
        assert told == pytest.approx(cost(np.array(torque), at_rest)[0], abs=0.03)


def test_a_gait_that_nobody_walked_is_predicted_from_two_minutes():
    model, _ = fitted([walk(seed, seconds=40) for seed in range(3)])
    new, old = walk(20, "b", gait=0.7), walk(21, "b")
    saved = [cost(r.values("joint_torque"), r.values("joint_velocity")).mean() for r in (new, old)]
    told = [settled(model, r.values("joint_torque"), r.values("joint_velocity")).mean() for r in (new, old)]
    assert told[0] / told[1] == pytest.approx(saved[0] / saved[1], abs=0.02)


def test_noise_of_the_torque_sensor_does_not_make_torque_cheap():
    """The square of a noisy torque says less of the cost; the log's targets tell the torque without that noise."""
    model, report = fitted([walk(seed, noise=3.0) for seed in range(5)])
    assert report["torque"] == "computed"
    torque = np.array([[3.0, 0.0, 0.0, 0.0]])
    extra = settled(model, torque, 0 * torque)[0] - settled(model, 0 * torque, 0 * torque)[0]
    assert extra == pytest.approx(9 * COPPER[0], rel=0.15)


def test_a_log_is_predicted_from_the_torque_that_was_fitted_to():
    """Weights of a torque without noise bill the sensor's noise: 3 N·m in four drives are 0.25 A of nothing."""
    model, report = fitted([walk(seed, noise=3.0) for seed in range(5)])
    assert report["torque"] == "computed"
    new = walk(20, "b", noise=3.0)
    shown = new.values("battery_current").mean()
    assert predict(model, new).mean() == pytest.approx(shown, abs=0.05)
    without = new.replace(channels={k: v for k, v in new.channels.items() if k != "joint_target"})
    assert predict(model, without).mean() == pytest.approx(shown + 9 * COPPER.sum(), abs=0.05)  # all that it tells
    again = make(model.settings, ModelContext(SIGNALS))  # as a file makes it
    again.load_tensors(model.tensors())
    assert predict(again, new) == pytest.approx(predict(model, new))


def test_members_of_an_ensemble_are_each_given_the_torque_that_they_were_fitted_to():
    """Weights of a torque without noise bill the sensor's noise, as of one model; a third of it where one of three
    members was fitted to what was read."""
    from hts.plugins import load

    asked = {"members": 3, "member": {"name": "drive_train"}, "beta": 1.0}
    model = load().make_measurement_model("ensemble", asked, ModelContext(SIGNALS))
    report = model.fit([walk(seed, noise=3.0) for seed in range(6)])
    assert {one["torque"] for one in report["members"]} == {"computed"}
    new = walk(20, "b", noise=3.0)
    shown = new.values("battery_current").mean()
    assert predict(model, new).mean() == pytest.approx(shown, abs=0.05)
    without = new.replace(channels={k: v for k, v in new.channels.items() if k != "joint_target"})
    assert predict(model, without).mean() == pytest.approx(shown + 9 * COPPER.sum(), abs=0.05)  # all that it tells
    again = load().make_measurement_model("ensemble", model.settings, ModelContext(SIGNALS))  # as a file makes it
    again.load_tensors(model.tensors())
    assert again.settings == model.settings and predict(again, new) == pytest.approx(predict(model, new))
    one = model.members[0]  # as where one member drew logs whose targets nobody kept
    one.config = one.config.model_copy(update={"computed_torque": False})
    read = input_tensor(SIGNALS, new)
    assert torch.equal(model.inputs_along(new)[:, 0], read) and not torch.equal(model.inputs_along(new)[:, 1], read)
    assert predict(model, new).mean() == pytest.approx(shown + 3 * COPPER.sum(), abs=0.05)


def test_a_log_whose_read_torque_was_fitted_to_is_predicted_from_that():
    logs = [walk(seed) for seed in range(3)]
    untold = [one.replace(channels={k: v for k, v in one.channels.items() if k != "joint_target"}) for one in logs]
    model, report = fitted(untold)
    assert report["torque"] == "read" and model.inputs_along(walk(20)) is None


def test_the_computed_torque_takes_the_firmwares_scale_of_gains_from_the_log():
    recording = walk(0, gains=0.8)
    found = computed_inputs(SIGNALS, recording)[2:, :JOINTS].numpy()
    assert np.corrcoef(found.ravel(), recording.values("joint_torque")[2:].ravel())[0, 1] > 0.99
    assert np.abs(found).mean() == pytest.approx(np.abs(recording.values("joint_torque")).mean(), rel=0.02)
    without = recording.replace(channels={k: v for k, v in recording.channels.items() if k != "joint_target"})
    assert computed_inputs(SIGNALS, without) is None


def test_the_reward_is_paid_at_once_and_has_the_sensors_mean():
    model, _ = fitted([walk(seed) for seed in range(3)])
    assert model.settles
    recording = walk(9)
    inputs = torch.from_numpy(
        np.concatenate((recording.values("joint_torque"), recording.values("joint_velocity")), 1)
    )[None]
    along, at_once = model.sequence(inputs)[0].mean[0], model.settled(inputs[0]).mean
    assert float(along[100:].mean()) == pytest.approx(float(at_once[100:].mean()), abs=0.02)
    lags = [float(np.corrcoef(along[100:].numpy(), np.roll(at_once.numpy(), lag)[100:])[0, 1]) for lag in range(16)]
    assert int(np.argmax(lags)) in (LATE + 1, LATE + 2, LATE + 3)


def test_doubt_grows_where_there_were_no_data_and_is_what_the_reward_is_careful_with():
    model, _ = fitted([walk(seed) for seed in range(3)])
    inside, outside = (
        model.settled(torch.tensor([[size, 0.0, size, 0.0] + [1.0] * JOINTS])).std for size in (3.0, 30.0)
    )
    assert float(outside) > 5 * float(inside) > 0
    assert model.pessimism == DriveTrainSettings().beta == 1.0


def test_a_gauge_that_is_read_five_times_a_second_says_as_much_as_it_reads():
    """Held readings: over all samples most of what it shows is old, over its readings nearly all is explained."""
    logs = []
    for seed in range(5):
        log = walk(seed)
        shown = log.values("battery_current").reshape(-1)
        held = shown[np.arange(len(shown)) // 10 * 10]
        logs.append(log.replace(channels={**log.channels, "battery_current": Series(TARGET, held)}))
    model, report = fitted(logs)
    assert report["readings_per_second"] == pytest.approx(5.0, abs=0.1)
    assert report["validation_r2"] > 0.97
    assert report["sensor_delay_seconds"] == pytest.approx((LATE + 2 + 4.5) / RATE, abs=1.5 / RATE)
    torque = np.array([[3.0, 0.0, 0.0, 0.0]])
    extra = settled(model, torque, 0 * torque)[0] - settled(model, 0 * torque, 0 * torque)[0]
    assert extra == pytest.approx(9 * COPPER[0], rel=0.1)


@pytest.mark.parametrize(("seconds", "moves"), [(40, 50), (1, 40)])
def test_a_gauge_that_stops_is_refused_in_one_line(seconds, moves):
    """After a second, or in half a second of which it is read once."""
    log = walk(0, seconds=seconds)
    shown = log.values("battery_current").reshape(-1).copy()
    shown[moves:] = shown[moves]
    shown[: moves if seconds == 1 else 0] = shown[0]
    stopped = log.replace(channels={**log.channels, "battery_current": Series(TARGET, shown)})
    with pytest.raises(RecordingError, match="'battery_current' has no two readings that differ in any of the 1"):
        fitted([stopped])


def test_a_recording_that_stands_twice_in_the_list_is_left_out_with_its_twin():
    """The gauge shows 30 % more in the second: what was fitted to one says little of the other."""
    logs = []
    for seed, gain in enumerate((1.0, 1.3)):
        one = walk(seed, seconds=8)
        shown = Series(TARGET, one.values("battery_current") * gain)
        logs.append(one.replace(channels={**one.channels, "battery_current": shown}))
    once, twice = (fitted(recordings)[1]["validation_r2"] for recordings in (logs, [*logs, *logs]))
    assert once < 0.5 and twice == pytest.approx(once, abs=0.02)


def test_joints_built_alike_are_told_by_their_names():
    assert kinds(NAMES, 4).tolist() == [0, 1, 0, 1]
    assert kinds(("shoulder", "elbow"), 2).tolist() == [0, 0]
    assert kinds(NAMES, 3).tolist() == [0, 0, 0]


@pytest.mark.parametrize("first", [0, 5, 9])
def test_what_gears_say_counts_where_a_log_says_little(first):
    """Of four seconds in which nobody walks much. Copper losses 0.010 and 0.004 are of ratios 1 and 2.5 ** 0.5."""

    def off(gears):
        model, _ = fitted([walk(first + seed, seconds=4, gait=0.02) for seed in range(2)], gears=gears)
        copper = (model.weight / model.feature_std)[:JOINTS].view(2, 2).sum(0)
        return abs(float(copper[1] / copper[0]) - 0.4)

    assert off((1.0, 2.5**0.5, 1.0, 2.5**0.5)) < off(None)


def test_gears_of_another_number_of_joints_are_refused_in_one_line():
    with pytest.raises(ConfigError, match="drive_train.gears: found 3 ratios, expected 4, one for each joint"):
        make({"gears": [6.33, 6.33, 9.5]}, ModelContext(SIGNALS))


def test_other_inputs_are_refused():
    odd = Signals((INPUTS[0], Channel("foot_force", "N", (2,))), TARGET, RATE)
    with pytest.raises(ConfigError, match="drive_train reads torque and speed of the same joints"):
        make({}, ModelContext(odd))
