"""What a function does to tensors, as a list of operations in plain JSON: a program that holds no code.

`torch.export` writes the function down, for any number W of worlds, as operations of ATen without side effects. Of
those a reader allows a closed list, `ALLOWED`, and it is the reader's own torch that has them: a file can only name
them. (TorchScript, .pt2 and a pickled module hold code, or paths to it; ONNX holds none, but wants a runtime of its
own, which would take the tensors off the GPU at every control step.)

    {"arguments": ["inputs", "state"], "results": [{"value": 41}, …],
     "operations": [["aten.permute.default", [{"value": 0}, [1, 0]], {}], …]}

{"value": n}: the n-th of the arguments, then of the results of the operations; {"constant": name}: a tensor of the
file; {"dtype": name}; {"number": "inf"}, "-inf", "nan"; lists, numbers, true, false and null are themselves.
"""

from __future__ import annotations

import math
import operator
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor, nn

from hts.errors import ConfigError
from hts.measurement.convolution import decompositions

ALLOWED = frozenset(
    f"aten.{name}"
    for name in (
        "abs.default", "add.Scalar", "add.Tensor", "addcmul.default", "addmm.default", "alias.default", "amax.default",
        "amin.default", "any.dim", "atan2.default", "bitwise_and.Tensor", "bitwise_not.default", "bitwise_or.Tensor",
        "bmm.default", "cat.default", "clamp.Tensor", "clamp.default", "clamp_max.default", "clamp_min.default",
        "clone.default", "constant_pad_nd.default", "cos.default", "cumsum.default", "div.Scalar", "div.Tensor",
        "elu.default", "eq.Scalar", "eq.Tensor", "erf.default", "exp.default", "expand.default", "expm1.default",
        "flip.default", "full.default", "full_like.default", "ge.Scalar", "ge.Tensor", "gelu.default", "gt.Scalar",
        "gt.Tensor", "hardtanh.default", "isinf.default", "isnan.default", "le.Scalar", "le.Tensor",
        "leaky_relu.default", "log.default", "log1p.default", "logical_and.default", "logical_not.default",
        "logical_or.default", "lt.Scalar", "lt.Tensor", "masked_fill.Scalar", "maximum.default", "mean.default",
        "mean.dim", "minimum.default", "mm.default", "mul.Scalar", "mul.Tensor", "ne.Scalar", "ne.Tensor",
        "neg.default", "permute.default", "pow.Tensor_Scalar", "pow.Tensor_Tensor", "reciprocal.default",
        "relu.default", "repeat.default", "rsqrt.default", "rsub.Scalar", "scalar_tensor.default", "select.int",
        "select_scatter.default", "sigmoid.default", "sign.default", "sin.default", "slice.Tensor",
        "slice_scatter.default", "split_with_sizes.default", "sqrt.default", "squeeze.dim", "squeeze.dims",
        "stack.default", "sub.Scalar", "sub.Tensor", "sum.default", "sum.dim_IntList", "sym_size.int", "tan.default",
        "tanh.default", "unbind.int", "unsqueeze.default", "var.correction", "view.default", "where.self",
        "zeros_like.default", "_to_copy.default",
    )
)  # fmt: skip
"""Operations of ATen that a file may name: each makes new tensors of its arguments and does nothing else."""
INTEGERS: Mapping[Any, str] = {
    operator.add: "int.add",
    operator.sub: "int.sub",
    operator.mul: "int.mul",
    operator.floordiv: "int.floordiv",
    operator.getitem: "getitem",
}
"""Arithmetic on sizes, and one of several results."""
CHECKS = ("_assert", "sym_constrain")  # beginnings of operations that only check what is true by then
ELSEWHERE = frozenset({"device", "layout", "memory_format", "pin_memory"})  # arguments that the reader knows better
KINDS = (torch.float16, torch.bfloat16, torch.float32, torch.float64, torch.bool, torch.int32, torch.int64)
DTYPES = {dtype: str(dtype).removeprefix("torch.") for dtype in KINDS}


class Recorded:
    """Programs that share their constants. constants: name -> tensor, each once."""

    def __init__(self) -> None:
        self.constants: dict[str, Tensor] = {}

    def record(
        self, function: Callable[..., tuple[Tensor, ...]], arguments: Mapping[str, Tensor], name: str
    ) -> tuple[dict[str, Any], Callable[..., tuple[Tensor, ...]]]:
        """What function does with arguments, each (W, ...), for any W, and the same as a function to check with.

        name: of the model, for errors. Raises ConfigError for a function that cannot be written down so.
        """
        worlds = torch.export.Dim("worlds", min=2)
        shapes = tuple({0: worlds} for _ in arguments)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of torch's, about itself
                written = torch.export.export(
                    _Module(function), tuple(arguments.values()), dynamic_shapes=(shapes,), strict=False
                ).run_decompositions(decompositions())
        except Exception as error:  # whatever a model may do that cannot be traced; torch names dozens
            reason = " ".join(str(error).split())[:160]
            raise ConfigError(
                f"Measurement model '{name}' cannot be written down as operations ({reason}). Its step has to be free "
                "of branches on values and of numpy, as its contract says; or choose another model, e.g. linear."
            ) from error
        inputs = [spec for spec in written.graph_signature.input_specs]
        known: dict[str, Any] = {}
        position = 0
        nodes = list(written.graph.nodes)
        for node, spec in zip((node for node in nodes if node.op == "placeholder"), inputs, strict=True):
            if spec.target is None:
                known[node.name] = {"value": position}
                position += 1
            else:
                held = {**written.state_dict, **written.constants}[spec.target]
                known[node.name] = {"constant": self._constant(held.detach())}
        operations: list[Any] = []
        results: list[Any] = []
        for node in nodes:
            if node.op == "output":
                results = [self._argument(one, known, name) for one in node.args[0]]
            elif node.op == "call_function":
                called = self._operation(node, name)
                if called is None:
                    continue
                given = [self._argument(one, known, name) for one in node.args]
                named = {k: self._argument(v, known, name) for k, v in node.kwargs.items() if k not in ELSEWHERE}
                known[node.name] = {"value": position + len(operations)}
                operations.append([called, given, named])
        program = {"arguments": list(arguments), "operations": operations, "results": results}
        return program, written.module()

    def _constant(self, tensor: Tensor) -> str:
        """The name of a tensor among the constants."""
        for name, held in self.constants.items():
            if held.dtype == tensor.dtype and held.shape == tensor.shape and torch.equal(held, tensor):
                return name
        name = f"constant.{len(self.constants)}"
        self.constants[name] = tensor.cpu().clone().contiguous()
        return name

    @staticmethod
    def _operation(node: torch.fx.Node, name: str) -> str | None:
        """The name of what a node calls; None for a check."""
        if node.target in INTEGERS:
            return INTEGERS[node.target]
        called = str(node.target)
        if called in ALLOWED:
            return called
        if called.removeprefix("aten.").startswith(CHECKS) and not node.users:
            return None
        raise ConfigError(
            f"Measurement model '{name}' uses {called}, which a file of operations may not name (hts/measurement/"
            "operations.py lists what may). Write its step with other operations, or choose another model, e.g. linear."
        )

    def _argument(self, value: Any, known: Mapping[str, Any], name: str) -> Any:
        """An argument of an operation, in JSON."""
        if isinstance(value, torch.fx.Node):
            return known[value.name]
        if isinstance(value, list | tuple):
            return [self._argument(one, known, name) for one in value]
        if isinstance(value, torch.dtype) and value in DTYPES:
            return {"dtype": DTYPES[value]}
        if isinstance(value, float) and not math.isfinite(value):
            return {"number": str(value)}
        if value is None or isinstance(value, bool | int | float):
            return value
        raise ConfigError(
            f"Measurement model '{name}' cannot be written down as operations: one takes {value!r}, a "
            f"{type(value).__name__}. Choose another model, e.g. linear."
        )


class _Module(nn.Module):
    """A function as torch.export wants it. In a tuple, so that a model that is a module is none of its parts: what it
    holds is a constant, whatever it is called there."""

    def __init__(self, function: Callable[..., tuple[Tensor, ...]]) -> None:
        super().__init__()
        self.function = (function,)

    def forward(self, *arguments: Tensor) -> tuple[Tensor, ...]:
        return self.function[0](*arguments)
