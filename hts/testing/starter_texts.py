"""The texts of the packages that `hts new` writes. $name and its like are filled in by `starters.write_starter`."""

from __future__ import annotations

PROJECT = """[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"

[project]
name = "$package"
version = "0.1.0"
description = "The $kind $name for hard-to-sim"
requires-python = ">=3.11,<3.13"
dependencies = ["hard-to-sim>=0.1,<0.2"]

[project.entry-points.hts]
$name = "$module.plugin"

[tool.hatch.build]
dev-mode-dirs = ["."]

[tool.hatch.build.targets.wheel]
packages = ["$module"]
"""

TEST = '''"""What `hts check $package` looks at, as a test."""

from hts.plugins import load
from hts.testing.conformance import check_package


def test_the_package_keeps_the_contracts():
    faults = [finding for finding in check_package(load(), "$package") if finding.fault is not None]
    assert not faults
'''

OBJECTIVE_PLUGIN = '''"""Registers the objective `$name` and its instrument. Imports nothing heavy."""

from __future__ import annotations

from hts import hookimpl

HTS_API = 1


@hookimpl
def hts_objectives(register):
    register("$name", make_objective)


@hookimpl
def hts_instruments(register):
    register("${name}_meter", make_meter)


def make_objective(settings):
    """What $name is, in one line."""
    from $module import objective

    return objective.$Name(objective.Settings(**settings))


def make_meter(settings, robot):
    """The sensor of $name on a twin."""
    from $module import objective

    return objective.Meter(objective.MeterSettings(**settings))
'''

OBJECTIVE = '''"""The objective `$name`: what is measured, what predicts it, what counts as better."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from hts.channels import Channel
from hts.config import Config
from hts.contracts import Comparison, Instrument, Objective

TARGET = Channel("$name", "1", (), "the real channel: replace its unit and say what the number is")


class Settings(Config):
    """Settings of the objective: `--set objectives.$name.hidden=32`."""

    hidden: int = Field(64, ge=1, description="units of the measurement model")


class $Name(Objective):
    """Less of it is better. The improvement is the fraction saved of what is above the idle level."""

    name = "$name"
    unit = "1"
    inputs = ("joint_torque", "joint_velocity")
    target = TARGET
    weights = (0.5, 1.0, 5.0)
    instrument = "${name}_meter"

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def measurement_model(self):
        from hts.measurement.models import MeasurementModelConfig

        return MeasurementModelConfig(inputs=self.inputs, target=self.target.name, hidden=self.settings.hidden)

    def reward(self, prediction):
        """The prediction is in standard deviations of the data; less is better."""
        return -prediction

    def score(self, segments):
        gross = segments.values(self.target.name).mean(axis=1)
        return {"net": gross - segments.idle(self.target.name), "gross": gross}

    def compare(self, policy, reference):
        saved = 1.0 - policy["net"] / reference["net"]
        return Comparison(saved, saved, {"gross_reduction": 1.0 - policy["gross"] / reference["gross"]})


class MeterSettings(Config):
    """Settings of the instrument: `--set world.instruments.${name}_meter.idle=2`."""

    idle: float = Field(1.0, ge=0, description="reading with motors idle")
    delay: float = Field(0.1, gt=0, description="time constant of the reading, s")


class Meter(Instrument):
    """A made-up sensor: mean absolute joint work rate, read slowly. Replace it by the physics of the real one."""

    channels = (TARGET,)

    def __init__(self, settings: MeterSettings) -> None:
        self.settings = settings

    def reset(self, num_worlds, rng):
        self.level = np.full(num_worlds, self.settings.idle)

    def step(self, sample):
        now = self.settings.idle + np.abs(sample.motor_torque * sample.joint_velocity).mean(axis=-1)
        self.level = self.level + (now - self.level) * min(1.0, sample.dt / self.settings.delay)

    def read(self):
        return {TARGET.name: self.level}

    def idle(self):
        return {TARGET.name: self.settings.idle}

    def describe(self):
        return self.settings.model_dump()
'''

ROBOT_PLUGIN = '''"""Registers the robot `$name`. Imports nothing heavy."""

from __future__ import annotations

from hts import hookimpl

HTS_API = 1


@hookimpl
def hts_robots(register):
    register("$name", make_robot)


def make_robot(settings):
    """What kind of machine $name is, in one line."""
    from $module import robot

    return robot.$Name(robot.Settings(**settings))
'''

ROBOT = '''"""The robot `$name`, log-only: enough for `hts import` and `hts fit`. Give it a model to train with it."""

from __future__ import annotations

from hts.channels import standard_channels
from hts.config import Config
from hts.contracts import Robot, RobotSpec

# Replace every number, and write its source beside it.
SPEC = RobotSpec(
    name="$name",
    joint_names=("hip", "knee"),
    default_pose=(0.0, 0.5),
    kp=(20.0, 20.0),
    kd=(0.5, 0.5),
    action_scale=(0.25, 0.25),
    torque_limit=(20.0, 20.0),
    velocity_limit=(20.0, 20.0),
    position_limit=((-1.0, 1.0), (0.0, 2.0)),
    control_rate_hz=50.0,
    physics_dt=0.005,
    substeps=4,
    base_height=0.3,
    foot_sites=("foot",),
)


class Settings(Config):
    """Settings of the robot; it has none yet."""


class $Name(Robot):
    """A machine with joints and channels."""

    spec = SPEC

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def mjcf(self):
        return None

    def channels(self):
        return standard_channels(self.spec.num_joints, len(self.spec.foot_sites))

    def pretrained_policy(self):
        return None
'''

SELECTOR_PLUGIN = '''"""Registers the selector `$name`. Imports nothing heavy."""

from __future__ import annotations

from hts import hookimpl

HTS_API = 1


@hookimpl
def hts_selectors(register):
    register("$name", make_selector)


def make_selector(settings):
    """How $name chooses, in one line."""
    from $module import selector

    return selector.$Name(selector.Settings(**settings))
'''

SELECTOR = '''"""The selector `$name`: which candidates are tested on the robot, and which of those goes on."""

from __future__ import annotations

from hts.config import Config
from hts.contracts import Selector


class Settings(Config):
    """Settings of the selector: `--set selection.selector.name=$name`."""


class $Name(Selector):
    """The best in simulation are tested; the best on the robot goes on."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def elites(self, candidates, count):
        def rank(candidate):
            return (candidate.falls > 0, not candidate.tracked, -candidate.score)

        return [candidate.id for candidate in sorted(candidates, key=rank)[:count]]

    def best(self, tested):
        def gain(candidate):
            return next(iter(candidate.comparisons.values())).selection_score

        standing = [candidate for candidate in tested if not candidate.fell and gain(candidate) > 0]
        return max(standing, key=gain).id if standing else None
'''

STARTERS: dict[str, tuple[str, str]] = {
    "objective": (OBJECTIVE_PLUGIN, OBJECTIVE),
    "robot": (ROBOT_PLUGIN, ROBOT),
    "selector": (SELECTOR_PLUGIN, SELECTOR),
}
