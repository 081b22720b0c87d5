"""Whether an exported file does what the policy does: on random observations, and on those that were recorded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from hts.errors import PolicyError
from hts.policies.files import Policy
from hts.policies.held_commands import HeldCommands, columns
from hts.policies.layers import difference
from hts.rl.population import Population

TOLERANCE = 1e-5
"""Largest difference of an action, action units, relative where actions are larger than 1."""
ROUNDINGS = 10.0  # two ways to round differ by no more than so often what one of them is off
RANDOM = 512  # observations
RECORDED = 5000  # rows at most


def random_observations(policy: Policy, seed: int = 0) -> np.ndarray:
    """(n, O): three spreads around the mean of what the policy was normalised by, some far beyond where it clips."""
    rng = np.random.default_rng(seed)
    mean, std = (policy.tensors[f"observation_{what}"].numpy() for what in ("mean", "std"))
    given = mean + 3.0 * std * rng.standard_normal((RANDOM, len(mean)))
    given[: RANDOM // 8] = mean + 30.0 * std * rng.standard_normal((RANDOM // 8, len(mean)))
    return given.astype(np.float32)


def recorded_observations(policy: Policy, store: Path) -> np.ndarray:
    """(n, O) made from the recordings of a store, as the velocity task observes them; (0, O) if they lack a part."""
    from hts.recordings.store import RecordingStore

    card = policy.card
    opened, rows = RecordingStore(store), []
    for recording_id in opened.ids():
        recording = opened.read(recording_id)
        held = {name: series.values.astype(np.float64) for name, series in recording.channels.items()}
        if tuple(recording.joint_names) != tuple(card.joint_names):
            continue
        if "joint_position" in held:
            held["joint_position_offset"] = held["joint_position"] - np.array(card.default_pose)
        if "joint_target" in held:
            action = (held["joint_target"] - np.array(card.default_pose)) / np.array(card.action_scale)
            held["last_action"] = np.vstack([np.zeros_like(action[:1]), action[:-1]])
        parts = [held.get(str(part["name"])) for part in card.observation]
        widths = [int(part["size"]) for part in card.observation]
        if card.history > 1 or any(p is None or p.shape[1:] != (w,) for p, w in zip(parts, widths, strict=True)):
            continue
        rows.append(np.concatenate([part for part in parts if part is not None], axis=1))
        if sum(map(len, rows)) >= RECORDED:
            break
    whole = np.concatenate(rows) if rows else np.zeros((0, card.observation_size))
    return whole[:RECORDED].astype(np.float32)


def check_export(
    policy: Policy, path: Path, format: str, observations: Sequence[np.ndarray], held: HeldCommands | None = None
) -> float:
    """The largest difference between the actions of the file and of the policy, which sees the `held` commands in the
    place of the wanted speeds. Raises PolicyError above 1e-5, which says whether 32 bits are too few for the policy."""
    given = np.concatenate([one for one in observations if len(one)])
    seen = given.copy()
    if held is not None:
        for column in columns(policy.card):
            seen[:, column] = held.of(given[:, column].astype(np.float64))
    with torch.no_grad():
        population = Population.from_candidates(policy.card.sizes(), [policy.tensors])
        wanted = population.mean(torch.from_numpy(seen)[None])[0]
    off = difference(torch.from_numpy(_actions(path, format, given)), wanted)
    if not off <= TOLERANCE:
        with torch.no_grad():
            exact = population.double().mean(torch.from_numpy(seen.astype(np.float64))[None])[0]
        begun = f"{path}: the exported policy's actions are off by up to {off:.2g} on {len(given)} observations"
        rounding = difference(wanted, exact)
        if off <= ROUNDINGS * rounding:
            last = max(key for key in policy.tensors if key.startswith("actor.") and key.endswith(".weight"))
            raise PolicyError(
                f"{begun}, the policy's own by {rounding:.2g} for 32 bits alone: weights of up to "
                f"{float(policy.tensors[last].abs().max()):.2g} in '{last}' cancel each other. Expected {TOLERANCE:g} "
                "at most; nothing was written. Make a policy with smaller weights, such as one trained by `hts "
                "pretrain`."
            )
        raise PolicyError(f"{begun}. This is a fault of hts or of its runtime; nothing was written.")
    return off


def _actions(path: Path, format: str, observations: np.ndarray) -> np.ndarray:
    if format == "onnx":
        import onnxruntime

        session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
        return np.asarray(session.run(["action"], {"observation": observations})[0])
    with torch.no_grad():
        return np.asarray(torch.jit.load(str(path))(torch.from_numpy(observations)).numpy())
