"""A selector as a run asks it: what a plugin's code gives is looked at before anything is built on it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from hts.config import Named
from hts.contracts import RacedCandidate, Rounds, Selector, SimulatedCandidate, TestedCandidate
from hts.errors import PluginError
from hts.guarded import guarded
from hts.plugins import Registry

SHORTEST = 1.0  # s: in a shorter block there is no second to compare


class CheckedSelector(Selector):
    """Passes every question on to `inner`. Raises PluginError, one line that begins with `what`, for code that fails
    and for answers that are none: before a robot walks for them, or what it walked is lost."""

    def __init__(self, inner: Selector, what: str, capped: bool = False) -> None:
        """capped: what the robot walks is capped, and was counted for no more elites than are asked for."""
        self._inner, self._what, self._capped = inner, what, capped

    def check(self, objectives: Sequence[str]) -> None:
        """As the selector's own."""
        self._asked("check", lambda: self._inner.check(objectives))

    def elites(self, candidates: Sequence[SimulatedCandidate], count: int) -> list[str]:
        """Ids of the candidates, each once; where `capped`, at most `count`."""
        found = self._ids(
            "elites", self._asked("elites", lambda: self._inner.elites(list(candidates), count)), candidates
        )
        if self._capped and len(found) > count:
            raise PluginError(
                f"{self._what}: elites() gives {len(found)} candidates, but max_real_samples is enough for {count}."
            )
        return found

    def best(self, tested: Sequence[TestedCandidate]) -> str | None:
        """The id of one of them, or None."""
        found = self._asked("best", lambda: self._inner.best(list(tested)))
        known = [one.id for one in tested]
        if found is not None and (not isinstance(found, str) or found not in known):
            raise PluginError(f"{self._what}: best() gives {_shown(found)}, expected None or one of {known}.")
        return found

    def rounds(self) -> Rounds | None:
        """As the selector's own."""
        found = self._asked("rounds", self._inner.rounds)
        if found is not None and not isinstance(found, Rounds):
            raise PluginError(f"{self._what}: rounds() gives {_shown(found)}, expected None or Rounds.")
        if found is not None and not (_number(found.block_seconds) and found.block_seconds >= SHORTEST):
            raise PluginError(
                f"{self._what}: rounds() gives block_seconds={found.block_seconds!r}, expected {SHORTEST:g} s at "
                "least: whole seconds are compared, and the first ones of a block are left out."
            )
        if found is not None and not (type(found.most) is int and found.most >= 1):
            raise PluginError(
                f"{self._what}: rounds() gives most={found.most!r}, expected a whole number of at least 1."
            )
        return found

    def keep(self, raced: Sequence[RacedCandidate]) -> list[str]:
        """Ids of them, each once."""
        return self._ids("keep", self._asked("keep", lambda: self._inner.keep(raced)), raced)

    def _asked(self, method: str, work: Callable[[], Any]) -> Any:
        return guarded(f"{self._what}: {method}()", work)

    def _ids(self, method: str, found: Any, candidates: Sequence[SimulatedCandidate | RacedCandidate]) -> list[str]:
        known = [one.id for one in candidates]
        if isinstance(found, str) or not isinstance(found, Sequence):
            raise PluginError(f"{self._what}: {method}() gives {_shown(found)}, expected a list of ids.")
        for name in found:
            if name not in known:
                raise PluginError(f"{self._what}: {method}() gives {_shown(name)}, which is none of {known}.")
        if len(set(found)) < len(found):
            raise PluginError(f"{self._what}: {method}() gives a candidate twice: {list(found)}.")
        return list(found)


def checked_selector(registry: Registry, named: Named, capped: bool = False) -> Selector:
    """The selector that a configuration names; capped: as of `CheckedSelector`. Raises ConfigError, PluginError."""
    inner = registry.make_selector(named.name, named.settings)
    what = f"Selector '{named.name}' (from {registry.entry('selectors', named.name).package})"
    if not isinstance(inner, Selector):
        raise PluginError(f"{what} is a {type(inner).__name__}, expected a hts.contracts.Selector.")
    return CheckedSelector(inner, what, capped)


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _shown(value: Any) -> str:
    """A value as an error shows it."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"a {type(value).__name__}"
