"""Policies made elsewhere, or exported by us, as a `Policy` to start from. Loading never runs code.

    .safetensors + .json   one of our own
    .safetensors alone     plain layers and examples, written at home from another library's actor (`layers`)
    .onnx                  exported by us (`hts export`): its weights are read, its graph is only compared
    .pt                    an rsl_rl checkpoint, through torch.load(weights_only=True)
    TorchScript            refused: it is a program, and loading it runs it

rsl_rl does not clip normalised observations, we do, at 10: beyond ten standard deviations an imported actor may differ.

Layers, ONNX files and rsl_rl checkpoints bring an actor. The critic of this task sees other things than theirs, so it
starts anew; give fine-tuning a few `warmup_batches`, in which only the critic learns.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from hts.contracts import RobotSpec
from hts.errors import PolicyError
from hts.policies.export import CARD_KEY, CLIP, graph_nodes
from hts.policies.files import Policy, check_robot, hash_tensors, load_policy, make_card, parse_card
from hts.policies.layers import from_layers, holds_layers
from hts.policies.layout import Layout, Seen, order, seen_in_velocity_task
from hts.policies.with_critic import NEW_CRITIC, with_new_critic
from hts.rl.population import Sizes

# rsl_rl's EmpiricalNormalization divides by std + 0.01 (rsl_rl/modules/normalization.py).
RSL_RL_EPSILON = 0.01
# Without a normaliser, ours would clip raw observations at 10.
# This factor, exact in binary, moves that to 80 and changes no result.
HEADROOM = 8.0


def import_policy(
    path: Path, robot: RobotSpec, layout: Layout | None = None, std: float = 0.2, seen: Seen | None = None
) -> Policy:
    """The policy in a file, for a robot.

    layout: of a file of layers or an rsl_rl checkpoint; none: our own observation, unscaled. std: sigma of exploration,
    action units, where the file has none. seen: what policies see in the robot's env; none: the velocity task. Raises
    PolicyError for a file of another kind, a damaged one, or one made for another robot.
    """
    path, seen = Path(path), seen or seen_in_velocity_task(robot)
    if path.suffix == ".safetensors" and not path.with_suffix(".json").exists() and holds_layers(path):
        return from_layers(path, robot, layout, seen, std)
    if path.suffix in (".safetensors", ".json"):
        return load_policy(path, robot)
    if path.suffix == ".onnx":
        return _from_onnx(path, robot, std)
    if path.suffix in (".pt", ".pth", ".jit", ".ts", ".torchscript"):
        return _from_rsl_rl(path, robot, layout, seen, std)
    raise PolicyError(
        f"{path}: policies are read from .safetensors (with its .json), .onnx and .pt (rsl_rl), not '{path.suffix}'."
    )


# ------------------------------------------------------------------------------------------------------ ONNX


def _from_onnx(path: Path, robot: RobotSpec, std: float) -> Policy:
    import onnx
    from google.protobuf.message import DecodeError
    from onnx import numpy_helper

    try:
        model = onnx.load(str(path), load_external_data=False)
        outside = [tensor.name for tensor in model.graph.initializer if tensor.data_location == tensor.EXTERNAL]
        if outside:  # reading them would open whatever file they name
            raise PolicyError(
                f"{path}: its constant '{outside[0]}' lies in another file. Export it again with `hts export`."
            )
        arrays = {tensor.name: numpy_helper.to_array(tensor).copy() for tensor in model.graph.initializer}
    except (DecodeError, OSError, ValueError) as error:
        raise PolicyError(f"{path}: not a whole ONNX file ({error}). Copy or export it again.") from error
    properties = {entry.key: entry.value for entry in model.metadata_props}
    if CARD_KEY not in properties:
        raise PolicyError(
            f"{path}: an ONNX file without our card (metadata '{CARD_KEY}'). Only files written by `hts export` can be "
            "read back."
        )
    card = parse_card(properties[CARD_KEY], path)
    check_robot(path, card, robot)
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


# ---------------------------------------------------------------------------------------------------- rsl_rl


def _from_rsl_rl(path: Path, robot: RobotSpec, layout: Layout | None, seen: Seen, std: float) -> Policy:
    layout = layout or Layout(tuple(seen.parts))
    data = _weights(path)
    actor, normaliser, log_std = _rsl_rl_parts(path, data)
    layers = _layers(path, actor)
    theirs = sum(int(part["size"]) for part in layout.observation)
    inputs, outputs = layers[0][0].shape[1], layers[-1][0].shape[0]
    if inputs != theirs or outputs != robot.num_joints:
        raise PolicyError(
            f"{path}: its actor maps {inputs} observations to {outputs} actions, expected {theirs} to "
            f"{robot.num_joints} for robot '{robot.name}'. Say with a Layout what it observes, or use a policy of this "
            "robot."
        )
    columns, scale, joints = order(path, robot, layout, seen.parts)
    if normaliser is None:
        mean, spread, gain = torch.zeros(inputs), torch.full((inputs,), HEADROOM), HEADROOM
    else:
        (mean, spread), gain = normaliser, 1.0
        if mean.shape != (inputs,):
            raise PolicyError(f"{path}: its normaliser has {mean.numel()} entries, its actor {inputs} observations.")
    tensors = {"observation_mean": mean[columns] / scale, "observation_std": spread[columns] / scale}
    for index, (weight, bias) in enumerate(layers):
        if index == 0:
            weight = weight[:, columns] * gain
        if index == len(layers) - 1:
            weight, bias = weight[joints], bias[joints]
        tensors |= {f"actor.{index}.weight": weight.contiguous(), f"actor.{index}.bias": bias.contiguous()}
    if log_std is not None and log_std.shape == (outputs,):
        tensors["log_std"] = log_std[joints]
    hidden = tuple(weight.shape[0] for weight, _ in layers[:-1])
    sizes = Sizes(len(columns), seen.critic, outputs, hidden)
    whole = with_new_critic(path, tensors, sizes, std)
    made = {
        "imported_from": path.name,
        "kind": "rsl_rl",
        "iteration": int(data.get("iter", 0) or 0),
        "critic": NEW_CRITIC,
    }
    return Policy(whole, make_card(robot, whole, [dict(part) for part in seen.parts], sizes, **made))


def _weights(path: Path) -> Mapping[str, Any]:
    """The checkpoint's dictionary, read without running any of it."""
    if not path.is_file():
        raise PolicyError(f"{path}: no such file.")
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            if any(name.endswith("constants.pkl") for name in archive.namelist()):
                raise PolicyError(
                    f"{path}: a TorchScript file. That is a program, and loading it would run it. "
                    "Use the checkpoint it was exported from, or a .safetensors or .onnx of the policy."
                )
    try:
        data = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many classes, one for each way a file can be broken or unsafe
        why = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise PolicyError(
            f"{path}: cannot be read as weights only ({why[:160]}). Save its state_dicts as plain tensors."
        ) from error
    if not isinstance(data, Mapping):
        raise PolicyError(
            f"{path}: holds a {type(data).__name__}, expected an rsl_rl checkpoint with 'model_state_dict'."
        )
    return data


def _rsl_rl_parts(
    path: Path, data: Mapping[str, Any]
) -> tuple[dict[str, torch.Tensor], tuple[torch.Tensor, torch.Tensor] | None, torch.Tensor | None]:
    """Layers by `N.weight`; mean and spread of the normaliser or None; log sigma or None.

    rsl_rl up to 3 keeps one model_state_dict (actor.N.*, std or log_std, actor_obs_normalizer.*; before 3 the
    normaliser lies beside it, obs_norm_state_dict); from 4 on an actor_state_dict (mlp.N.*, distribution.*,
    obs_normalizer.*).
    """
    extra: tuple[str, ...]
    if "actor_state_dict" in data:
        state, prefix, extra = data["actor_state_dict"], "mlp.", ("obs_normalizer.", "distribution.")
    elif "model_state_dict" in data:
        state, prefix, extra = data["model_state_dict"], "actor.", ("actor_obs_normalizer.", "std", "log_std", "critic")
    else:
        raise PolicyError(
            f"{path}: has the parts {sorted(map(str, data))[:8]}, expected 'model_state_dict' or 'actor_state_dict' of "
            "rsl_rl."
        )
    strange = [name for name in state if not name.startswith((prefix, *extra))]
    if strange:
        raise PolicyError(
            f"{path}: its actor is more than layers and a normaliser (it has '{strange[0]}'): only plain rsl_rl actors "
            "can be read."
        )
    layers = {name.removeprefix(prefix): value.float() for name, value in state.items() if name.startswith(prefix)}
    inside = {name.split(".")[-1]: value for name, value in state.items() if name.startswith(extra[0])}
    found = inside or data.get("obs_norm_state_dict") or {}
    normaliser = None
    if found:
        if "_mean" not in found or "_std" not in found:
            raise PolicyError(f"{path}: its normaliser has the parts {sorted(found)}, expected '_mean' and '_std'.")
        normaliser = found["_mean"].float().flatten(), found["_std"].float().flatten() + RSL_RL_EPSILON
    std = state.get("std", state.get("distribution.std_param"))
    log_std = state.get("log_std", state.get("distribution.log_std_param"))
    if log_std is None and std is not None:
        log_std = std.float().clamp(min=1e-3).log()
    return layers, normaliser, None if log_std is None else log_std.float()


def _layers(path: Path, state: Mapping[str, torch.Tensor]) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """(weight, bias) of each linear layer; between two lies an activation, so they are numbered 0, 2, 4, ..."""
    count = len(state) // 2
    expected = {f"{2 * index}.{what}" for index in range(count) for what in ("weight", "bias")}
    if not state or set(state) != expected:
        raise PolicyError(
            f"{path}: its actor has {sorted(state)[:6]}, expected linear layers 0, 2, 4, ... with weight and bias."
        )
    layers = [(state[f"{2 * index}.weight"], state[f"{2 * index}.bias"]) for index in range(count)]
    if any(weight.ndim != 2 for weight, _ in layers) or count < 2:
        raise PolicyError(f"{path}: its actor is not a plain network with at least one hidden layer.")
    return layers
