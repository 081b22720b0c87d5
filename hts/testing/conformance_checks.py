"""What `hts check` asks of each kind of thing. The docstring of each function is the demand a person reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.contracts import (
    Comparison,
    Instrument,
    LogReader,
    Objective,
    PhysicsSample,
    Robot,
    Selector,
    SimulatedCandidate,
    TestedCandidate,
)
from hts.errors import PluginError
from hts.plugins import Entry, Registry
from hts.testing.tiny_robot import TinyRobot

WORLDS = 3


def ensure(kept: bool, fault: str) -> None:
    if not kept:
        raise PluginError(fault)


# ------------------------------------------------------------------------------------------- objectives


def objective_has_its_parts(entry: Entry, registry: Registry) -> None:
    """It is made without settings, and has name, unit, inputs, target and weights."""
    objective = entry.factory({})
    ensure(isinstance(objective, Objective), f"is a {type(objective).__name__}, not a hts.contracts.Objective")
    ensure(objective.name == entry.name, f"is registered as '{entry.name}' but calls itself '{objective.name}'")
    ensure(bool(objective.unit), "unit is empty")
    ensure(isinstance(objective.target, Channel), "target is not a hts.channels.Channel")
    ensure(objective.target.name not in objective.inputs, f"reads its own target '{objective.target.name}'")
    ensure(bool(objective.weights) and min(objective.weights) > 0, f"weights {objective.weights} are not all above 0")


def objective_has_a_model(entry: Entry, registry: Registry) -> None:
    """Its measurement model reads its inputs and predicts its target."""
    objective = entry.factory({})
    model = objective.measurement_model()
    ensure(tuple(model.inputs) == tuple(objective.inputs), f"model reads {model.inputs}, inputs are {objective.inputs}")
    ensure(
        model.target == objective.target.name, f"model predicts '{model.target}', target is '{objective.target.name}'"
    )


def objective_reward_keeps_shape(entry: Entry, registry: Registry) -> None:
    """Its reward is finite, of the shape of the prediction, and not constant."""
    import torch

    prediction = torch.linspace(-3.0, 3.0, 12).reshape(3, 4)
    reward = entry.factory({}).reward(prediction)
    ensure(reward.shape == prediction.shape, f"prediction {tuple(prediction.shape)} gives {tuple(reward.shape)}")
    ensure(bool(torch.isfinite(reward).all()), "is not finite for predictions from -3 to 3 standard deviations")
    ensure(float(reward.std()) > 0, "is the same for every prediction")


def objective_scores_segments(entry: Entry, registry: Registry) -> None:
    """It scores each segment with one number, and a policy equal to its reference neither gains nor loses."""
    objective = entry.factory({})
    segments = _segments(objective, registry)
    scores = objective.score(segments)
    for name, values in scores.items():
        ensure(
            np.shape(values) == (len(segments),), f"score '{name}' has shape {np.shape(values)}, not ({len(segments)},)"
        )
        ensure(bool(np.isfinite(values).all()), f"score '{name}' is not finite")
    means = {name: float(np.mean(values)) for name, values in scores.items()}
    comparison = objective.compare(means, means)
    ensure(isinstance(comparison, Comparison), "compare does not return a hts.contracts.Comparison")
    ensure(abs(comparison.improvement) < 1e-9, f"a policy equal to its reference improves by {comparison.improvement}")


def objective_names_its_instrument(entry: Entry, registry: Registry) -> None:
    """If it names an instrument for twins, that is installed and gives its target."""
    objective = entry.factory({})
    if objective.instrument is not None:
        given = {c.name for c in registry.make_instrument(objective.instrument, {}, TinyRobot()).channels}
        ensure(objective.target.name in given, f"'{objective.instrument}' gives {sorted(given)}, not the target")


def objective_proxy_keeps_shape(entry: Entry, registry: Registry) -> None:
    """Its proxy, if it has one, is one number per world."""
    import torch

    channels = {name: torch.rand(2, 5, *channel.shape) for name, channel in TinyRobot().channels().items()}
    proxy = entry.factory({}).proxy(channels)
    ensure(
        proxy is None or tuple(proxy.shape) == (2, 5), f"channels of [2, 5] worlds give {getattr(proxy, 'shape', None)}"
    )


def _segments(objective: Objective, registry: Registry) -> Any:
    """Segments of a made-up walk of a tiny robot, with every channel that the objective may ask for."""
    from hts.evaluation.segments import cut
    from hts.recordings.recording import Recording, Series

    robot, rng = TinyRobot(), np.random.default_rng(0)
    real: dict[str, Channel] = {objective.target.name: objective.target}
    if objective.instrument is not None:
        instrument = registry.make_instrument(objective.instrument, {}, robot)
        real |= {channel.name: channel for channel in instrument.channels}
    known = {**robot.channels(), **real}
    samples = 10 * round(robot.spec.control_rate_hz)
    values: dict[str, np.ndarray] = {
        name: 1.0 + rng.random((samples, *channel.shape)) for name, channel in known.items()
    }
    values["base_velocity"] = np.tile([0.8, 0.0, 0.0], (samples, 1))
    values["projected_gravity"] = np.tile([0.0, 0.0, -1.0], (samples, 1))
    recording = Recording(
        robot="tiny", world="made-up", policy_hash="", iteration=0,
        joint_names=robot.spec.joint_names, kp=robot.spec.kp, kd=robot.spec.kd, rate_hz=robot.spec.control_rate_hz,
        schedule=ScheduleConfig(commands=(Command(seconds=10.0, vx=0.8),)),
        idle=dict.fromkeys(real, 0.5), clock="simulated", time=np.arange(samples) / robot.spec.control_rate_hz,
        channels={name: Series(known[name], array) for name, array in values.items()}, mass_kg=10.0,
    )  # fmt: skip
    return cut([recording])


# ------------------------------------------------------------------------------------------------ robots


def robot_spec_is_consistent(entry: Entry, registry: Registry) -> None:
    """It is made without settings, and every tuple of its spec follows the joint order."""
    robot = entry.factory({})
    ensure(isinstance(robot, Robot), f"is a {type(robot).__name__}, not a hts.contracts.Robot")
    spec = robot.spec
    for name in ("default_pose", "kp", "kd", "action_scale", "torque_limit", "velocity_limit", "position_limit"):
        length = len(getattr(spec, name))
        ensure(length == spec.num_joints, f"spec.{name} has {length} entries for {spec.num_joints} joints")
    for joint, pose, (low, high) in zip(spec.joint_names, spec.default_pose, spec.position_limit, strict=True):
        ensure(low < pose < high, f"default pose of '{joint}' is {pose} rad, outside its limits {low} to {high}")
    period = spec.physics_dt * spec.substeps
    ensure(
        abs(period * spec.control_rate_hz - 1) < 1e-6, f"physics_dt · substeps = {period} s is not 1 / control_rate_hz"
    )


def robot_model_matches(entry: Entry, registry: Registry) -> None:
    """Its model, if it has one, compiles, has the joints, trunk and feet of the spec, and is made fresh each time."""
    robot = entry.factory({})
    root = robot.mjcf()
    if root is None:
        return
    ensure(robot.mjcf() is not root, "mjcf() gives the same object twice: a change to one would change the other")
    import mujoco

    from hts.sim.models import compile_model

    model = compile_model(robot)
    for kind, names in (
        (mujoco.mjtObj.mjOBJ_JOINT, robot.spec.joint_names),
        (mujoco.mjtObj.mjOBJ_BODY, (robot.spec.trunk_body,)),
        (mujoco.mjtObj.mjOBJ_SITE, robot.spec.foot_sites),
    ):
        for name in names:
            ensure(mujoco.mj_name2id(model, kind, name) >= 0, f"the model has no {kind.name[6:].lower()} '{name}'")


def robot_channels_fit(entry: Entry, registry: Registry) -> None:
    """Its channels are named as they are listed, and joint channels have one number per joint."""
    robot = entry.factory({})
    for name, channel in robot.channels().items():
        ensure(channel.name == name, f"channel '{channel.name}' is listed as '{name}'")
        if name.startswith("joint_"):
            ensure(channel.shape == (robot.spec.num_joints,), f"channel '{name}' has shape {channel.shape}")


def robot_policy_is_there(entry: Entry, registry: Registry) -> None:
    """Its pretrained policy, if it has one, is a .safetensors file with its .json beside it."""
    policy = entry.factory({}).pretrained_policy()
    if policy is not None:
        for file in (policy, policy.with_suffix(".json")):
            ensure(file.is_file(), f"{file} is not there")


# ------------------------------------------------------------------------------------------- instruments


def instrument_reads_what_it_says(entry: Entry, registry: Registry) -> None:
    """It gives its channels for every robot at once, finite, with an idle level each."""
    instrument = _used(entry, np.random.default_rng(0))
    names = {channel.name for channel in instrument.channels}
    readings = instrument.read()
    ensure(set(readings) == names, f"read() gives {sorted(readings)}, channels are {sorted(names)}")
    ensure(set(instrument.idle()) <= names, f"idle() gives {sorted(instrument.idle())}, channels are {sorted(names)}")
    for channel in instrument.channels:
        shape, wanted = np.shape(readings[channel.name]), (WORLDS, *channel.shape)
        ensure(shape == wanted, f"'{channel.name}' has shape {shape}, not {wanted}")
        ensure(bool(np.isfinite(readings[channel.name]).all()), f"'{channel.name}' is not finite")


def instrument_repeats_itself(entry: Entry, registry: Registry) -> None:
    """The same steps from the same random numbers give the same readings."""
    first, second = (_used(entry, np.random.default_rng(7)).read() for _ in range(2))
    for name in first:
        ensure(np.array_equal(first[name], second[name]), f"'{name}' differs from one time to the next")


def _used(entry: Entry, rng: np.random.Generator) -> Instrument:
    """A fresh instrument after 50 steps of made-up physics."""
    robot = TinyRobot()
    instrument = entry.factory({}, robot)
    ensure(isinstance(instrument, Instrument), f"is a {type(instrument).__name__}, not a hts.contracts.Instrument")
    instrument.reset(WORLDS, rng)
    made_up = np.random.default_rng(1)
    joints, feet = (WORLDS, robot.spec.num_joints), (WORLDS, len(robot.spec.foot_sites))
    for _ in range(50):
        instrument.step(
            PhysicsSample(
                motor_torque=made_up.normal(0, 5, joints),
                joint_velocity=made_up.normal(0, 5, joints),
                foot_force=made_up.uniform(0, 80, feet),
                foot_speed=made_up.uniform(0, 1, feet),
                foot_mass=np.full(feet, 0.5),
                dt=0.001,
            )
        )
    return instrument


# ------------------------------------------------------------------------------- selectors and the rest


def selector_picks_from_what_it_is_given(entry: Entry, registry: Registry) -> None:
    """Elites are at most as many as asked for, each once; the best is one of those tested, or None."""
    selector = entry.factory({})
    ensure(isinstance(selector, Selector), f"is a {type(selector).__name__}, not a hts.contracts.Selector")
    ids = [f"candidate-{index}" for index in range(5)]
    candidates = [SimulatedCandidate(name, float(index), 0, True) for index, name in enumerate(ids)]
    elites = list(selector.elites(candidates, 3))
    ensure(len(elites) <= 3 and len(set(elites)) == len(elites) and set(elites) <= set(ids), f"elites are {elites}")
    tested = [TestedCandidate(n, {"any": Comparison(0.1 * i, 0.1 * i)}, False) for i, n in enumerate(elites)]
    ensure(selector.best(tested) in {None, *elites}, f"the best is '{selector.best(tested)}'")
    ensure(selector.best([]) is None, "with nothing tested the best is not None")


def log_reader_is_one(entry: Entry, registry: Registry) -> None:
    """It is made without settings."""
    reader = entry.factory({})
    ensure(isinstance(reader, LogReader), f"is a {type(reader).__name__}, not a hts.contracts.LogReader")


def command_is_a_function(entry: Entry, registry: Registry) -> None:
    """It gives a function, and its factory's first line says what it does."""
    ensure(callable(entry.factory()), "the factory does not return a function")
    ensure(bool((entry.factory.__doc__ or "").strip()), "the factory has no docstring, so `hts --help` says nothing")


CHECKS: Mapping[str, tuple[Callable[[Entry, Registry], None], ...]] = {
    "objectives": (
        objective_has_its_parts, objective_has_a_model, objective_reward_keeps_shape, objective_scores_segments,
        objective_names_its_instrument, objective_proxy_keeps_shape,
    ),
    "robots": (robot_spec_is_consistent, robot_model_matches, robot_channels_fit, robot_policy_is_there),
    "worlds": (),
    "instruments": (instrument_reads_what_it_says, instrument_repeats_itself),
    "selectors": (selector_picks_from_what_it_is_given,),
    "log_readers": (log_reader_is_one,),
    "commands": (command_is_a_function,),
}  # fmt: skip
