"""Torques that are not those of the joint controllers: another sign, order of joints or unit, or late."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from two_joint_log import LogOnly

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.errors import RecordingError
from hts.recordings import Recording, Series
from hts.recordings.logs import recording_from_columns, torque_notes

LEGS = ("FL", "FR", "RL", "RR")
WALKER = LogOnly(LEGS, torque=20.0)  # kp 20 N*m/rad, kd 0.5 N*m*s/rad
RATE, SAMPLES = 50.0, 400
SWAPPED = [1, 0, 3, 2]


def walk(target_lag=1, torque_lag=0, noise=0.3, strides=2.0, own=0.2):
    """Diagonal legs together, each with a motion of its own beside: positions follow targets late and too little."""
    chance = np.random.default_rng(2)
    time = np.arange(SAMPLES + 20) / RATE
    phase = 2 * np.pi * strides * time
    swing = np.stack([np.sin(phase) * side for side in (1, -1, -1, 1)], 1)
    target = 0.3 * swing + own * np.stack([np.sin(phase * rate) for rate in (0.55, 0.7, 0.85, 1.3)], 1)
    position = 0.6 * np.roll(target, 3, axis=0)
    velocity = np.gradient(position, 1 / RATE, axis=0)
    torque = 20.0 * (np.roll(target, target_lag, axis=0) - position) - 0.5 * velocity + 4.0  # it carries its weight
    torque = np.roll(torque, torque_lag, axis=0) + chance.normal(0, noise, torque.shape)
    values = (target, position, velocity, torque)
    return dict(
        zip(
            ("joint_target", "joint_position", "joint_velocity", "joint_torque"),
            (one[20:] for one in values),
            strict=True,
        )
    )


def recording(values, kp=20.0, kd=0.5, samples=SAMPLES):
    units = {"joint_target": "rad", "joint_position": "rad", "joint_velocity": "rad/s", "joint_torque": "N*m"}
    series = {name: Series(Channel(name, units[name], (4,)), one[:samples]) for name, one in values.items()}
    schedule = ScheduleConfig(commands=(Command(seconds=samples / RATE, vx=0.5),))
    gains = ((kp,) * 4, (kd,) * 4)
    time = np.arange(samples) / RATE
    return Recording("logger", "field", "", 0, LEGS, *gains, RATE, schedule, {}, "log", time, series)


def with_torque(change, **walked):
    values = walk(**walked)
    return recording({**values, "joint_torque": change(values["joint_torque"])})


def refusal(made):
    with pytest.raises(RecordingError, match="log: 'joint_torque' is not what the joint controllers give") as refused:
        torque_notes(made, WALKER.spec, "log")
    assert torque_notes(made, WALKER.spec, "log", stated=["joint_torque"]) == {}
    assert "\n" not in str(refused.value)
    return str(refused.value)


@pytest.mark.parametrize("target_lag", [0, 1, 2, 3])
@pytest.mark.parametrize("torque_lag", [0, 1, 2])
def test_torques_of_the_controllers_pass_although_late_and_noisy(target_lag, torque_lag):
    assert torque_notes(recording(walk(target_lag, torque_lag, noise=1.5)), WALKER.spec, "log") == {}


def test_torques_that_are_counted_the_other_way_are_refused():
    assert "counted the other way: say sign: -1. Correct the mapping" in refusal(with_torque(lambda torque: -torque))


def test_one_joint_that_is_counted_the_other_way_is_named():
    said = refusal(with_torque(lambda torque: torque * [1, 1, -1, 1]))
    assert "that of RL is counted the other way (-0.9" in said and "others are not" in said
    assert "say sign: {RL: -1}" in said


@pytest.mark.parametrize("order", [SWAPPED, [1, 0, 2, 3]])
def test_torques_in_another_joint_order_are_refused(order):
    said = refusal(with_torque(lambda torque: torque[:, order]))
    assert "what is asked of FL is measured of FR (0.9" in said and "sign" not in said


def test_another_order_and_another_sign_are_told_in_that_order():
    said = refusal(with_torque(lambda torque: -torque[:, SWAPPED]))
    assert "of FR (-0.9" in said and "correct the order first, then the sign" in said


@pytest.mark.parametrize(("strides", "late"), [(2.0, 12), (2.0, 13), (3.0, 10)])
@pytest.mark.parametrize("noise", [0.3, 1.5])
def test_torques_that_are_late_by_half_of_a_stride_are_not_taken_for_reversed_ones(strides, late, noise):
    notes = torque_notes(recording(walk(torque_lag=late, strides=strides, noise=noise)), WALKER.spec, "log")
    assert list(notes) == ["joint_torque_late"]
    said = re.match(
        r"about (\d+) ms later than what kp \(target - position\) - kd velocity", notes["joint_torque_late"]
    )
    assert said and abs(int(said[1]) - 20 * late) <= 40


def test_torques_that_are_early_are_told_so_too():
    values = walk()
    early = {**values, "joint_torque": np.roll(values["joint_torque"], -12, axis=0)}
    assert torque_notes(recording(early), WALKER.spec, "log")["joint_torque_late"].startswith(
        "about 240 ms earlier than"
    )


def test_torques_that_may_be_late_or_reversed_are_refused_and_told_both():
    """Legs that swing alike for ever are the same half of a stride later and with the other sign."""
    for values in (walk(own=0.0, torque_lag=13), {**walk(own=0.0), "joint_torque": -walk(own=0.0)["joint_torque"]}):
        said = refusal(recording(values))
        both = r"counted the other way: say sign: -1; or it is about \d+ ms (later|earlier) than what they give, which"
        assert re.search(both, said) and "so look at the stamps first" in said


def test_of_torques_of_other_joints_or_another_sign_no_lag_is_said():
    for change in (lambda torque: -torque, lambda torque: torque[:, SWAPPED], lambda torque: -torque[:, SWAPPED]):
        assert "ms later" not in refusal(with_torque(change)) and "ms earlier" not in refusal(with_torque(change))


@pytest.mark.parametrize(("factor", "shown"), [(1 / 6.33, "0.16"), (10.0, "10")])
def test_torques_of_another_size_are_noted(factor, shown):
    notes = torque_notes(with_torque(lambda torque: torque * factor), WALKER.spec, "log")
    assert list(notes) == ["joint_torque_scale"]
    assert notes["joint_torque_scale"].startswith(f"{shown} times what kp (target - position) - kd velocity asks for")


def test_gains_that_are_half_or_twice_what_is_stated_are_not():
    for factor in (0.5, 2.0):
        assert torque_notes(recording(walk(), 20.0 * factor, 0.5 * factor), WALKER.spec, "log") == {}


def test_columns_that_have_nothing_to_do_with_it_are_noted():
    chance = np.random.default_rng(0)
    notes = torque_notes(with_torque(lambda torque: chance.normal(0, 5, torque.shape)), WALKER.spec, "log")
    assert list(notes) == ["joint_torque_unlike"] and "hardly what kp" in notes["joint_torque_unlike"]


def test_nothing_is_said_of_logs_that_do_not_tell():
    wrong = {**walk(), "joint_torque": -walk()["joint_torque"]}
    still = {name: values * 0.001 for name, values in wrong.items()}
    untold = {name: values for name, values in wrong.items() if name != "joint_target"}
    for made in (recording(still), recording(untold), recording(wrong, kp=0.0, kd=0.0), recording(wrong, samples=100)):
        assert torque_notes(made, WALKER.spec, "log") == {}


def test_a_robot_that_is_let_go_for_half_of_a_log_still_tells():
    """Limp, it sinks slowly, far from its targets, with hardly any torque."""
    values, limp = walk(), slice(SAMPLES // 2, None)
    ramp = np.linspace(0, 1, SAMPLES // 2)[:, None]
    values["joint_position"][limp] = values["joint_target"][limp] + ramp
    values["joint_velocity"][limp] = 0.25
    values["joint_torque"][limp] = 0.3 * ramp
    assert torque_notes(recording(values), WALKER.spec, "log") == {}
    refusal(recording({**values, "joint_torque": -values["joint_torque"]}))


def columns_of(values):
    columns = {"t": 1000 * np.arange(SAMPLES) / RATE}
    for name, one in values.items():
        columns |= {f"{leg}_{name}": one[:, at] for at, leg in enumerate(LEGS)}
    return columns


def imported(values, **recorded):
    units = {"joint_target": "rad", "joint_position": "rad", "joint_velocity": "rad/s", "joint_torque": "N*m"}
    mapping = {
        "time": {"column": "t", "unit": "ms"},
        "rate_hz": 50,
        "joints": {leg: leg for leg in LEGS},
        "channels": {name: {"columns": f"{{joint}}_{name}", "unit": units[name]} for name in values},
        "recording": recorded,
    }
    return recording_from_columns([Path("log")], mapping, WALKER, lambda path: columns_of(values))


def test_an_import_refuses_notes_and_takes_the_gains_that_the_mapping_states():
    values = walk()
    assert not [key for key in imported(values).notes if key.startswith("joint_torque")]
    with pytest.raises(RecordingError, match="say sign: -1"):
        imported({**values, "joint_torque": -values["joint_torque"]})
    assert "joint_torque_scale" in imported({**values, "joint_torque": values["joint_torque"] / 6.33}).notes
    assert "joint_torque_scale" in imported(values, kp=[80.0] * 4, kd=[2.0] * 4).notes
