"""CUDA graphs: work that is launched again and again as one, without the host putting it together each time."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Generic, TypeVar

import torch

from hts.errors import HtsError, SimulationError

WARM_UP = 2  # calls before capture, so that libraries have their workspaces
Result = TypeVar("Result")


def warm_up(function: Callable[[], Any], device: torch.device, times: int = WARM_UP) -> None:
    """Call function on a stream of its own, as a capture must be prepared."""
    stream = torch.cuda.Stream(device)
    stream.wait_stream(torch.cuda.current_stream(device))
    with torch.cuda.stream(stream):
        for _ in range(times):
            function()
    torch.cuda.current_stream(device).wait_stream(stream)
    torch.cuda.synchronize(device)


@contextlib.contextmanager
def explained() -> Iterator[None]:
    """Around what a capture does for the first time. Raises SimulationError where something in it waits for the device
    or reads a value, which can be neither captured nor written down."""
    try:
        yield
    except HtsError as error:
        if not isinstance(error.__cause__, RuntimeError):
            raise
        where = str(error).split(" failed, ")[0]  # a plugin's: the line says whose
        raise _not_captured(error.__cause__, where) from error
    except RuntimeError as error:
        raise _not_captured(error, "most likely an objective's reward or proxy") from error


def _not_captured(error: RuntimeError, where: str) -> SimulationError:
    reason = str(error).strip().split("\n")[0]
    return SimulationError(
        f"Capturing a step of the GPU failed ({reason}): something in it waits for the device, {where}. Keep its "
        "arithmetic on the tensors it is given, or set ppo.capture=false."
    )


def captured(function: Callable[[], Result], pool: Any = None) -> tuple[torch.cuda.CUDAGraph, Result]:
    """The graph of what function launches, and what it returned: memory that each replay fills anew.

    Raises SimulationError as `explained` says.
    """
    graph = torch.cuda.CUDAGraph()
    with explained(), torch.cuda.graph(graph, pool=pool):
        result = function()
    return graph, result


class Captured(Generic[Result]):
    """A function of nothing, which reads tensors that keep their place and has no side effects: from the second call
    on one launch. It returns the same tensors each time."""

    def __init__(self, function: Callable[[], Result], device: torch.device) -> None:
        self._function, self._device = function, device
        self._made: tuple[torch.cuda.CUDAGraph, Result] | None = None

    @property
    def result(self) -> Result:
        """What it returns, filled by the last call."""
        assert self._made is not None, "call it first"
        return self._made[1]

    def __call__(self) -> Result:
        if self._made is None:
            warm_up(self._function, self._device)
            self._made = captured(self._function)
        self._made[0].replay()
        return self.result


class StaticBuffers:
    """State that a step replaces, held in the same memory from step to step, as a captured graph needs it."""

    def __init__(self, owner: Any, names: Iterable[str]) -> None:
        self.owner = owner
        held = {name: getattr(owner, name) for name in names}
        self.fixed: dict[str, torch.Tensor] = {name: now.clone() for name, now in held.items() if now is not None}
        self.begun = {name: value.clone() for name, value in self.fixed.items()}
        self._attach()

    def _attach(self) -> None:
        for name, value in self.fixed.items():
            setattr(self.owner, name, value)

    def copy_back(self) -> None:
        """At the end of a step: copy what it made into the memory where the next one looks for it."""
        for name, value in self.fixed.items():
            made = getattr(self.owner, name)
            if made is not value:
                value.copy_(made)
        self._attach()

    def restore(self) -> None:
        """Back to what it was when it was first held."""
        for name, value in self.fixed.items():
            value.copy_(self.begun[name])
        self._attach()
