"""A visit that ends gently: the robot sits down where a stop would let it fall.

For the end of a track, or of a day. Whatever is unsafe is a stop: Enter, `operator_key`.
"""

from __future__ import annotations

import os
from pathlib import Path

from hts_go1_runtime.errors import RuntimeFault

KEY = "s"
"""Typed, then Enter; any other line stops the robot."""


class Rest:
    """Whether somebody wants the robot to sit down. path: a file that says so while it is there."""

    def __init__(self, path: Path) -> None:
        self._path, self._asked = os.fspath(path), ""

    def ask(self, how: str) -> None:
        """At the next step. From any thread. how: in words."""
        self._asked = how

    def check(self) -> None:
        """Raises RuntimeFault, at which a robot sits down."""
        how = self._asked or ("the file SIT" if os.path.exists(self._path) else "")
        if how:
            raise RuntimeFault(
                f"Asked to sit down ({how}): the visit ends here. Rows that have a log stay; the same command walks "
                "the others."
            )
