"""`drive_train` with `physics_steps`: drives whose torque jumps with their targets, told by logs of a row a step."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from pydantic import ValidationError

pytest.importorskip("hts_power", reason="the model of this test is not installed")

from hts.channels import SUBSTEP_TORQUE, SUBSTEP_VELOCITY, Channel
from hts.config import Command, ScheduleConfig
from hts.contracts import ModelContext, Signals
from hts.errors import ConfigError, RecordingError
from hts.measurement import files
from hts.measurement.checks import predict
from hts.measurement.data import input_tensor
from hts.measurement.fit_command import _usable
from hts.measurement.physics_steps import between_samples
from hts.measurement.transform import MeasurementTransform, ProxyTransform
from hts.plugins import load
from hts.recordings.recording import Recording, Series
from hts.recordings.store import RecordingStore
from hts_power.drive_train_model import make

RATE, JOINTS, PARTS, FINE = 50.0, 4, 4, 5  # FINE: of the made-up machine in each physics step
NAMES = ("FR_hip", "FR_knee", "FL_hip", "FL_knee")
INPUTS = (Channel("joint_torque", "N*m", (JOINTS,)), Channel("joint_velocity", "rad/s", (JOINTS,)))
TARGET = Channel("battery_current", "A")
CONTEXT = ModelContext(Signals(INPUTS, TARGET, RATE), physics_steps=PARTS)
KP, KD, INERTIA, IDLE = 30.0, 0.6, 0.05, 1.2  # N·m/rad, N·m·s/rad, kg·m^2, A
COPPER = 0.008  # A per (N m)^2
LOAD = 3.0  # N·m that a leg's weight takes


def drives(torque: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Current beyond idle, A."""
    return COPPER * np.square(torque).sum(-1) + 0.04 * (torque * speed).sum(-1)


def walk(seed: int, jump: float, late: int = 2, seconds: int = 40) -> tuple[Recording, np.ndarray, np.ndarray]:
    """Joints that swing, with targets that jump about beside by so many radians; late: physics steps until a target is
    in force. Also torque and speed at each physics step, (T, PARTS, J)."""
    rng = np.random.default_rng(seed)
    steps, dt = round(seconds * RATE), 1 / RATE / PARTS / FINE
    phase = 2 * np.pi * 2.0 * np.arange(steps)[:, None] / RATE + rng.uniform(0, 2 * np.pi, JOINTS)
    pace = np.repeat(rng.uniform(0.6, 1.4, 5), steps // 5)[:, None]
    targets = 0.4 * pace * np.sin(phase) + LOAD / KP + jump * pace * rng.choice([-1.0, 1.0], (steps, JOINTS))
    q, v = np.zeros(JOINTS), np.zeros(JOINTS)
    rows = {name: np.zeros((steps, JOINTS)) for name in ("joint_torque", "joint_velocity", "joint_position")}
    torques, speeds = np.zeros((steps, PARTS, JOINTS)), np.zeros((steps, PARTS, JOINTS))
    taken = np.zeros(steps)
    for k in range(steps):
        before = targets[max(k - 1, 0)]
        rows["joint_torque"][k] = KP * (before - q) - KD * v
        rows["joint_velocity"][k], rows["joint_position"][k] = v, q
        for part in range(PARTS):
            in_force = before if part < late else targets[k]
            if k + 1 < steps:
                torques[k + 1, part] = KP * (in_force - q) - KD * v
            began = v.copy()
            for _ in range(FINE):
                torque = KP * (in_force - q) - KD * v
                v = v + dt * (torque - LOAD * np.cos(q)) / INERTIA
                q = q + dt * v
                if k + 1 < steps:
                    taken[k + 1] += float(drives(torque, v)) / (PARTS * FINE)
            if k + 1 < steps:
                speeds[k + 1, part] = (began + v) / 2
    shown = IDLE + np.convolve(taken, np.ones(5) / 5)[:steps]
    channels = {name: Series(Channel(name, "rad", (JOINTS,)), values) for name, values in rows.items()}
    channels |= {channel.name: Series(channel, rows[channel.name]) for channel in INPUTS}
    channels["joint_target"] = Series(Channel("joint_target", "rad", (JOINTS,)), targets)
    channels["battery_current"] = Series(TARGET, shown + 0.01 * rng.standard_normal(steps))
    log = Recording(
        robot="legs",
        world="made up",
        policy_hash=str(seed) * 8,
        iteration=0,
        joint_names=NAMES,
        kp=(KP,) * JOINTS,
        kd=(KD,) * JOINTS,
        rate_hz=RATE,
        schedule=ScheduleConfig(commands=(Command(seconds=seconds, vx=0.5),)),
        idle={"battery_current": IDLE},
        clock="made up",
        time=np.arange(steps) / RATE,
        channels=channels,
    )
    return log, torques, speeds


@pytest.fixture(scope="module")
def logs():
    return [walk(seed, jump=0.05)[0] for seed in range(3)]


def fitted(recordings, context=CONTEXT, **settings):
    model = make(settings, context)
    return model, model.fit(recordings)


def error(model, gait) -> float:
    """Of the mean current of a gait, as a share of what is beyond idle; as the env would see it."""
    log, torque, speed = gait
    if model.settles_in_physics_steps:
        found = model.settled_over(torch.from_numpy(np.concatenate((torque, speed), -1)).float())
    else:
        found = model.settled(torch.from_numpy(np.concatenate((torque[:, -1], speed[:, -1]), -1)).float())
    promised = float(model.denormalise(found.mean[25:]).mean())
    measured = float(log.values("battery_current")[25:].mean())
    return abs(promised - measured) / (measured - IDLE)


def test_what_a_gait_costs_between_samples_is_told_before_it_is_walked(logs):
    once, _ = fitted(logs)
    each, report = fitted(logs, physics_steps=True)
    others = [walk(7, jump=0.0), walk(8, jump=0.02), walk(9, jump=0.1)]
    assert max(error(each, gait) for gait in others) < 0.15
    assert max(error(once, gait) for gait in others) > 0.5
    assert report["torque"] == "in physics steps, targets 2 late"


@pytest.mark.parametrize("late", [0, 1, 3])
def test_how_late_targets_come_is_read_from_the_log(late):
    _, report = fitted([walk(seed, jump=0.05, late=late)[0] for seed in range(3)], physics_steps=None)
    assert report["torque"] == f"in physics steps, targets {late} late"


def test_a_control_step_that_stays_the_same_is_what_settled_says(logs):
    model, _ = fitted(logs, physics_steps=True)
    inputs = torch.randn(5, 2 * JOINTS, generator=torch.Generator().manual_seed(0))
    alike, once = model.settled_over(inputs[:, None].expand(-1, PARTS, -1)), model.settled(inputs)
    torch.testing.assert_close(alike.mean, once.mean)
    torch.testing.assert_close(alike.std, once.std)


def test_a_file_says_that_it_was_fitted_to_physics_steps(tmp_path, logs):
    registry = load()
    names = {"physics_steps": True}
    model = registry.make_measurement_model("drive_train", names, CONTEXT)
    model.fit(logs)
    files.save(model, tmp_path / "one.safetensors", {})
    again = files.load(tmp_path / "one.safetensors", registry=registry)
    assert again.settles_in_physics_steps
    inputs = torch.randn(3, PARTS, 2 * JOINTS, generator=torch.Generator().manual_seed(1))
    assert torch.equal(again.settled_over(inputs).mean, model.settled_over(inputs).mean)


def test_the_reward_reads_each_physics_step_of_the_env(logs):
    model, _ = fitted(logs, physics_steps=True)
    transform = MeasurementTransform(model, lambda z: -z, "power")
    assert transform.inputs == (SUBSTEP_TORQUE, SUBSTEP_VELOCITY)
    random = torch.Generator().manual_seed(2)
    torque, speed = (torch.randn(1, 3, PARTS, JOINTS, generator=random) for _ in range(2))
    found = transform.evaluate(transform.record({SUBSTEP_TORQUE: torque, SUBSTEP_VELOCITY: speed}))
    expected = model.settled_over(torch.cat((torque, speed), -1)[0])
    torch.testing.assert_close(found["measured", "battery_current"][:, 0], expected.mean)
    assert found["outside", "battery_current"].shape == (3, 1)


def test_logs_that_do_not_tell_leave_it_at_the_samples_or_are_refused(logs):
    without = [
        log.replace(channels={name: one for name, one in log.channels.items() if name != "joint_target"})
        for log in logs
    ]
    model, report = fitted(without, physics_steps=None)
    assert report["torque"] == "read" and not model.settles_in_physics_steps
    with pytest.raises(RecordingError, match="cannot be told, which physics_steps=true asks for"):
        fitted(without, physics_steps=True)


def test_a_robot_whose_simulation_keeps_none_is_refused_before_anything_is_spent(logs):
    plain = dataclasses.replace(CONTEXT, physics_steps=0)
    assert not fitted(logs, plain, physics_steps=None)[0].settles_in_physics_steps
    with pytest.raises(ConfigError, match="keeps_physics_steps"):
        make({"physics_steps": True}, plain)
    turned = dataclasses.replace(CONTEXT, signals=Signals(INPUTS[::-1], TARGET, RATE))
    with pytest.raises(ConfigError, match="the inputs joint_torque, joint_velocity, in this order"):
        make({"physics_steps": True}, turned)
    with pytest.raises(ValidationError, match="needs instant=true"):
        make({"physics_steps": True, "instant": False}, CONTEXT)


def test_along_a_recording_it_is_judged_by_what_it_was_fitted_to(logs):
    other = walk(5, jump=0.05)[0]
    read = other.values("battery_current")[100:]
    model, _ = fitted(logs, physics_steps=True)
    found = predict(model, other)[100:]
    assert abs(found.mean() - read.mean()) < 0.04 * read.mean()
    assert np.square(found - read).mean() < 0.03 * read.var()
    samples = model.sequence(input_tensor(model.signals, other)[None])[0].mean[0, 100:]
    assert abs(float(model.denormalise(samples).mean()) - read.mean()) > 0.1 * read.mean()  # what it was not fitted to


def test_members_of_an_ensemble_look_once_a_control_step(logs):
    member = {"name": "drive_train", "physics_steps": None}
    model = load().make_measurement_model(
        "ensemble", {"member": member, "members": 2}, dataclasses.replace(CONTEXT, registry=load())
    )
    assert [one.config.physics_steps for one in model.members] == [None, None]
    model.fit(logs)
    assert [one.config.in_steps for one in model.members] == [None, None]


def test_fits_from_a_store_read_what_tells_of_the_time_between_samples(tmp_path, logs):
    store = RecordingStore(tmp_path / "data.zarr", create=True)
    for log in logs:
        store.write(dataclasses.replace(log, robot="go1"))
    found, _ = _usable(store, load().make_objective("power"), None)
    assert all(between_samples(one, PARTS, 2) is not None for one in found)


def test_a_channel_that_no_env_tells_in_physics_steps_is_one_line():
    objective = load().make_objective("power", {"proxy_physics_steps": True})
    objective.inputs = ("joint_torque", "foot_force")
    with pytest.raises(ConfigError, match="objective 'power' is .* reads 'foot_force', which no env tells so"):
        ProxyTransform(objective)


def test_the_stand_in_may_be_asked_in_each_physics_step():
    objective = load().make_objective("power", {"proxy_physics_steps": True})
    transform = ProxyTransform(objective)
    assert transform.inputs == (SUBSTEP_TORQUE, SUBSTEP_VELOCITY)
    random = torch.Generator().manual_seed(2)
    torque, speed = (torch.randn(1, 3, PARTS, JOINTS, generator=random) for _ in range(2))
    found = transform.record({SUBSTEP_TORQUE: torque, SUBSTEP_VELOCITY: speed})
    each = [objective.proxy({"joint_torque": torque[0, :, k], "joint_velocity": speed[0, :, k]}) for k in range(PARTS)]
    torch.testing.assert_close(found[:, 0], torch.stack(each).mean(0))
