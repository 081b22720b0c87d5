"""A function as a list of named operations on tensors, run one after the other.

A program comes from a file that a stranger may have written. It can only name operations of the closed list below, each
of which makes new tensors of its arguments and does nothing else; they are looked up in torch by their names in that
list, never imported or evaluated. Before it runs, it is walked through with tensors without memory (torch's device
"meta"), so one that would ask for too much is refused and allocates nothing.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from hts_rsl_rl.errors import ModelFileError

NAMES = (
    "_to_copy.default abs.default add.Scalar add.Tensor addcmul.default addmm.default alias.default amax.default "
    "amin.default any.dim atan2.default bitwise_and.Tensor bitwise_not.default bitwise_or.Tensor bmm.default "
    "cat.default clamp.Tensor clamp.default clamp_max.default clamp_min.default clone.default constant_pad_nd.default "
    "cos.default cumsum.default div.Scalar div.Tensor elu.default eq.Scalar eq.Tensor erf.default exp.default "
    "expand.default expm1.default flip.default full.default full_like.default ge.Scalar ge.Tensor gelu.default "
    "gt.Scalar gt.Tensor hardtanh.default isinf.default isnan.default le.Scalar le.Tensor leaky_relu.default "
    "log.default log1p.default logical_and.default logical_not.default logical_or.default lt.Scalar lt.Tensor "
    "masked_fill.Scalar maximum.default mean.default mean.dim minimum.default mm.default mul.Scalar mul.Tensor "
    "ne.Scalar ne.Tensor neg.default permute.default pow.Tensor_Scalar pow.Tensor_Tensor reciprocal.default "
    "relu.default repeat.default rsqrt.default rsub.Scalar scalar_tensor.default select.int select_scatter.default "
    "sigmoid.default sign.default sin.default slice.Tensor slice_scatter.default split_with_sizes.default sqrt.default "
    "squeeze.dim squeeze.dims stack.default sub.Scalar sub.Tensor sum.default sum.dim_IntList sym_size.int tan.default "
    "tanh.default unbind.int unsqueeze.default var.correction view.default where.self zeros_like.default"
)


def _of_sizes(operation: Callable[[int, int], int]) -> Callable[[int, int], int]:
    """Arithmetic on sizes: of whole numbers alone (a list times a million is a list), which stay in 64 bits."""

    def checked(one: int, other: int) -> int:
        if type(one) is not int or type(other) is not int:
            raise TypeError(f"sizes are whole numbers, not {type(one).__name__} and {type(other).__name__}")
        found = operation(one, other)
        if abs(found) >= 2**63:
            raise ValueError("a size of more than 64 bits")
        return found

    return checked


def _one_of(several: Sequence[Tensor], index: int) -> Tensor:
    """One of an operation's results."""
    if not isinstance(several, list | tuple) or type(index) is not int:
        raise TypeError("getitem takes one of several results")
    return several[index]


OPERATIONS: dict[str, Any] = {
    "int.add": _of_sizes(operator.add),
    "int.sub": _of_sizes(operator.sub),
    "int.mul": _of_sizes(operator.mul),
    "int.floordiv": _of_sizes(operator.floordiv),
    "getitem": _one_of,
}
for _one in NAMES.split():
    _packet, _overload = _one.split(".")
    OPERATIONS[f"aten.{_one}"] = getattr(getattr(torch.ops.aten, _packet), _overload)
# A view asks for a memory layout that it had where it was written down; what it means is the shape.
OPERATIONS["aten.view.default"] = torch.ops.aten.reshape.default
CREATING = frozenset({"aten.full.default", "aten.scalar_tensor.default"})  # on no other tensor's device
DTYPES = {str(one).removeprefix("torch."): one for one in (
    torch.float16, torch.bfloat16, torch.float32, torch.float64, torch.bool, torch.int32, torch.int64,
)}  # fmt: skip
NUMBERS = {"inf": float("inf"), "-inf": float("-inf"), "nan": float("nan")}
MOST_OPERATIONS = 20_000
MOST_NUMBERS = 20_000_000  # of one tensor, for the two worlds of the walk


class Program:
    """arguments: names, in order; results: how many. Called with tensors of W worlds each."""

    def __init__(self, written: Mapping[str, Any], constants: Mapping[str, Tensor], where: str) -> None:
        """where: file and program, for errors. Raises ModelFileError."""
        self._where, self._constants = where, dict(constants)
        try:
            self.arguments: list[str] = [str(name) for name in written["arguments"]]
            steps = written["operations"]
            if not isinstance(steps, list) or len(steps) > MOST_OPERATIONS:
                raise ModelFileError(f"{where}: expected a list of at most {MOST_OPERATIONS} operations.")
            self._steps: list[tuple[str, list[Any], dict[str, Any]]] = []
            count = len(self.arguments)
            for name, given, named in steps:
                if name not in OPERATIONS:
                    raise ModelFileError(
                        f"{where}: names the operation {str(name)[:60]!r}, not among the {len(OPERATIONS)} that it may "
                        "name. It is damaged, or of a newer hts: update hard-to-sim-rsl-rl, or export the model again."
                    )
                self._steps.append((name, self._checked(list(given), count), self._by_name(named, count)))
                count += 1
            self._results = self._checked(written["results"], count)
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            raise ModelFileError(
                f"{where}: not a program ({type(error).__name__}: {error}). Export the model again."
            ) from error
        self.results = len(self._results)

    def _checked(self, given: Any, count: int) -> Any:
        """What a file gives as arguments, all of it data, referring to nothing that is not there yet."""
        if isinstance(given, list):
            return [self._checked(one, count) for one in given]
        if isinstance(given, dict):
            if set(given) == {"value"} and type(given["value"]) is int and 0 <= given["value"] < count:
                return _Value(given["value"])
            if set(given) == {"constant"} and str(given["constant"]) in self._constants:
                return _Constant(given["constant"])
            if set(given) == {"dtype"} and str(given["dtype"]) in DTYPES:
                return DTYPES[given["dtype"]]
            if set(given) == {"number"} and str(given["number"]) in NUMBERS:
                return NUMBERS[given["number"]]
            raise ModelFileError(
                f"{self._where}: refers to {str(given)[:60]}, which there is not. Export the model again."
            )
        if given is None or isinstance(given, bool | int | float):
            return given
        raise ModelFileError(f"{self._where}: has {str(given)[:60]!r} as an argument. Export the model again.")

    def _by_name(self, given: Any, count: int) -> dict[str, Any]:
        """Arguments by name."""
        return {str(name): self._checked(one, count) for name, one in dict(given).items()}

    def walk(self, arguments: Sequence[Tensor]) -> list[Tensor]:
        """What comes out of arguments, without memory or numbers: shapes. Raises ModelFileError for a program that does
        not fit together or that asks for too much."""
        bare = {name: value.to("meta") for name, value in self._constants.items()}
        try:
            return self._run([value.to("meta") for value in arguments], bare, torch.device("meta"), MOST_NUMBERS)
        except (RuntimeError, TypeError, IndexError, ValueError, ArithmeticError, AttributeError) as error:
            line = " ".join(str(error).split())[:160]
            raise ModelFileError(f"{self._where}: does not fit together ({line}). Export the model again.") from error

    @torch.no_grad()
    def __call__(self, *arguments: Tensor) -> list[Tensor]:
        return self._run(list(arguments), self._constants, arguments[0].device, None)

    def _run(
        self, values: list[Any], constants: Mapping[str, Tensor], device: torch.device, most: int | None
    ) -> list[Tensor]:
        for name, given, named in self._steps:
            found = _given(named, values, constants)
            if name in CREATING:
                found["device"] = device
            value = OPERATIONS[name](*_given(given, values, constants), **found)
            if most is not None and isinstance(value, Tensor) and value.numel() > most:
                raise ModelFileError(
                    f"{self._where}: {name} would make {value.numel()} numbers, more than {most}. Export it again."
                )
            values.append(value)
        return _given(self._results, values, constants)

    def to(self, device: torch.device | str) -> None:
        """Move its constants."""
        self._constants = {name: value.to(device) for name, value in self._constants.items()}


class _Value(int):
    """The n-th value so far."""

    __slots__ = ()


class _Constant(str):
    """A tensor of the file."""

    __slots__ = ()


def _given(given: Any, values: Sequence[Any], constants: Mapping[str, Tensor]) -> Any:
    """Arguments with the values that they refer to."""
    if isinstance(given, _Value):
        return values[given]
    if isinstance(given, _Constant):
        return constants[given]
    if isinstance(given, list):
        return [_given(one, values, constants) for one in given]
    if isinstance(given, dict):
        return {name: _given(one, values, constants) for name, one in given.items()}
    return given
