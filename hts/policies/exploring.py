"""Exploration noise inside an exported graph, so that a runner that knows nothing of noise explores all the same.

    action = mean_action + sigma * n,  n ~ N(0, 1) per joint and step      outputs: action, mean_action

The noise is ONNX's RandomNormalLike and no second input: a runner that forgot to feed an input would record the mean
action under the label of an exploring recording, and nothing in its log would show it. The seed is in the graph, so one
session of a runtime repeats its noise; two recordings of one policy therefore get two files.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from hts.policies.onnx_checks import metadata_in

NOISE_KEY = "hts_exploration"
"""Metadata of a graph that explores by itself: {"where": "graph", "sigma": [...], "seed": n}."""
MEAN = "mean_action"
LARGEST_SEED = 2**24  # an ONNX seed is a float32: whole numbers up to here are exact


def seed_of(*parts: object) -> int:
    """A seed for one recording, from what names it."""
    digest = hashlib.sha256("\n".join(map(str, parts)).encode()).digest()
    return int.from_bytes(digest[:8], "little") % (LARGEST_SEED - 1) + 1


def with_noise(content: bytes, sigma: Sequence[float], seed: int) -> bytes:
    """The exported policy in `content` (see `export.to_onnx`) with noise of sigma (J,), action units, added inside.

    Its card stays; the key `hts_exploration` says what was added, so that nobody adds it again.
    """
    model = onnx.load_from_string(content)
    graph = model.graph
    (last,) = [node for node in graph.node if "action" in node.output]
    last.output[list(last.output).index("action")] = MEAN
    graph.initializer.append(numpy_helper.from_array(np.asarray(sigma, np.float32), "sigma"))
    graph.node.extend(
        [
            helper.make_node("RandomNormalLike", [MEAN], ["unit_noise"], mean=0.0, scale=1.0, seed=float(seed)),
            helper.make_node("Mul", ["unit_noise", "sigma"], ["drawn"]),
            helper.make_node("Add", [MEAN, "drawn"], ["action"]),
        ]
    )
    graph.output.append(helper.make_tensor_value_info(MEAN, TensorProto.FLOAT, ["batch", len(sigma)]))
    note: dict[str, Any] = {"where": "graph", "sigma": [float(one) for one in sigma], "seed": seed}
    helper.set_model_props(model, {**metadata_in(model), NOISE_KEY: json.dumps(note)})
    onnx.checker.check_model(model)
    return model.SerializeToString()


def mean_of(content: bytes) -> bytes:
    """The exported policy in `content` without any noise: neither in its graph nor asked for by its card."""
    model = onnx.load_from_string(content)
    said = metadata_in(model)
    helper.set_model_props(model, {**said, "hts": json.dumps({**json.loads(said["hts"]), "exploration_std": []})})
    return model.SerializeToString()
