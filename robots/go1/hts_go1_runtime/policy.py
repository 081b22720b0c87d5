"""One policy of a bundle on one robot: onnxruntime and numpy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import onnxruntime

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.link import State

PARTS = {
    "angular_velocity": 3,
    "projected_gravity": 3,
    "command": 3,
    "joint_position_offset": 12,
    "joint_velocity": 12,
    "last_action": 12,
}
"""What a policy may observe here, and how many numbers that is."""

NOWHERE = "/dev/null/none"
"""A folder that cannot be there. onnxruntime knows this setting since 1.18, and ignores it before."""


class Policy:
    """entry: what the manifest says of it; content: the graph's bytes.

    Raises RuntimeFault for a graph that onnxruntime does not take, or that is not what the manifest says.
    """

    def __init__(self, entry: Mapping[str, Any], content: bytes, where: str) -> None:
        self.entry, self.where = entry, where
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 3
        try:
            # Constants that lie in other files would be read from the working directory: no checksum covers them.
            options.add_session_config_entry("session.model_external_initializers_file_folder_path", NOWHERE)
            self._session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime raises its own classes for each way a graph can be broken
            raise RuntimeFault(
                f"{where}: onnxruntime does not take it ({' '.join(str(error).split())[:120]})."
            ) from error
        self.pose = np.asarray(entry["default_pose"], float)
        self.scale = np.asarray(entry["action_scale"], float)
        self.kp, self.kd = np.asarray(entry["kp"], float), np.asarray(entry["kd"], float)
        self._parts = [str(part["name"]) for part in entry["observation"]]
        self._size, self._history_length = sum(PARTS[name] for name in self._parts), int(entry["history"])
        self._outputs = ["action", "mean_action"] if entry["exploration"] else ["action"]
        self._check_ends()
        self.metadata: Mapping[str, str] = self._session.get_modelmeta().custom_metadata_map
        self.start()
        self._check_runs()

    def start(self) -> None:
        """Begin with no past."""
        self.last_action = np.zeros(12, np.float32)
        self._history = np.zeros((self._history_length, self._size), np.float32)

    def targets(self, state: State, command: np.ndarray) -> np.ndarray:
        """Joint targets (12,), rad, from a state and the command vx m/s, vy m/s, yaw rate rad/s."""
        values = {
            "angular_velocity": state.gyro,
            "projected_gravity": state.gravity,
            "command": command,
            "joint_position_offset": state.q - self.pose,
            "joint_velocity": state.dq,
            "last_action": self.last_action,
        }
        self._history[:-1] = self._history[1:]
        self._history[-1] = np.concatenate([values[name] for name in self._parts])
        self.last_action = self._session.run(["action"], {"observation": self._history.reshape(1, -1)})[0][0]
        return self.pose + self.scale * self.last_action

    def _check_runs(self) -> None:
        """One step with a history of zeros: what is wrong with a graph's numbers, or with this computer's onnxruntime,
        shows before a robot stands."""
        try:
            action = self._session.run(["action"], {"observation": self._history.reshape(1, -1)})[0]
        except Exception as error:  # see above
            raise RuntimeFault(
                f"{self.where}: onnxruntime {onnxruntime.__version__} cannot run it "
                f"({' '.join(str(error).split())[:120]})."
            ) from error
        if action.shape != (1, 12) or not np.isfinite(action).all():
            raise RuntimeFault(
                f"{self.where}: its action for an observation of zeros is {' '.join(str(action).split())[:60]}, "
                "expected 12 finite numbers. Do not run it: look for the policy that it was made from."
            )

    def _check_ends(self) -> None:
        for what, found, names, size in (
            ("reads", self._session.get_inputs(), ["observation"], self._history_length * self._size),
            ("gives", self._session.get_outputs(), self._outputs, 12),
        ):
            shown = [(one.name, one.type, one.shape[-1] if one.shape else None) for one in found]
            if shown != [(name, "tensor(float)", size) for name in names]:
                raise RuntimeFault(
                    f"{self.where}: the graph {what} {shown}, the manifest says {', '.join(names)} of {size} float32. "
                    "Make the bundle again."
                )
