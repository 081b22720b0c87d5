"""Which of the known names somebody meant who wrote another one, if any is near: the one rule of all messages.

A suggestion that is not what was meant is worse than none, since whoever follows it is led away.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from itertools import takewhile

ALIKE = 0.7  # share of letters in common, in their order, from which two names are near whatever they are
SOMEWHAT = 0.6  # from which they are where a single letter was changed, left out or added: `hop` for `hip`
WITHIN = 0.5  # from which they are where one begins or ends with the other: `torque` for `joint_torque`


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The nearest of the known names, upper and lower case taken as one; None if none is near."""
    wanted = name.casefold()
    found = [(_alike(wanted, one.casefold()), one) for one in known]
    near = [(share, one) for share, one in found if _is_near(wanted, one.casefold(), share)]
    return max(near)[1] if near else None


def _alike(wanted: str, name: str) -> float:
    """Twice the letters in common over the letters of both, 0 to 1. difflib's own way round: it is not symmetric."""
    return difflib.SequenceMatcher(None, name, wanted).ratio()


def _is_near(wanted: str, name: str, share: float) -> bool:
    short, long = sorted((wanted, name), key=len)
    within = bool(short) and (long.startswith(short) or long.endswith(short))
    return share >= ALIKE or (share >= SOMEWHAT and _one_letter(wanted, name)) or (share >= WITHIN and within)


def _one_letter(one: str, other: str) -> bool:
    """Whether a single letter is changed, left out or added."""
    begin = _in_common(one, other)
    one, other = one[begin:], other[begin:]
    return max(len(one), len(other)) - _in_common(one[::-1], other[::-1]) <= 1


def _in_common(one: str, other: str) -> int:
    """How many letters both begin with."""
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(one, other, strict=False)))
