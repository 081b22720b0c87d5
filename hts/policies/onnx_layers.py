"""Plain networks in ONNX files that others exported: linear layers with ELU between them, read as our layers.

The graph is followed from its input to its output; what it does to the observation on the way must be a normaliser
(minus, times, divided by constants, kept between two limits), linear layers, and one activation between two of them.
Nothing of it is run: constants are folded with numpy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from onnx import numpy_helper

from hts.contracts import RobotSpec
from hts.errors import PolicyError
from hts.policies.card_checks import LARGEST_OBSERVATION, MOST_LAYERS, MOST_UNITS
from hts.policies.export import CARD_KEY
from hts.policies.files import Policy
from hts.policies.onnx_checks import ACTIVATIONS, listed, metadata_in, read_checked
from hts.policies.onnx_metadata import metadata_of
from hts.policies.onnx_ours import from_our_onnx
from hts.policies.source import Source
from hts.policies.translate import Network

FOLDED: dict[str, Callable[..., np.ndarray]] = {
    "Add": np.add,
    "Sub": np.subtract,
    "Mul": np.multiply,
    "Div": np.divide,
    "Sqrt": np.sqrt,
    "Neg": np.negative,
    "Reciprocal": np.reciprocal,
    "Identity": lambda x: x,
    "Exp": np.exp,
}
ELU = "Elu"
PLAIN = "Only plain networks can be read."


def from_onnx(path: Path, robot: RobotSpec, std: float) -> Policy | tuple[Network, Source]:
    """The policy of an exported file of ours, or the actor and what its metadata say. Raises PolicyError."""
    model = read_checked(path)
    properties = metadata_in(model)
    if CARD_KEY in properties:
        return from_our_onnx(path, model, properties[CARD_KEY], robot, std)
    return network_of(path, model), metadata_of(path, properties)


@dataclass
class _Walk:
    """What has been done to the observation so far. scale, shift: elementwise, before the next layer; clip: of the
    normalised observation; layers: those passed; bent: whether an activation follows the last of them."""

    size: int
    scale: np.ndarray = field(init=False)
    shift: np.ndarray = field(init=False)
    clip: float | None = None
    layers: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)
    bent: bool = False

    def __post_init__(self) -> None:
        self.scale, self.shift = np.ones(self.size), np.zeros(self.size)


def network_of(path: Path, model: Any) -> Network:
    """The layers of a graph from one observation to one action. Raises PolicyError for any other graph."""
    with np.errstate(all="ignore"):
        try:
            return _followed(path, model)
        except (ValueError, TypeError, IndexError, KeyError, OverflowError, MemoryError) as error:
            what = f"{type(error).__name__}: {error}".splitlines()[0]
            raise PolicyError(f"{path}: its graph cannot be followed ({what[:120]}). Export it again.") from error


def _followed(path: Path, model: Any) -> Network:
    graph = model.graph
    constants = {tensor.name: _array(numpy_helper, tensor) for tensor in graph.initializer}
    inputs = [value for value in graph.input if value.name not in constants]
    if len(inputs) != 1 or len(graph.output) != 1:
        raise PolicyError(
            f"{path}: its graph reads {listed(v.name for v in inputs)} and gives "
            f"{listed(v.name for v in graph.output)}, expected one observation and one action."
        )
    shape = inputs[0].type.tensor_type.shape.dim
    size = shape[-1].dim_value if shape else 0
    if not 0 < size <= LARGEST_OBSERVATION:
        raise PolicyError(f"{path}: its graph does not say how many numbers it observes. Export it with a fixed width.")
    walk, current, left = _Walk(size), inputs[0].name, list(graph.node)
    while left:
        node = next(
            (one for one in left if one.op_type == "Constant" or all(n in constants for n in one.input if n)), None
        )
        if node is not None and (node.op_type == "Constant" or node.input):
            left.remove(node)
            constants[node.output[0]] = _folded(path, numpy_helper, node, constants)
            continue
        following = [one for one in left if current in one.input]
        if not following:
            break
        if len(following) > 1:
            _refuse_branch(path, following)
        left.remove(following[0])
        current = _step(path, walk, following[0], current, constants)
    if current != graph.output[0].name or left:
        raise PolicyError(
            f"{path}: its graph is not one line from observation to action (left over: "
            f"{listed(node.op_type for node in left)}). {PLAIN}"
        )
    return _network(path, walk)


def _array(numpy_helper: Any, tensor: Any) -> np.ndarray:
    return np.asarray(numpy_helper.to_array(tensor))


def _folded(path: Path, numpy_helper: Any, node: Any, constants: Mapping[str, np.ndarray]) -> np.ndarray:
    given = [constants[name] for name in node.input if name]
    attributes = {one.name: one for one in node.attribute}
    if node.op_type == "Constant":
        if "value" in attributes:
            return _array(numpy_helper, attributes["value"].t)
        if "value_float" in attributes:
            return np.float32(attributes["value_float"].f)  # type: ignore[return-value]
        if "value_floats" in attributes:
            return np.array(attributes["value_floats"].floats, np.float32)
        return np.zeros(0)
    if node.op_type == "Transpose":
        return given[0].transpose(*attributes["perm"].ints) if "perm" in attributes else given[0].T
    if node.op_type in ("Cast", "Reshape", "Unsqueeze", "Squeeze", "Flatten"):
        shape = given[1].astype(int) if node.op_type == "Reshape" else (-1,) if given[0].ndim <= 1 else given[0].shape
        return given[0].reshape(shape)
    if node.op_type not in FOLDED:
        raise PolicyError(f"{path}: its graph makes a constant by {node.op_type}, which is not read.")
    found = np.asarray(FOLDED[node.op_type](*given))
    if found.size > 4 * max(array.size for array in given):  # a small file may not unfold into a large one
        raise PolicyError(f"{path}: its graph unfolds a constant to {found.size:,} numbers.")
    return found


def _step(path: Path, walk: _Walk, node: Any, current: str, constants: Mapping[str, np.ndarray]) -> str:
    """Follow one node; the name of what it gives."""
    kind, first = node.op_type, node.input[0] == current
    other = [constants[name] for name in node.input if name and name != current and name in constants]
    attributes = {one.name: one for one in node.attribute}
    if kind in ("Identity", "Cast", "Flatten", "Reshape", "Squeeze", "Unsqueeze"):
        return str(node.output[0])
    if kind in ("Add", "Sub", "Mul", "Div"):
        if len(other) != 1 or (kind == "Div" and not first):
            raise PolicyError(f"{path}: its {kind} combines two parts of the network. {PLAIN}")
        _elementwise(path, walk, kind, other[0].astype(np.float64), first)
    elif kind == "Clip":
        low, high = (float(one) for one in other) if len(other) == 2 else (attributes["min"].f, attributes["max"].f)
        if walk.layers or low != -high or not high > 0 or walk.clip is not None:
            raise PolicyError(
                f"{path}: its graph keeps numbers between {low:g} and {high:g}; hts does so with normalised "
                "observations only, as far either way. If these are its actions, export it without."
            )
        walk.clip = high
    elif kind in ("Gemm", "MatMul"):
        if not first or len(other) not in (1, 2) or other[0].ndim != 2:
            raise PolicyError(f"{path}: its {kind} is no linear layer. {PLAIN}")
        weight = other[0].astype(np.float64)
        bias = np.zeros(0)
        if kind == "Gemm":
            if "transA" in attributes and attributes["transA"].i:
                raise PolicyError(f"{path}: its Gemm is no linear layer. {PLAIN}")
            weight = weight if "transB" in attributes and attributes["transB"].i else weight.T
            weight = weight * (attributes["alpha"].f if "alpha" in attributes else 1.0)
            if len(other) == 2:
                bias = other[1].astype(np.float64).reshape(-1) * (attributes["beta"].f if "beta" in attributes else 1.0)
        else:
            weight = weight.T
        _layer(path, walk, weight, bias)
    elif kind in ACTIVATIONS:
        _activation(path, walk, kind, attributes)
    elif kind in ("Slice", "Split", "Gather"):
        raise PolicyError(
            f"{path}: its graph takes a part of what its network gives ({kind}), such as the means of brax. Export the "
            "means alone; the lines for brax in the manual do."
        )
    else:
        raise PolicyError(f"{path}: its graph has a {kind} between observation and action. {PLAIN}")
    return str(node.output[0])


def _elementwise(path: Path, walk: _Walk, kind: str, value: np.ndarray, first: bool) -> None:
    width = len(walk.layers[-1][1]) if walk.layers else walk.size
    value = value.reshape(-1)
    if value.size not in (1, width) or walk.bent:
        where = "after an activation" if walk.bent else f"of {value.size} numbers, where {width} are"
        raise PolicyError(f"{path}: its graph has a {kind} {where}. {PLAIN}")
    scale, shift = {
        "Add": (1.0, value),
        "Sub": (1.0, -value) if first else (-1.0, value),
        "Mul": (value, 0.0),
        "Div": (1.0 / value, 0.0),
    }[kind]
    if walk.layers:
        weight, bias = walk.layers[-1]
        scaled = np.broadcast_to(np.asarray(scale), (width,))
        walk.layers[-1] = weight * scaled[:, None], bias * scaled + shift
        return
    if walk.clip is not None:
        raise PolicyError(f"{path}: its graph has a {kind} after it kept the observation within limits.")
    walk.scale, walk.shift = walk.scale * scale, walk.shift * scale + shift


def _layer(path: Path, walk: _Walk, weight: np.ndarray, bias: np.ndarray) -> None:
    bias = bias if bias.size else np.zeros(len(weight))
    width = len(walk.layers[-1][1]) if walk.layers else walk.size
    if weight.shape[1] != width or bias.shape != (len(weight),) or len(weight) > MOST_UNITS or not len(weight):
        raise PolicyError(
            f"{path}: a layer of its graph has the shapes {weight.shape} and {bias.shape} after {width} numbers."
        )
    if walk.layers and not walk.bent:
        raise PolicyError(f"{path}: two layers of its graph have no activation between them. {PLAIN}")
    if len(walk.layers) >= MOST_LAYERS:
        raise PolicyError(f"{path}: its graph has more than {MOST_LAYERS} layers.")
    walk.layers.append((weight, bias))
    walk.bent = False


def _activation(path: Path, walk: _Walk, kind: str, attributes: Mapping[str, Any]) -> None:
    alpha = attributes["alpha"].f if "alpha" in attributes else 1.0
    if kind != ELU or alpha != 1.0 or walk.bent or not walk.layers:
        shown = kind if kind != ELU or alpha == 1.0 else f"ELU with alpha {alpha:g}"
        raise PolicyError(
            f"{path}: its graph has the activation {shown}, hts computes ELU, between layers only. Train it with ELU, "
            "and with actions that are not squashed (the manual says how in its library)."
        )
    walk.bent = True


def _refuse_branch(path: Path, following: list[Any]) -> None:
    kinds = {node.op_type for node in following}
    if kinds == {"Sigmoid", "Mul"}:
        raise PolicyError(
            f"{path}: its graph has the activation Swish (SiLU), hts computes ELU. Train it with ELU, in brax: "
            "activation=flax.linen.elu and distribution_type='normal'."
        )
    raise PolicyError(f"{path}: its graph divides into {listed(sorted(kinds))}. {PLAIN}")


def _network(path: Path, walk: _Walk) -> Network:
    if len(walk.layers) < 2 or walk.bent:
        raise PolicyError(
            f"{path}: its graph is not a plain network with at least one hidden layer and none after its last."
        )
    numbers = [walk.scale, walk.shift, *(one for layer in walk.layers for one in layer)]
    if not all(np.isfinite(one).all() for one in numbers) or bool((walk.scale == 0).any()):
        raise PolicyError(
            f"{path}: its graph holds numbers that are not finite, or divides by 0. Use an earlier checkpoint."
        )
    # z = scale o + shift = (o - mean) / spread, the spread above 0: a sign goes into the first layer
    sign = np.sign(walk.scale)
    layers = [
        (torch.from_numpy(np.ascontiguousarray(w)), torch.from_numpy(np.ascontiguousarray(b))) for w, b in walk.layers
    ]
    layers[0] = layers[0][0] * torch.from_numpy(sign), layers[0][1]
    mean, spread = -walk.shift / walk.scale, 1.0 / np.abs(walk.scale)
    return Network(layers, torch.from_numpy(mean), torch.from_numpy(spread), walk.clip)
