"""The interface of a physics engine that steps many worlds of one robot."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import mujoco
    import torch


class Engine(ABC):
    """W worlds stepped together. Tensors live on `device`, float32, and are rewritten in place by each step.

    qpos (W, nq): free joint [x y z m, quaternion w x y z], then joints rad; qvel (W, nv): trunk linear velocity m/s in
    the world frame, angular velocity rad/s in the trunk frame, then joints rad/s; sensordata (W, ns), see `sensor`;
    diverged (W,) bool: worlds whose physics broke in the last step, until they are reset.
    """

    num_worlds: int
    device: torch.device
    qpos: torch.Tensor
    qvel: torch.Tensor
    sensordata: torch.Tensor
    diverged: torch.Tensor
    finite_when_diverged = True
    """Whether qpos, qvel and sensordata of a world whose physics broke still hold numbers."""

    @abstractmethod
    def step(self, ctrl: torch.Tensor) -> None:
        """Advance every world by one control step. ctrl (substeps, W, nu): actuator inputs of each physics step."""

    @abstractmethod
    def reset(self, mask: torch.Tensor, qpos: torch.Tensor, qvel: torch.Tensor) -> None:
        """Put the worlds of mask (W,) into rows of qpos (W, nq), qvel (W, nv); other rows are not read."""

    def push(self, mask: torch.Tensor, velocity: torch.Tensor) -> None:
        """Add velocity (W, 2), m/s, to the trunk's horizontal velocity in the worlds of mask (W,);
        their solver starts cold."""
        qvel = self.qvel.clone()
        qvel[:, :2] += velocity
        self.reset(mask, self.qpos, qvel)

    def nudge(self, velocity: torch.Tensor) -> None:
        """Add a little velocity (W, 2), m/s, to the trunk's horizontal velocity in every world that has not diverged.
        An engine whose solver may stay warm then says so by a method of its own."""
        self.push(~self.diverged, velocity)

    @abstractmethod
    def sensor(self, name: str) -> slice:
        """Where a sensor of the MJCF lies in `sensordata`."""

    @abstractmethod
    def state_dict(self) -> dict[str, torch.Tensor]:
        """Everything needed to go on exactly from here."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, torch.Tensor]) -> None:
        """Go on from a saved state."""

    def snapshot(self, ctrl: torch.Tensor) -> Any:
        """What a control step with these inputs starts from here; for `replay`."""
        return self.state_dict(), ctrl.clone()

    def replay(self, steps: Sequence[Any]) -> None:
        """The physics of remembered control steps, one after the other; afterwards the engine is where it was."""
        here = self.state_dict()
        for state, ctrl in steps:
            self.load_state_dict(state)
            self.step(ctrl)
        self.load_state_dict(here)

    def physics_steps(self) -> tuple[torch.Tensor, torch.Tensor] | None:
        """Of each of the K physics steps of the last control step: qvel (W, K, nv), the mean of before and after it,
        and sensordata (W, K, ns). None: this engine keeps its last state alone."""
        return None

    def check(self) -> None:  # noqa: B027
        """Raise SimulationError if a buffer overflowed since the start. May wait for the device: call it rarely."""

    def close(self) -> None:  # noqa: B027
        """Let go of threads and device memory."""


def sensor_slices(model: mujoco.MjModel) -> dict[str, slice]:
    """Name -> columns of sensordata."""
    slices = {}
    for index in range(model.nsensor):
        start = int(model.sensor_adr[index])
        slices[model.sensor(index).name] = slice(start, start + int(model.sensor_dim[index]))
    return slices
