"""torch.compile where it pays and can work: several small operations on a GPU as one pass over memory."""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import logging
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from types import FunctionType, MethodType
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    import torch

logger = logging.getLogger(__name__)
Function = TypeVar("Function", bound=Callable[..., Any])
_tracing: ContextVar[bool] = ContextVar("tracing", default=False)


def can_compile(device: torch.device) -> bool:
    """Whether torch.compile has what it needs: a GPU, Triton, and a C compiler for its launchers."""
    return device.type == "cuda" and importlib.util.find_spec("triton") is not None and _c_compiler() is not None


@functools.cache
def _c_compiler() -> str | None:
    """The program that Triton would call: what CC names, whatever else there is; without CC one of the usual names."""
    named = os.environ.get("CC")
    if not named:
        return next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    found = shutil.which(named)
    if found is None:
        logger.warning(
            "CC=%s: expected the name of a C compiler, and there is no such program. Training goes on without "
            "torch.compile, slower. Unset CC, or name a program (without options).",
            named,
        )
    return found


def compiled(function: Function, device: torch.device, wanted: bool | None = None, dynamic: bool = False) -> Function:
    """function, compiled; itself where that cannot be. wanted: None decides by `can_compile`; dynamic: once for all
    shapes, otherwise anew for each."""
    if not (can_compile(device) if wanted is None else wanted):
        return function
    import torch

    fast = torch.compile(_copied(function), dynamic=dynamic)

    def either(*args: Any) -> Any:
        return (function if _tracing.get() else fast)(*args)

    return either  # type: ignore[return-value]


def _copied(function: Any) -> Any:
    """function with a code object of its own. torch.compile counts how often it has compiled a code object, for all
    objects and shapes that share it, and after eight times runs it as it is, without a word: a long process would
    become slow."""
    if isinstance(function, MethodType):
        return MethodType(_copied(function.__func__), function.__self__)
    if not isinstance(function, FunctionType):
        return function
    copy = FunctionType(
        function.__code__.replace(),
        function.__globals__,
        function.__name__,
        function.__defaults__,
        function.__closure__,
    )
    copy.__kwdefaults__ = function.__kwdefaults__
    return copy


def any_or_tracing(mask: torch.Tensor) -> bool:
    """Whether anything is to be done where mask: on a GPU always, since asking would wait for it, and so in a program
    that is recorded for one."""
    return _tracing.get() or mask.device.type != "cpu" or bool(mask.any())


@contextlib.contextmanager
def _traced() -> Iterator[None]:
    token = _tracing.set(True)
    try:
        yield
    finally:
        _tracing.reset(token)


class TracedGraph:
    """What a function does to tensors, written down operation by operation, and then compiled as a whole.

    torch.compile alone cannot read a control step, whose state lies in the attributes of many objects. So the step runs
    once while its operations are recorded, as a CUDA graph would record its kernels, and what was recorded is compiled.

    function: of tensors, returns tensors. It may look at attributes and replace them, and change tensors in place; the
    program does the same to the same memory. A tensor it replaces must be copied back to where it was found.
    inputs: what it is called with here, left as they were; later calls take others of the same shapes. Whatever it
    changes in place is to be among them. compiled: False only records.
    """

    def __init__(self, function: Callable[..., Any], inputs: Sequence[torch.Tensor], compiled: bool = True) -> None:
        import torch
        from torch.fx.experimental.proxy_tensor import make_fx

        with _traced(), torch.no_grad():
            before = [tensor.clone() for tensor in inputs]
            graph = make_fx(lambda *tensors: function(*tensors))(*inputs)  # it counts the arguments of a method wrongly
            for tensor, value in zip(inputs, before, strict=True):
                tensor.copy_(value)
        _move_numbers(graph, inputs[0].device)
        self._run = torch.compile(graph, dynamic=False) if compiled else graph

    def __call__(self, *inputs: torch.Tensor) -> Any:
        return self._run(*inputs)


def _move_numbers(graph: torch.fx.GraphModule, device: torch.device) -> None:
    """Put numbers that became tensors, as in `torch.where(mask, 0.0, x)`, on the device: they are made on the CPU, and
    a CUDA graph cannot fetch them there."""
    import torch

    for node in graph.graph.nodes:
        if node.target == torch.ops.aten.scalar_tensor.default:
            node.kwargs = {**node.kwargs, "device": device}
        elif node.op == "get_attr" and (value := getattr(graph, node.target)).ndim == 0:
            setattr(graph, node.target, value.to(device))
    graph.recompile()
