"""ONNX files of `hts export`, read back: their weights are taken or compared, their graph is only compared."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from onnx import numpy_helper

from hts.contracts import RobotSpec
from hts.errors import PolicyError
from hts.policies.export import CARD_KEY, CLIP, graph_nodes, onnx_bytes
from hts.policies.files import Policy, check_robot, hash_tensors, parse_card
from hts.policies.onnx_checks import metadata_in, read_checked
from hts.policies.with_critic import NEW_CRITIC, with_new_critic

ROUNDED = "action_sigma"
"""Of the metadata, what is computed while exporting: another machine may round it otherwise."""


def from_our_onnx(path: Path, model: Any, text: str, robot: RobotSpec, std: float) -> Policy:
    """The policy in an exported file. model: its ModelProto, checked; text: its card. Raises PolicyError."""
    arrays = _constants(path, model)
    card = parse_card(text, path)
    check_robot(path, card, robot)
    if "held_starts" in arrays:
        raise PolicyError(
            f"{path}: was exported with --held-speed, so it sees other commands than it is given. Import the run's own "
            ".safetensors, or a file exported without."
        )
    layers = len(card.hidden) + 1
    _compare_graph(path, model, layers)
    try:
        limits = float(arrays["low"]), float(arrays["high"])
        tensors = {"observation_mean": arrays["mean"], "observation_std": arrays["std"]}
        for index in range(layers):
            for what in ("weight", "bias"):
                tensors[f"actor.{index}.{what}"] = arrays[f"{what}{index}"]
    except (KeyError, TypeError) as error:
        raise PolicyError(f"{path}: its graph lacks the constant {error}. Export it again.") from error
    if limits != (-CLIP, CLIP):
        raise PolicyError(
            f"{path}: it clips observations to {limits}, this version to {(-CLIP, CLIP)}. Export the policy again."
        )
    actor = {name: torch.from_numpy(value).float() for name, value in tensors.items()}
    whole = with_new_critic(path, actor, card.sizes(), std)
    made = {**card.made, "imported_from": path.name, "imported_hash": card.policy_hash, "critic": NEW_CRITIC}
    return Policy(whole, replace(card, policy_hash=hash_tensors(whole), made=made))


def what_differs(path: Path, policy: Policy) -> str | None:
    """What makes an exported file another one than that of the policy; None: it is that policy's, bit by bit, or as an
    earlier version wrote it, with fewer metadata. Raises OSError where it cannot be read."""
    content, own = path.read_bytes(), onnx_bytes(policy)
    if content == own:
        return None
    try:
        found, expected = read_checked(path, content), read_checked(path, own)
        said, wanted = metadata_in(found), metadata_in(expected)
        card = parse_card(said.get(CARD_KEY, "null"), path)
        if card.policy_hash != policy.card.policy_hash:
            return f"it holds policy {card.policy_hash[:12]}"
        _compare_graph(path, found, len(card.hidden) + 1)
        numbers, others = _constants(path, found), _constants(path, expected)
    except PolicyError as error:
        return str(error).removeprefix(f"{path}: ").split(". ")[0].rstrip(".")
    for name in sorted({*numbers, *others}):
        if name not in numbers or name not in others or numbers[name].tobytes() != others[name].tobytes():
            return f"its constant '{name}' is another one"
    if json.dumps(asdict(card)) != json.dumps(asdict(policy.card)):  # as text: NaN equals itself
        return "its card is another one"
    both = said.keys() & wanted.keys() - {CARD_KEY, ROUNDED}
    return next((f"its metadata say another {key}" for key in sorted(both) if said[key] != wanted[key]), None)


def _constants(path: Path, model: Any) -> Mapping[str, np.ndarray]:
    try:
        return {tensor.name: numpy_helper.to_array(tensor).copy() for tensor in model.graph.initializer}
    except ValueError as error:
        raise PolicyError(f"{path}: not a whole ONNX file ({str(error)[:120]}). Copy or export it again.") from error


def _compare_graph(path: Path, model: Any, layers: int) -> None:
    """Raises PolicyError unless the file computes exactly what `to_onnx` writes for so many layers."""
    expected = graph_nodes(layers)
    found, ours = ([node.op_type for node in nodes] for nodes in (model.graph.node, expected))
    if found != ours or len(model.functions):
        shown = "-".join(found[:12]) + ("-…" if len(found) > 12 else "")
        raise PolicyError(f"{path}: its graph is {shown}, its card describes {'-'.join(ours)}. Export it again.")
    ends = [value.name for value in model.graph.input], [value.name for value in model.graph.output]
    if ends != (["observation"], ["action"]):
        raise PolicyError(
            f"{path}: it reads {ends[0]} and gives {ends[1]}, expected 'observation' and 'action'. Export it again."
        )
    for node, own in zip(model.graph.node, expected, strict=True):
        if (node.domain, list(node.input), list(node.output), _attributes(node)) != (
            "",
            list(own.input),
            list(own.output),
            _attributes(own),
        ):
            raise PolicyError(
                f"{path}: its {node.op_type} of {', '.join(node.input)} is not that of an exported policy. Export it "
                "again."
            )


def _attributes(node: Any) -> dict[str, bytes]:
    return {attribute.name: attribute.SerializeToString(deterministic=True) for attribute in node.attribute}
