"""Compiled variants of a robot's model for domain randomisation."""

from __future__ import annotations

import copy
import math
from xml.etree import ElementTree

import mujoco
import numpy as np

from hts.config import RandomisationConfig
from hts.contracts import Robot
from hts.errors import ConfigError, PluginError
from hts.guarded import guarded
from hts.sim.conventions import FLOOR, check_conventions

MOST_LOAD = 5.0
"""Times its own mass; what carries more is no robot that walks. In grams one kilogram is a thousand."""


def compile_model(robot: Robot) -> mujoco.MjModel:
    """The robot's nominal model at its training time step. Raises ConfigError for a robot without one, PluginError for
    what is no tree of dm_control."""
    from dm_control import mjcf

    root = guarded(f"Robot '{robot.spec.name}': mjcf()", robot.mjcf)
    if root is None:
        if type(robot).make_env is Robot.make_env:
            why = "it is log-only, for `hts import` and `hts fit`."
        else:
            why = (
                "it brings an env of its own, which is what `hts run` and `hts evaluate` use. What plays or compares "
                "the velocity task needs its mjcf()."
            )
        raise ConfigError(f"Robot '{robot.spec.name}' has no model to simulate here: {why}")
    name = f"Robot '{robot.spec.name}'"
    if not isinstance(root, mjcf.RootElement):
        raise PluginError(
            f"{name}: mjcf() gives a {type(root).__name__}, expected a tree of dm_control, fresh each time: "
            "mjcf.from_path(FILE) of a file, mjcf.from_xml_string(TEXT) of a text (from dm_control import mjcf)."
        )
    text, assets = guarded(f"{name}: writing what mjcf() gives", lambda: (root.to_xml_string(), root.get_assets()))
    if fault := not_a_number(text):
        raise ConfigError(
            f"{name}: its model has {fault}. Correct it where it is made: MuJoCo takes some of these for left out, and "
            "simulates the others."
        )
    model = guarded(f"{name}: compiling what mjcf() gives", lambda: mujoco.MjModel.from_xml_string(text, assets))
    model.opt.timestep = robot.spec.physics_dt
    return model


def not_a_number(text: str) -> str:
    """The first attribute of an MJCF text with a NaN among its numbers, in words; empty for none."""
    for element in ElementTree.fromstring(text).iter():
        for attribute, value in element.attrib.items():
            if "nan" in value.lower() and any(math.isnan(one) for one in _numbers(value)):
                return f'{attribute}="{value}" in <{element.tag} name="{element.get("name", "")}">'
    return ""


def _numbers(value: str) -> list[float]:
    """Of an attribute that holds numbers and nothing else."""
    try:
        return [float(one) for one in value.split()]
    except ValueError:
        return []


def moving_mass(model: mujoco.MjModel) -> float:
    """Of all that is not fixed to the world, kg."""
    return float(model.body_mass[model.body_weldid != 0].sum())


def check_added_mass(model: mujoco.MjModel, robot: Robot, added: tuple[float, float], where: str) -> None:
    """Raise ConfigError for a trunk that would weigh nothing or less, or a load that no robot carries. added: kg;
    where: the key that says so."""
    mass = float(model.body(robot.spec.trunk_body).mass[0])
    if not mass > 0:
        raise ConfigError(
            f"Robot '{robot.spec.name}': body '{robot.spec.trunk_body}' of its model has no mass, so none can be added "
            "to it. Give that body the <inertial> of the bodies that are fixed to it, or, where a child of it is the "
            "trunk, put the <freejoint/> there and name it SPEC.trunk_body."
        )
    if not mass + added[0] > 0:
        raise ConfigError(
            f"{where}: {added[0]:g} kg would leave nothing of the trunk of '{robot.spec.name}', which weighs "
            f"{mass:.3g} kg. Raise the lower end."
        )
    whole = moving_mass(model)
    if added[1] > MOST_LOAD * whole:
        raise ConfigError(
            f"{where}: expected at most {MOST_LOAD * whole:.3g} kg, {MOST_LOAD:g} times what '{robot.spec.name}' "
            f"weighs, found {added[1]:g}. It is probably in another unit: write kg, not g."
        )


def variants(robot: Robot, config: RandomisationConfig, seed: int, count: int | None = None) -> list[mujoco.MjModel]:
    """A pool of randomised models; just the nominal one if randomisation is off. Raises ConfigError for a model that
    is not as the velocity task takes it for granted (`hts.sim.conventions`).

    The pool depends on `seed` alone, never on the number of candidates, so that a candidate meets the same
    worlds whoever trains beside it. One model per world would cost time and copies for no gain.
    """
    nominal = compile_model(robot)  # once: a copy takes a hundredth of the time
    check_conventions(nominal, robot.spec)
    if not config.enabled:
        return [nominal]
    rng = np.random.default_rng([seed, 7201])
    where = "randomisation.added_mass (below finetune.env of a run, env of a pretraining)"
    check_added_mass(nominal, robot, config.added_mass, where)
    return [vary(copy.copy(nominal), robot, config, rng) for _ in range(count or config.models)]


def vary(model: mujoco.MjModel, robot: Robot, config: RandomisationConfig, rng: np.random.Generator) -> mujoco.MjModel:
    """Draw one variant in place: floor friction, trunk mass and centre of mass, gains, joint friction."""
    trunk = model.body(robot.spec.trunk_body).id
    model.geom(FLOOR).friction[0] = rng.uniform(*config.friction)
    before = model.body_mass[trunk]
    model.body_mass[trunk] += rng.uniform(*config.added_mass)
    model.body_inertia[trunk] *= model.body_mass[trunk] / before
    model.body_ipos[trunk] += rng.uniform(*config.com_shift, size=3)
    strength = rng.uniform(*config.strength, size=model.nu)
    model.actuator_gainprm[:, 0] *= strength
    model.actuator_biasprm[:, 1:3] *= strength[:, None]
    model.dof_frictionloss[6:] *= rng.uniform(*config.joint_friction, size=model.nv - 6)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model
