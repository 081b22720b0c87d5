"""What a plugin implements: Robot, Task, Objective, MeasurementModel, Instrument, World, Selector, LogReader.

Interfaces only, one file each, a handful of methods each. Nothing here imports torch or mujoco, so that a
plugin's module loads in milliseconds; heavy imports belong inside the methods.
"""

from hts.contracts.installed import Installed
from hts.contracts.instrument import Fact, Instrument, PhysicsSample, Reading
from hts.contracts.log_reader import LogReader
from hts.contracts.measurement_model import (
    MODEL,
    MeasurementModel,
    ModelContext,
    Prediction,
    Signals,
    chosen_model,
    own_settings,
    physics_steps_of,
    robot_signals,
)
from hts.contracts.objective import Comparison, Objective
from hts.contracts.parameter import parameter, parameters, structural
from hts.contracts.robot import JointMotors, LogOnlyRobot, Robot, RobotSpec
from hts.contracts.selector import FineTuning, RacedCandidate, Rounds, Selector, SimulatedCandidate, TestedCandidate
from hts.contracts.settings import Settings
from hts.contracts.task import VELOCITY, FollowVelocity, Task
from hts.contracts.world import HoldSpeed, Requests, World, WorldContext

__all__ = [
    "MODEL",
    "VELOCITY",
    "Comparison",
    "Fact",
    "FineTuning",
    "FollowVelocity",
    "HoldSpeed",
    "Installed",
    "Instrument",
    "JointMotors",
    "LogOnlyRobot",
    "LogReader",
    "MeasurementModel",
    "ModelContext",
    "Objective",
    "PhysicsSample",
    "Prediction",
    "RacedCandidate",
    "Reading",
    "Requests",
    "Robot",
    "RobotSpec",
    "Rounds",
    "Selector",
    "Settings",
    "Signals",
    "SimulatedCandidate",
    "Task",
    "TestedCandidate",
    "World",
    "WorldContext",
    "chosen_model",
    "own_settings",
    "parameter",
    "parameters",
    "physics_steps_of",
    "robot_signals",
    "structural",
]
