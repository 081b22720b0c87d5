"""How set-points and what was achieved are called: a commanded speed, a set-point of another task, or neither."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from hts.report import wording


@dataclass(frozen=True)
class TaskWords:
    """From `task` of a summary.json or an evaluation.json; runs of before tasks had names followed a velocity."""

    velocity: bool = True
    quantity: str = "forward speed"
    unit: str = "m/s"
    commanded: bool = True

    @classmethod
    def of(cls, result: Mapping[str, Any]) -> TaskWords:
        """Of a summary or an evaluation."""
        return cls(**(result.get("task") or {}))

    @property
    def unit_after(self) -> str:
        """The unit with a space before it, for the end of a number; empty for a plain number."""
        return "" if self.unit == "1" else f" {self.unit}"

    @property
    def column(self) -> str:
        """Heading of a narrow table."""
        return "speed" if self.velocity else "set-point"

    @property
    def heading(self) -> str:
        """The same where there is room."""
        return "commanded speed" if self.velocity else "set-point"

    @property
    def achieved(self) -> str:
        """Heading of what was achieved."""
        return "mean speed" if self.velocity else f"mean {self.quantity}"

    @property
    def achieved_column(self) -> str:
        """The same with the unit, for a narrow table."""
        return "mean m/s" if self.velocity else f"mean {self.quantity}{self.unit_after and ',' + self.unit_after}"

    @property
    def done(self) -> str:
        """What a policy that is not judged does not do."""
        return "keep the commanded speed" if self.velocity else "do its task"

    @property
    def everywhere(self) -> str:
        """End of a sentence about all of them."""
        return f", at every {'speed' if self.velocity else 'set-point'} tested" if self.commanded else ""

    def point(self, key: str) -> str:
        """A key of `speeds`: 0.8 m/s; a dash where nothing is commanded."""
        return f"{key}{self.unit_after}" if self.commanded else "–"

    def at(self, keys: Iterable[str]) -> str:
        """ " at 0.5 and 0.8 m/s", for the middle of a sentence; empty where nothing is commanded."""
        shown = " and ".join(sorted(keys, key=float))
        return f" at {shown}{self.unit_after}" if self.commanded and shown else ""

    def amount(self, value: float | None) -> str:
        """What was achieved: 0.79 m/s."""
        return f"{wording.number(value)}{self.unit_after}"


VELOCITY = TaskWords()
