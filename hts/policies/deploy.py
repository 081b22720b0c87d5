"""A policy on a robot: ONNX and numpy only, no torch. What a twin and a real robot's computer both run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import onnxruntime

from hts.errors import PolicyError
from hts.policies.card_checks import check_card
from hts.policies.onnx_checks import read_checked

CARD_KEY, NOISE_KEY = "hts", "hts_exploration"


class DeployedPolicy:
    """An exported policy driving W robots at once.

    card: its PolicyCard as a plain namespace. Raises PolicyError for a file that is not an exported policy.
    """

    def __init__(self, path: Path) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        try:
            # The bytes, not the path: a graph whose constants lie in other files would make onnxruntime open those.
            content = Path(path).read_bytes()
            read_checked(Path(path), content, "an exported policy")
            self._session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
            meta = self._session.get_modelmeta().custom_metadata_map
            card: dict[str, Any] = json.loads(meta[CARD_KEY])
        except PolicyError:
            raise
        except Exception as error:  # onnxruntime raises its own classes for each way a file can be broken
            raise PolicyError(
                f"{path}: not an exported policy ({type(error).__name__}: {str(error)[:120]}). Export it again with "
                "`hts export`."
            ) from error
        check_card(card, path)
        explores = NOISE_KEY in meta
        self._check_ends(path, card, explores)
        self.card = SimpleNamespace(**{"history": 1, **card})
        self._pose = np.asarray(card["default_pose"], np.float32)
        self._scale = np.asarray(card["action_scale"], np.float32)
        # A graph with noise inside (`hts.policies.exploring`) adds it by itself.
        self._noise = np.asarray(() if explores else card.get("exploration_std", ()), np.float32)
        self._parts = [part["name"] for part in card["observation"]]
        self.start(1)

    def _check_ends(self, path: Path, card: Mapping[str, Any], explores: bool) -> None:
        """Raises PolicyError unless the graph takes the observation of the card and gives one action per joint, and
        beside it the mean action where it adds noise by itself."""
        seen = card.get("history", 1) * sum(part["size"] for part in card["observation"])
        for what, values, names, size in (
            ("reads", self._session.get_inputs(), ("observation",), seen),
            ("gives", self._session.get_outputs(), ("action", "mean_action")[: 1 + explores], len(card["joint_names"])),
        ):
            found = [(value.name, value.type, value.shape[-1] if value.shape else None) for value in values]
            if found != [(name, "tensor(float)", size) for name in names]:
                shown = ", ".join(f"{other} ({kind}, {width} wide)" for other, kind, width in found[:4])
                raise PolicyError(
                    f"{path}: its graph {what} {shown or 'nothing'}, its card says {', '.join(names)} (tensor(float), "
                    f"{size} wide). Export it again with `hts export`."
                )

    def start(self, num: int, seed: int | None = None) -> None:
        """Begin with `num` robots, no past. seed: of the exploration noise, for policies exported with some."""
        self._random = np.random.default_rng(seed)
        self._last_action = np.zeros((num, self._pose.size), np.float32)
        size = sum(part["size"] for part in self.card.observation)
        self._history = np.zeros((num, self.card.history, size), np.float32)

    def reset(self, mask: np.ndarray) -> None:
        """Forget the past of the robots of mask (W,) bool."""
        self._last_action[mask] = 0.0
        self._history[mask] = 0.0

    def targets(self, readings: Mapping[str, np.ndarray]) -> np.ndarray:
        """Joint position targets (W, J), rad, from sensor readings: angular_velocity (W, 3) rad/s,
        projected_gravity (W, 3), command (W, 3), joint_position (W, J) rad, joint_velocity (W, J) rad/s."""
        offset = readings["joint_position"] - self._pose
        return self._pose + self._scale * self.action({**readings, "joint_position_offset": offset})

    def action(self, readings: Mapping[str, np.ndarray]) -> np.ndarray:
        """The action itself (W, J), for machines whose actions are no joint targets. readings: every part of the
        policy's observation by its name, (W, size); `last_action` is added."""
        values = {**readings, "last_action": self._last_action}
        observation = np.concatenate([np.asarray(values[name], np.float32) for name in self._parts], axis=1)
        if self.card.history > 1:
            self._history = np.roll(self._history, -1, axis=1)
            self._history[:, -1] = observation
            observation = self._history.reshape(len(observation), -1)
        self._last_action = self._session.run(["action"], {"observation": observation})[0]
        if len(self._noise):
            noise = self._random.standard_normal(self._last_action.shape, np.float32)
            self._last_action = self._last_action + self._noise * noise
        return self._last_action

    def replayed(self, readings: Mapping[str, np.ndarray]) -> np.ndarray:
        """Actions (T, J), without noise of ours, in T rows of one walk that was recorded. readings: as `action`, each
        (T, size), with the `last_action` of the record."""
        rows = np.concatenate([np.asarray(readings[name], np.float32) for name in self._parts], axis=1)
        past = np.vstack([np.zeros((self.card.history - 1, rows.shape[1]), np.float32), rows])
        stacked = [past[first : first + len(rows)] for first in range(self.card.history)]
        found: np.ndarray = self._session.run(["action"], {"observation": np.concatenate(stacked, axis=1)})[0]
        return found
