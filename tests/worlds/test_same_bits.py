"""The twin is written for speed; what it records is, bit for bit, what the plain formulas give."""

from __future__ import annotations

import itertools
import logging
import subprocess
import sys

import numpy as np
import pytest

from hts.config import Command, ScheduleConfig
from hts.contracts import PhysicsSample
from hts.policies.export import to_onnx
from hts.policies.files import load_policy
from hts.worlds.base import seed_sequence
from hts.worlds.twin import compiled
from hts.worlds.twin.instruments import maker
from hts.worlds.twin.parameters import TwinSettings, resolved_settings
from hts.worlds.twin.programme import collection
from hts.worlds.twin.sensors import in_words
from hts.worlds.twin.session import Batch

BODY = {
    "torque_constant_spread": 0.05,
    "torque_saturation": 0.1,
    "backlash": 0.01,
    "torque_follows_supply": True,
    "command_jitter": 0.006,
    "lost_packets": 0.03,
    "floor_roughness": 0.004,
    "bump_length": 0.4,
    "floor_slope": 1.0,
    "payload_mass": 1.0,
    "wind_force": 3.0,
    "wind_gust": 0.3,
}
STICKING = {"stribeck_ratio": 0.5, "stribeck_speed": 0.2}
SESSIONS = {"floor_friction_spread": 0.1, "heading_gain_spread": 0.3, "heading_offset": 0.05}
GAUGE = {
    "resistance_spread": 0.05,
    "converter_share": 0.03,
    "converter_square": 1e-4,
    "own_regeneration": True,
    "idle_spread": 0.05,
    "idle_seconds": 10.0,
    "low_pass": True,
    "least_charge": 0.4,
    "ambient_spread": 3.0,
}
TWINS = {
    "default": {},
    "all": {
        "dynamics": {"structure": BODY | STICKING},
        "sessions": SESSIONS,
        "instruments": {"battery_gauge": {"structure": GAUGE}},
    },
    "smooth": {"dynamics": {"structure": BODY}},
    "sticking": {"dynamics": {"structure": STICKING}},
    "dev-03": {"reality": "dev-03"},
}
WALK = ScheduleConfig(commands=(Command(seconds=0.8, vx=0.8), Command(seconds=0.6, vx=0.4, vy=0.2, yaw_rate=0.5)))


@pytest.fixture(scope="module")
def policies(tmp_path_factory, robot):
    """The robot's own, one that soon falls, and its stand mode."""
    folder, walks = tmp_path_factory.mktemp("policies"), load_policy(robot.pretrained_policy())
    falls = type(walks)(
        {name: -3 * value if value.ndim == 2 else value for name, value in walks.tensors.items()}, walks.card
    )
    return [to_onnx(walks, folder / "walks.onnx"), to_onnx(falls, folder / "falls.onnx"), None]


def recorded(registry, robot, settings, objectives, policies) -> dict[str, np.ndarray]:
    """Everything that the recordings of a batch hold, and what its instruments know."""
    resolved = resolved_settings(TwinSettings.model_validate(settings), "go1")
    instruments = maker(registry, robot, {name: {} for name in objectives}, resolved)()
    batch = Batch(robot, resolved, instruments, len(policies), seed_sequence(3, "aa", 0))
    rows = batch.run(collection([None if one is None else str(one) for one in policies], WALK, "x"), "twin")
    batch.close()
    held = {"state": batch.body._state}
    for name, instrument in instruments.items():
        held |= {f"{name} {key}": values for key, values in getattr(instrument, "energy", {}).items()}
    for number, (recording,) in enumerate(rows):
        held[f"{number} falls"] = np.array(int(recording.notes["falls"]))
        held |= {f"{number} {name}": series.values for name, series in recording.channels.items()}
    return held


def assert_same(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> None:
    assert one.keys() == other.keys()
    differing = [name for name in one if one[name].tobytes() != other[name].tobytes()]
    assert not differing


@pytest.mark.parametrize("twin", TWINS)
def test_compiled_steps_record_the_bits_of_the_plain_ones(twin, registry, robot, policies, monkeypatch):
    assert compiled.load() is not None
    for members, objectives in (((0,), ["power"]), ((0, 1), ["noise"]), ((0, 1, 2, 0, 1, 0), ["power", "noise"])):
        given = (registry, robot, TWINS[twin], objectives, [policies[number] for number in members])
        fast = recorded(*given)
        with monkeypatch.context() as patch:
            patch.setattr(compiled, "load", lambda: None)
            assert_same(fast, recorded(*given))
    assert sum(int(values) for name, values in fast.items() if name.endswith("falls")) > 0


def test_a_twin_whose_engine_cannot_be_called_does_without_and_says_so(monkeypatch, caplog):
    monkeypatch.setattr(compiled, "LIBRARIES", ("no such library",))
    with caplog.at_level(logging.WARNING):
        assert compiled.load.__wrapped__() is None
    assert "no library of the engine" in caplog.text and "same results" in caplog.text


def test_nothing_but_a_twins_own_process_imports_numba():
    modules = "hts, hts.cli.main, hts.run, hts.worlds.twin.world, hts.worlds.twin.process, hts_power.plugin"
    code = f"import sys, {modules}; sys.exit(bool({{'numba', 'llvmlite'}} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("twin", ["default", "all"])
def test_sensors_draw_and_round_as_their_formulas_say(twin, registry, robot):
    resolved = resolved_settings(TwinSettings.model_validate(TWINS[twin]), "go1")
    batch = Batch(robot, resolved, maker(registry, robot, {"power": {}}, resolved)(), 3, seed_sequence(3, "aa", 0))
    sensors, body, p = batch.sensors, batch.body, batch.sensors.p
    drift, rng = sensors._drift.copy(), np.random.default_rng(0)
    rng.bit_generator.state = sensors._rng.bit_generator.state
    for _ in range(3):
        body.advance(np.tile(robot.spec.default_pose, (3, 1)), 20, ())
        drawn = rng.standard_normal((3, 17 + 3 * robot.spec.num_joints))
        edges = np.cumsum([0, 3, 4, 3, 3, 4, *3 * [robot.spec.num_joints]])
        noise = [drawn[:, a:b] for a, b in itertools.pairwise(edges)]
        rotation = body.rotation()
        down = -rotation[:, :, 2] if body.down is None else np.matmul(rotation, body.down[:, :, None])[:, :, 0]
        gravity = down @ sensors._tilt.T + p.gravity_noise * noise[0]
        drift += p.foot_force_drift * np.sqrt(0.02) * noise[1]
        velocity = np.matmul(rotation, body.qvel[:, :3, None])[:, :, 0]
        plain = {
            "projected_gravity": gravity / np.sqrt((gravity * gravity).sum(axis=1, keepdims=True)),
            "base_velocity": velocity * (1 + p.camera_scale_error) + p.camera_speed_noise * noise[2],
            "angular_velocity": body.qvel[:, 3:6] + p.gyro_noise * noise[3],
            "foot_force": body.foot_force * sensors._gain + drift + p.foot_force_noise * noise[4],
            "joint_position": body.joint_position() + p.position_noise * noise[5],
            "joint_velocity": in_words(body.joint_velocity() + p.velocity_noise * noise[6], p.velocity_word),
            "joint_torque": in_words(body.commanded_torque + p.torque_noise * noise[7], p.torque_word),
        }
        assert_same(plain, sensors.read(0.02))
    batch.close()


@pytest.mark.parametrize("name", ["battery_gauge", "microphone"])
@pytest.mark.parametrize("differs", [False, True], ids=["nominal", "own constants"])
def test_an_instrument_gives_the_same_bits_whether_steps_come_at_once_or_one_by_one(name, differs, registry, robot):
    rng, num, steps = np.random.default_rng(0), 2, 50  # more than one chunk of 64 in two goes
    at_once, one_by_one = (registry.make_instrument(name, {}, robot) for _ in range(2))
    for instrument in (at_once, one_by_one):
        instrument.reset(num, np.random.default_rng(1))
    joints, feet = (steps, num, robot.spec.num_joints), (steps, num, len(robot.spec.foot_sites))
    for _ in range(2):
        current = rng.normal(0, 8, joints) if differs else None
        motor, velocity = rng.normal(0, 8, joints), rng.normal(0, 5, joints)
        force, speed = 30.0 * (rng.random(feet) < 0.5), rng.uniform(0, 1, feet)
        samples = PhysicsSample(motor, velocity, force, speed, np.full(feet, 0.5), 1e-3, current)
        at_once.advance(samples)
        for step in range(steps):
            one_by_one.step(samples.at(step))
    assert_same(dict(at_once.read()), dict(one_by_one.read()))
    assert_same(dict(at_once.energy), dict(one_by_one.energy))
    assert sum(values.sum() for values in at_once.energy.values()) > 0
