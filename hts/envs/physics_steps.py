"""What the physics steps within a control step were like, for who asks for those channels."""

from __future__ import annotations

import torch

from hts.channels import SUBSTEP_FORCE, SUBSTEP_TORQUE, SUBSTEP_VELOCITY
from hts.errors import SimulationError
from hts.sim.engine import Engine

SUBSTEPS = (SUBSTEP_TORQUE, SUBSTEP_VELOCITY, SUBSTEP_FORCE)


def in_physics_steps(name: str, engine: Engine, torques: slice, touch: slice) -> torch.Tensor:
    """One of SUBSTEPS in each of the K physics steps of the last control step, (W, K, ...).

    torques, touch: where these lie in the engine's sensordata. Raises SimulationError for an engine that keeps its
    last state alone.
    """
    kept = engine.physics_steps()
    if kept is None:
        raise SimulationError(
            f"Channel '{name}' needs every physics step, and this engine keeps the last one alone. Ask for it when the "
            "env is made, or take an engine that keeps them (Engine.physics_steps)."
        )
    qvel, sensors = kept
    if name == SUBSTEP_VELOCITY:
        return qvel[..., 6:]  # behind the trunk's own
    return sensors[..., torques if name == SUBSTEP_TORQUE else touch]
