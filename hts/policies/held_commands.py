"""The commands at which a run's final found its speeds held, built into an exported policy.

A head-to-head at held speed trims each policy's command until the measured speed is the one asked for, so what it says
holds for those commands. At the plain command the same policy may walk faster or slower, or stand. With this in front
of it, a commanded forward speed is the speed that was walked.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from hts.errors import PolicyError
from hts.policies.files import PolicyCard

COMMAND = "command"  # the observed part; forward speed, m/s, is its first number


@dataclass(frozen=True)
class HeldCommands:
    """Wanted forward speeds and the commands sent for them, both m/s, both rising.

    Between them, and from standing to the slowest, the command is interpolated; above the fastest it stays what it was
    there, so nothing is sent that was not walked. Backwards, sideways and turning are left as they are.
    Raises PolicyError for points that are none.
    """

    speeds: tuple[float, ...]
    commands: tuple[float, ...]

    def __post_init__(self) -> None:
        for what, values in (("speeds", self.speeds), ("commands", self.commands)):
            rising = all(low < high for low, high in pairwise((0.0, *values)))
            if not values or len(values) != len(self.speeds) or not (rising and math.isfinite(values[-1])):
                shown = ", ".join(f"{value:g}" for value in values) or "none"
                raise PolicyError(
                    f"Commands of held speeds: found the {what} {shown} m/s, expected as many speeds as commands, both "
                    "above 0 and rising. Export without them, and trim on the robot."
                )

    def of(self, speeds: np.ndarray) -> np.ndarray:
        """The commands for wanted speeds, m/s, any shape."""
        found = np.interp(speeds, (0.0, *self.speeds), (0.0, *self.commands))
        return np.where(speeds < 0.0, speeds, found)

    def kinks(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Speeds m/s at which the slope changes, and by how much: of(v) = v + Σ change · max(v − kink, 0)."""
        points = list(zip((0.0, *self.speeds), (0.0, *self.commands), strict=True))
        slopes = [1.0, *((b[1] - a[1]) / (b[0] - a[0]) for a, b in pairwise(points)), 0.0]
        return tuple(speed for speed, _ in points), tuple(after - before for before, after in pairwise(slopes))

    def matrices(self, card: PolicyCard) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """R (K, O), b (K,), W (K, O), float32: with an observation o (O,), o + max(R o + b, 0) W is the observation
        whose commands are `of` the wanted speeds, in each stacked observation. Raises PolicyError as `columns`."""
        kinks, changes = self.kinks()
        places = columns(card)
        rows = np.zeros((len(places) * len(kinks), card.observation_size), np.float32)
        written = np.zeros_like(rows)
        for index, (place, change) in enumerate((place, change) for place in places for change in changes):
            rows[index, place], written[index, place] = 1.0, change
        return rows, -np.tile(np.array(kinks, np.float32), len(places)), written

    def as_text(self) -> dict[str, str]:
        """For a file's metadata: held_speeds and held_commands, m/s, comma-separated, in full precision."""
        return {f"held_{name}": ",".join(map(repr, getattr(self, name))) for name in ("speeds", "commands")}


def columns(card: PolicyCard) -> list[int]:
    """Where the commanded forward speed stands in a policy's observation, once for each that is stacked.

    Raises PolicyError for a policy that sees no command.
    """
    names, widths = [part["name"] for part in card.observation], [int(part["size"]) for part in card.observation]
    if COMMAND not in names:
        raise PolicyError(f"The policy observes {', '.join(map(str, names))}: no command, so none can be trimmed.")
    first = sum(widths[: names.index(COMMAND)])
    return [first + stacked * sum(widths) for stacked in range(card.history)]


def held_commands_of(folder: Path, policy: str) -> HeldCommands:
    """What the final of a finished run sent. policy: "best", its id, or "pretrained" (the final's reference).

    Raises PolicyError where the run has no final, its final held no speed, or it was another policy's.
    """
    path = folder / "summary.json"
    try:
        final = json.loads(path.read_text(encoding="utf-8"))["final"]
        objectives = list(final["objectives"].values()) if final else []
        rows = [(float(speed), row) for one in objectives for speed, row in one["speeds"].items() if row.get("held")]
        tried = final["policy"] if final else ""
    except FileNotFoundError:
        raise PolicyError(
            f"{folder}: has no summary.json yet. Commands are found in the final: finish the run."
        ) from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise PolicyError(f"{path}: not what a run writes ({type(error).__name__}: {error}).") from error
    if not objectives:
        raise PolicyError(f"{folder}: nobody kept a speed in a final, so no commands are known. Export without them.")
    own = policy in ("best", tried)
    if not own and policy != "pretrained":
        raise PolicyError(
            f"{folder}: the final was that of {tried} against the pretrained policy, so commands of {policy} are not "
            "known. Export without them, and trim on the robot."
        )
    if not rows:
        raise PolicyError(
            f"{folder}: its final held no speed, so no commands were found. Export without them, and trim on the robot."
        )
    found: dict[float, float] = {}
    for speed, row in rows:  # objectives share a final's recordings, and so its commands
        found.setdefault(speed, _sent(path, row if own else row.get("reference")))
    return HeldCommands(tuple(sorted(found)), tuple(found[speed] for speed in sorted(found)))


def _sent(path: Path, row: Any) -> float:
    command = row.get("commanded") if isinstance(row, dict) else None
    if not isinstance(command, float | int):
        raise PolicyError(f"{path}: a held speed lacks the command that was sent. Export without them.")
    return float(command)
