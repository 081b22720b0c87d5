"""Whether an ONNX file may meet a runtime: known operators only, nothing outside the file, bounded sizes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from hts.errors import PolicyError

LARGEST_FILE = 256 * 2**20  # bytes
MOST_NODES = 500
MOST_CONSTANTS = 1000

ARITHMETIC = frozenset({"Add", "Sub", "Mul", "Div", "Clip", "Gemm", "MatMul"})
ACTIVATIONS = frozenset(
    "Elu Relu Tanh Sigmoid LeakyRelu Selu Softplus Gelu Swish HardSwish Erf".split()  # noqa: SIM905 - shorter
)
SHAPES = frozenset(
    "Identity Cast Constant Reshape Flatten Transpose Unsqueeze Squeeze Slice Split Gather Concat Shape".split()  # noqa: SIM905
)
NOISE = frozenset({"RandomNormal", "RandomNormalLike"})
SMALL = frozenset({"Sqrt", "Neg", "Reciprocal", "Max", "Min", "Pow", "Exp", "Log", "Where", "ReduceMean"})
ALLOWED = ARITHMETIC | ACTIVATIONS | SHAPES | NOISE | SMALL
"""Operators of a policy: none opens a file, holds a graph of its own, loops, or makes large things of small ones."""


def read_checked(path: Path, content: bytes | None = None, what: str = "a whole ONNX file") -> Any:
    """The ModelProto of a file, checked. content: its bytes, if read already; what: it should be.

    Raises PolicyError, one line, for a file that is none, too large, with constants in other files, functions or
    graphs inside nodes, other domains, or operators that no policy has.
    """
    import onnx
    from google.protobuf.message import DecodeError

    try:
        if content is None:
            if path.stat().st_size > LARGEST_FILE:
                raise PolicyError(f"{path}: has more than {LARGEST_FILE >> 20} MB; no such policy has.")
            content = path.read_bytes()
        model = onnx.load_model_from_string(content)
        _check(path, model, what)
    except FileNotFoundError as error:
        raise PolicyError(f"{path}: no such file. Correct the path.") from error
    except (DecodeError, OSError, ValueError, RecursionError) as error:
        why = (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__
        raise PolicyError(f"{path}: not {what} ({' '.join(why.split())[:120]}). Copy or export it again.") from error
    return model


def _check(path: Path, model: Any, what: str) -> None:
    from onnx import TensorProto

    graph = model.graph
    if not graph.node or not graph.output:
        raise PolicyError(f"{path}: not {what} (it computes nothing). Copy or export it again.")
    if len(model.functions) or len(graph.node) > MOST_NODES or len(graph.initializer) > MOST_CONSTANTS:
        raise PolicyError(
            f"{path}: its graph has {len(graph.node)} nodes, {len(graph.initializer)} constants and "
            f"{len(model.functions)} functions of its own; a policy has at most {MOST_NODES}, "
            f"{MOST_CONSTANTS} and none."
        )
    if len(graph.sparse_initializer) or len(model.training_info):
        raise PolicyError(f"{path}: it has sparse constants or training information, which no policy needs.")
    for node in graph.node:
        if node.domain not in ("", "ai.onnx") or node.op_type not in ALLOWED:
            name = _shown(f"{node.domain}.{node.op_type}" if node.domain else node.op_type)
            raise PolicyError(f"{path}: its graph has the operator '{name}', which no policy needs. It is not run.")
        for attribute in node.attribute:
            if attribute.HasField("g") or len(attribute.graphs) or attribute.HasField("sparse_tensor"):
                raise PolicyError(f"{path}: its {_shown(node.op_type)} holds a graph of its own. It is not run.")
    for tensor in tensors_of(graph):
        if tensor.data_location == TensorProto.EXTERNAL or len(tensor.external_data):
            # reading it would open whatever file it names
            raise PolicyError(
                f"{path}: its constant '{_shown(tensor.name)}' lies in another file. Export it again with all "
                "inside (torch.onnx.export(…, external_data=False)), or bring both files into one at home: "
                "onnx.save(onnx.load(FILE), 'one.onnx')."
            )
        count = 1
        for size in tensor.dims:
            count *= size
            if size < 0 or count > LARGEST_FILE:
                raise PolicyError(
                    f"{path}: its constant '{_shown(tensor.name)}' has the shape {list(tensor.dims)[:6]}."
                )


def metadata_in(model: Any) -> dict[str, str]:
    """What a ModelProto says of itself, text by key."""
    return {entry.key: entry.value for entry in model.metadata_props}


def tensors_of(graph: Any) -> Iterator[Any]:
    """Every constant of a graph, those in the attributes of nodes among them."""
    yield from graph.initializer
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.HasField("t"):
                yield attribute.t
            yield from attribute.tensors


def _shown(text: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in text[:60])


def listed(names: Iterable[str]) -> str:
    """Names of a file, short and printable, for a message."""
    return ", ".join(_shown(name) for name in list(names)[:6]) or "nothing"
