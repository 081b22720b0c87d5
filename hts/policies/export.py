"""Policies for robots: ONNX (any runtime) and TorchScript (LibTorch), both with the normaliser inside and the card
attached."""

from __future__ import annotations

import io
import json
import warnings
from dataclasses import asdict
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper

from hts.atomic import atomic_write
from hts.policies.files import Policy, check_finite
from hts.policies.held_commands import FAR, HeldCommands
from hts.policies.onnx_metadata import metadata_of_policy
from hts.rl.population import CLIP

CARD_KEY = "hts"


def to_onnx(policy: Policy, path: Path | str, held: HeldCommands | None = None) -> Path:
    """`observation` (batch, O) float32, raw -> `action` (batch, J), the mean action. Written in one move.

    held: commands to be sent for wanted speeds, put in front of the policy. Raises PolicyError for numbers that are not
    finite.
    """
    check_finite(path, policy.tensors)
    return atomic_write(Path(path), onnx_bytes(policy, held))


def onnx_bytes(policy: Policy, held: HeldCommands | None = None) -> bytes:
    """What `to_onnx` writes; the same policy gives the same bytes. The graph is built node by node: it is small, exact,
    and needs no tracing."""
    tensors, layers = policy.tensors, len(policy.card.hidden) + 1
    weights = {"mean": tensors["observation_mean"], "std": tensors["observation_std"]}
    weights |= {f"{what}{i}": tensors[f"actor.{i}.{what}"] for i in range(layers) for what in ("weight", "bias")}
    initial = [numpy_helper.from_array(value.numpy().astype(np.float32), name) for name, value in weights.items()]
    initial += [numpy_helper.from_array(np.float32(value), name) for name, value in (("low", -CLIP), ("high", CLIP))]
    card = policy.card if held is None else held.card_of(policy.card)
    said = {**metadata_of_policy(policy), CARD_KEY: json.dumps(asdict(card))}
    nodes = graph_nodes(layers)
    if held is not None:
        constants = {**held.matrices(policy.card), "low": np.float32(-FAR), "high": np.float32(FAR)}
        initial += [numpy_helper.from_array(value, f"held_{name}") for name, value in constants.items()]
        nodes = [*held_nodes(), *graph_nodes(layers, "held")]
        said |= held.as_text()
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", policy.card.observation_size])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["batch", len(policy.card.joint_names)])],
        initial,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, said)
    onnx.checker.check_model(model)
    content: bytes = model.SerializeToString()
    return content


def held_nodes() -> list[onnx.NodeProto]:
    """`HeldCommands.matrices` as a graph, from `observation` to `held`."""
    return [
        helper.make_node("Clip", ["observation", "held_low", "held_high"], ["held_seen"]),
        helper.make_node("Gemm", ["held_seen", "held_columns", "held_starts"], ["held_past"], transB=1),
        helper.make_node("Relu", ["held_past"], ["held_above"]),
        helper.make_node("Min", ["held_above", "held_widths"], ["held_by"]),
        helper.make_node("MatMul", ["held_by", "held_changes"], ["held_shift"]),
        helper.make_node("Add", ["observation", "held_shift"], ["held"]),
    ]


def graph_nodes(layers: int, seen: str = "observation") -> list[onnx.NodeProto]:
    """What an exported policy computes from `seen` to `action`, node by node; constants by name."""
    nodes = [
        helper.make_node("Sub", [seen, "mean"], ["centred"]),
        helper.make_node("Div", ["centred", "std"], ["scaled"]),
        helper.make_node("Clip", ["scaled", "low", "high"], ["h0"]),
    ]
    for index in range(layers):
        last = index == layers - 1
        out = "action" if last else f"z{index}"
        nodes.append(helper.make_node("Gemm", [f"h{index}", f"weight{index}", f"bias{index}"], [out], transB=1))
        if not last:
            nodes.append(helper.make_node("Elu", [f"z{index}"], [f"h{index + 1}"]))
    return nodes


class _Actor(torch.nn.Module):
    """The mean action of one policy, for tracing."""

    def __init__(self, policy: Policy, held: HeldCommands | None = None) -> None:
        super().__init__()
        self.layers, self.held = len(policy.card.hidden) + 1, held is not None
        for name, array in (held.matrices(policy.card) if held is not None else {}).items():
            self.register_buffer(f"held_{name}", torch.from_numpy(array))
        for name, value in policy.tensors.items():
            if name.startswith(("actor.", "observation_")):
                self.register_buffer(name.replace(".", "_"), value)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        if self.held:
            seen = observation.clamp(-FAR, FAR)
            past = torch.nn.functional.linear(seen, self.held_columns, self.held_starts)
            observation = observation + torch.minimum(past.relu(), self.held_widths) @ self.held_changes
        x = ((observation - self.observation_mean) / self.observation_std).clamp(-CLIP, CLIP)
        for index in range(self.layers):
            weight, bias = (self.get_buffer(f"actor_{index}_{what}") for what in ("weight", "bias"))
            x = torch.nn.functional.linear(x, weight, bias)
            if index < self.layers - 1:
                x = torch.nn.functional.elu(x)
        return x


def to_torchscript(policy: Policy, path: Path | str, held: HeldCommands | None = None) -> Path:
    """The same function as a TorchScript file with the card as extra file `hts.json` (and `held_speeds`,
    `held_commands` as in ONNX metadata), while torch still offers it. Raises PolicyError for numbers that are not
    finite."""
    check_finite(path, policy.tensors)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*torch.jit.*", category=DeprecationWarning)
        warnings.filterwarnings("ignore", message=".*torch.jit.*", category=FutureWarning)
        traced = torch.jit.trace(_Actor(policy, held), torch.zeros(1, policy.card.observation_size))
        written = io.BytesIO()
        card = policy.card if held is None else held.card_of(policy.card)
        extra = {f"{CARD_KEY}.json": json.dumps(asdict(card)), **(held.as_text() if held else {})}
        torch.jit.save(traced, written, _extra_files=extra)
    return atomic_write(Path(path), written.getvalue())
