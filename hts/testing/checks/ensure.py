"""How a check says what it found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import wraps

import numpy as np

from hts.errors import HtsError, PluginError
from hts.plugins import Entry, Registry

Check = Callable[[Entry, Registry], None]


class NotTried(PluginError):
    """A check cannot be made of a thing that an earlier demand is not kept of: it is neither kept nor a fault."""


def ensure(kept: bool, found: str) -> None:
    """Raises PluginError saying what was found."""
    if not kept:
        raise PluginError(found)


@contextmanager
def refused(what: str, taken: str) -> Iterator[None]:
    """Raises PluginError unless what is done inside ends in an error of hts.errors, one line. what: that is wrong;
    taken: what is said where it is taken all the same."""
    try:
        yield
    except HtsError as error:
        ensure("\n" not in str(error), f"says of {what} in several lines: {error}")
    except Exception as error:
        raise PluginError(f"{what} ends in a traceback, {type(error).__name__}: {error}") from error
    else:
        ensure(False, taken)


def same(first: object, second: object, tolerance: float = 0.0) -> bool:
    """Equal arrays, NaN equal to NaN; tolerance: relative and absolute."""
    a, b = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=tolerance, atol=tolerance, equal_nan=True))


def listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(names)) or "nothing"


def after(*first: Check) -> Callable[[Check], Check]:
    """A check that is worth its line only where others are kept, and waits where they are not: a model that cannot be
    made would fail all of them."""

    def gated(check: Check) -> Check:
        @wraps(check)
        def tried(entry: Entry, registry: Registry) -> None:
            try:
                for one in first:
                    one(entry, registry)
            except Exception as error:
                raise NotTried("an earlier demand is not kept") from error  # said already, in the line of that check
            check(entry, registry)

        return tried

    return gated
