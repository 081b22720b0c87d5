"""Made-up things to try plugins on: a walk of the tiny robot, physics steps, something of each kind by its factory."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hts.channels import Channel
from hts.config import Named
from hts.contracts import ModelContext, Objective, PhysicsSample, Robot, World, WorldContext
from hts.errors import HtsError
from hts.evaluation.segments import Segments, cut
from hts.plugins import KINDS, Entry, Registry
from hts.recordings.recording import Recording
from hts.testing.examples.objective.objective import Fake
from hts.testing.examples.robot.robot import Tiny
from hts.testing.known_signals import SIGNALS
from hts.testing.made_up_recordings import made_up_recording

WORLDS = 3
NOWHERE = Path(tempfile.gettempdir()) / "hts-check-nowhere"  # a name only: worlds write with their first request


def kind_of(entry: Entry, registry: Registry) -> str:
    """The kind (as in `hts.plugins.KINDS`) under which the registry has it."""
    return next(kind for kind in KINDS if registry.offered(kind).get(entry.name) is entry)


@dataclass(frozen=True)
class Case:
    """A robot and an objective to try a world with, and how a run's context names them."""

    robot: Robot
    objective: Objective
    names: tuple[str, str]

    def context(self, folder: Path = NOWHERE) -> WorldContext:
        robot, objective = self.names
        return WorldContext(robot=robot, robot_settings={}, objectives={objective: {}}, seed=0, folder=folder)


def case_for(world: Entry, registry: Registry) -> Case:
    """The first of these that the world takes: the kit's own robot and objective; robots of the world's package, each
    with objectives of that package, then with the kit's, then with any other that is installed."""
    kit = Case(Tiny(), Fake(), ("tiny", "fake"))
    if _takes(world, kit):
        return kit
    ours = [entry for entry in registry.objectives.values() if entry.package == world.package]
    others = [entry for entry in registry.objectives.values() if entry.package != world.package]
    for entry in (entry for entry in registry.robots.values() if entry.package == world.package):
        robot = registry.make_robot(entry.name)
        pairs = [*_made(ours, registry), (kit.objective, "fake")]
        pairs += _made((one for one in others if one.name != "fake"), registry)
        for objective, name in pairs:
            case = Case(robot, objective, (entry.name, name))
            if set(objective.inputs) <= set(robot.channels()) and _takes(world, case):
                return case
    return kit


def _made(entries: Iterable[Entry], registry: Registry) -> list[tuple[Objective, str]]:
    """Those of the objectives that can be made, with their names: another's fault is found when that one is checked."""
    found: list[tuple[Objective, str]] = []
    for entry in entries:
        with suppress(HtsError):
            found.append((registry.make_objective(entry.name), entry.name))
    return found


def _takes(world: Entry, case: Case) -> bool:
    """Whether a world of that robot and objective can be made."""
    try:
        made = world.factory({}, case.context())
        if isinstance(made, World):
            made.close()
    except HtsError:  # this world does not know that robot or objective
        return False
    return True


def rest_of(kind: str, entry: Entry, registry: Registry) -> tuple[Any, ...]:
    """What a factory of that kind gets after the settings."""
    if kind == "worlds":
        return (case_for(entry, registry).context(),)
    if kind == "measurement_models":
        return (ModelContext(SIGNALS, Named(name="linear"), registry),)
    return (Tiny(),) if kind == "instruments" else ()


def real_channels(objective: Objective, registry: Registry) -> dict[str, Channel]:
    """What the robot alone gives for an objective: what it measures and whatever else its instrument does."""
    real = {channel.name: channel for channel in objective.real_channels}
    if objective.instrument is not None:
        instrument = registry.make_instrument(objective.instrument, {}, Tiny())
        real |= {channel.name: channel for channel in instrument.channels}
    return real


def sim_channels(registry: Registry) -> dict[str, Channel]:
    """All sim channels that somebody's robot gives, the kit's own included."""
    found: dict[str, Channel] = {}
    for name in registry.robots:
        with suppress(Exception):  # another robot's fault is found when that robot is checked
            found |= registry.make_robot(name).channels()
    return {**found, **Tiny().channels()}


def walk(objective: Objective, registry: Registry, seed: int = 0, factor: float = 1.0) -> Recording:
    """10 s of a made-up walk with every channel that the objective may ask for.

    factor: on what the target shows above its idle level of 0.5.
    """
    sim, real = sim_channels(registry), real_channels(objective, registry)
    return made_up_recording(sim, real, {objective.target.name: factor}, seed=seed)


def segments(objective: Objective, registry: Registry, factor: float = 1.0) -> Segments:
    return cut([walk(objective, registry, factor=factor)])


def physics(rng: np.random.Generator, worlds: int = WORLDS) -> PhysicsSample:
    """One made-up millisecond of so many robots."""
    spec = Tiny().spec
    joints, feet = (worlds, spec.num_joints), (worlds, len(spec.foot_sites))
    return PhysicsSample(
        motor_torque=rng.normal(0, 0.5, joints),
        joint_velocity=rng.normal(0, 5, joints),
        foot_force=rng.uniform(0, 40, feet),
        foot_speed=rng.uniform(0, 1, feet),
        foot_mass=np.full(feet, 0.5),
        dt=0.001,
    )


def rest(worlds: int = WORLDS) -> PhysicsSample:
    """One millisecond of so many robots that stand still with their motors off."""
    spec = Tiny().spec
    joints, feet = np.zeros((worlds, spec.num_joints)), np.zeros((worlds, len(spec.foot_sites)))
    return PhysicsSample(joints, joints.copy(), feet + 10.0, feet, feet + 0.5, dt=0.001)


def arrays(sample: PhysicsSample) -> Mapping[str, np.ndarray]:
    return {name: value for name, value in vars(sample).items() if isinstance(value, np.ndarray)}
