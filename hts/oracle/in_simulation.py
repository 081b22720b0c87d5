"""`hts oracle --in-simulation`: a run whose reward alone sees inside the reality.

Data, fits, λ, bounds, promises, tests and final are those of `hts run`; in training and in judging the reality's own
instruments stand in the place of the fitted model. So what it saves more than a run is what a better model could add.
"""

from __future__ import annotations

from typing import Any

from torchrl.envs.transforms import Transform

from hts.config import RunConfig
from hts.measurement.transform import Measured
from hts.parts import make_model, objectives_of, robot_of
from hts.plugins import Registry
from hts.run.job import Job
from hts.run.ready import check_ready, check_step
from hts.run.speed import control_steps_per_second
from hts.worlds.oracle import IN_SIMULATION
from hts.worlds.oracle.robot import check_walks_by_velocity
from hts.worlds.oracle.simulated import CHANNELS, ExactMeasurement, Seeing, check_exact

__all__ = ["SimulatedOracleJob", "check", "control_steps_per_second", "prepared"]


class SimulatedOracleJob(Job):
    """A job whose candidates train in simulation, as a run's do, paid by the exact measurement of that simulation."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.note = IN_SIMULATION
        config = self.config
        self._seeing = Seeing.of(self.robot, config.world.settings, config.objectives, self.registry)

    def rewards(self, iteration: int) -> list[Measured]:
        """The exact measurement for each objective, in the scale of the model that was fitted."""
        made: list[Measured] = []
        for name, objective in self.objectives.items():
            made.append(ExactMeasurement(objective, self.model(iteration, name), self._seeing))
        return made


def prepared(config: RunConfig, registry: Registry) -> RunConfig:
    """The configuration as it is written, but that a GPU takes its steps one by one: instruments compute on the host,
    which no captured step can wait for."""
    if config.engine == "mujoco":
        return config
    uncaptured = config.finetune.ppo.model_copy(update={"capture": False})
    return config.model_copy(update={"finetune": config.finetune.model_copy(update={"ppo": uncaptured})})


def check(config: RunConfig, registry: Registry) -> None:
    """What can be checked before anything is spent, beside names: each mistake is one line."""
    robot = robot_of(config, registry)
    check_walks_by_velocity(robot)
    seeing = Seeing.of(robot, config.world.settings, config.objectives, registry)
    objectives = objectives_of(config, registry)
    check_exact(seeing, objectives)
    check_ready(config, registry, config.engine)

    def looking() -> list[Transform]:
        models = {name: make_model(registry, one, config.objectives[name], robot) for name, one in objectives.items()}
        return [ExactMeasurement(one, models[name], seeing) for name, one in objectives.items()]

    check_step(config, robot, config.engine, CHANNELS, looking)
