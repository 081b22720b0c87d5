"""The commands at which a run's final found its speeds held, built into an exported policy.

A head-to-head at held speed trims each policy's command until the measured speed is the one asked for, so what it says
holds for those commands, on that machine. At the plain command the same policy may walk faster or slower, or stand.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from hts.errors import PolicyError
from hts.policies.files import PolicyCard
from hts.policy_ids import PRETRAINED

COMMAND, AXES = "command", 3  # the observed part: forward and sideways speed, m/s, and yaw rate, rad/s
FAR = 1e6  # m/s: beyond any command; 0 · inf would be no number


@dataclass(frozen=True)
class HeldCommands:
    """Wanted forward speeds and the commands sent for them, both m/s, both rising.

    Between them the command is interpolated, above the fastest it stays what it was there. From standing to the slowest
    it is a straight line that nobody has walked, down to commands below those that are trained. Forward commands are
    changed whatever goes with them (they were found walking straight); backwards, sideways and turning are left alone.
    not_held: speeds, m/s, that the final was asked for and that are no points, since they were refused or it fell.
    Raises PolicyError for points that are none.
    """

    speeds: tuple[float, ...]
    commands: tuple[float, ...]
    not_held: tuple[float, ...] = ()

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

    def pieces(self) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
        """Starts and widths, m/s, and changes c: of(v) = v + Σ c · min(max(v − start, 0), width). Each is bounded but
        the last, whose c is −1, so nothing large is left to cancel."""
        points = [(0.0, 0.0), *zip(self.speeds, self.commands, strict=True)]
        widths = [fast[0] - slow[0] for slow, fast in pairwise(points)]
        rises = [fast[1] - slow[1] for slow, fast in pairwise(points)]
        changes = [rise / width - 1.0 for rise, width in zip(rises, widths, strict=True)]
        return tuple(speed for speed, _ in points), (*widths, FAR), (*changes, -1.0)

    def matrices(self, card: PolicyCard) -> dict[str, np.ndarray]:
        """columns (K, O), starts (K,), widths (K,), changes (K, O), float32: with an observation o (O,),
        o + min(max(columns · o + starts, 0), widths) · changes is the observation whose commands are `of` the wanted
        speeds, in each stacked observation. Raises PolicyError as `columns`."""
        starts, widths, changes = self.pieces()
        places = columns(card)
        rows = np.zeros((len(places) * len(starts), card.observation_size), np.float32)
        written = np.zeros_like(rows)
        for index, (place, change) in enumerate((place, change) for place in places for change in changes):
            rows[index, place], written[index, place] = 1.0, change
        vectors = {"starts": -np.array(starts, np.float32), "widths": np.array(widths, np.float32)}
        return {
            "columns": rows,
            **{name: np.tile(one, len(places)) for name, one in vectors.items()},
            "changes": written,
        }

    def card_of(self, card: PolicyCard) -> PolicyCard:
        """The card of a policy with these commands in front: another policy, with a hash of its own."""
        text = f"{card.policy_hash} {self.as_text()}"
        made = {**card.made, "held": {"policy_hash": card.policy_hash, **self.as_text()}}
        return dataclasses.replace(card, policy_hash=hashlib.sha256(text.encode()).hexdigest(), made=made)

    def said(self) -> str:
        """For who exports it, one line."""
        shown = [
            ", ".join(f"{value:.3g}" for value in values) for values in (self.speeds, self.commands, self.not_held)
        ]
        text = f"Commands for {shown[0]} m/s: {shown[1]}; above {self.speeds[-1]:g} m/s as there."
        return f"{text} In the final it was refused or fell at {shown[2]} m/s." if self.not_held else text

    def as_text(self) -> dict[str, str]:
        """For a file's metadata: held_speeds and held_commands, m/s, comma-separated, in full precision."""
        said = {"held_speeds": self.speeds, "held_commands": self.commands}
        return {name: ",".join(map(repr, values)) for name, values in said.items()}


def columns(card: PolicyCard) -> list[int]:
    """Where the commanded forward speed stands in a policy's observation, once for each that is stacked.

    Raises PolicyError for a policy that sees no command, or one that is not ours.
    """
    names, widths = [part["name"] for part in card.observation], [int(part["size"]) for part in card.observation]
    if COMMAND not in names:
        raise PolicyError(f"The policy observes {', '.join(map(str, names))}: no command, so none can be trimmed.")
    if widths[names.index(COMMAND)] != AXES:
        raise PolicyError(
            f"The policy's command has {widths[names.index(COMMAND)]} numbers, expected {AXES}: forward and sideways "
            "speed in m/s, yaw rate in rad/s. Export without held commands."
        )
    first = sum(widths[: names.index(COMMAND)])
    return [first + stacked * sum(widths) for stacked in range(card.history)]


def has_held_commands(path: Path) -> bool:
    """Whether this is an ONNX file with held commands in front. Raises PolicyError for a broken one."""
    from hts.policies.deploy import DeployedPolicy

    return path.suffix == ".onnx" and path.is_file() and "held" in vars(DeployedPolicy(path).card).get("made", {})


def held_commands_of(folder: Path, policy: str) -> HeldCommands:
    """What the final of a finished run sent. policy: "best", its id, or "pretrained" (the final's reference).

    Raises PolicyError where the run has no final, its final held no speed or was refused at all that it was to hold, or
    it was another policy's.
    """
    path = folder / "summary.json"
    try:
        final = json.loads(path.read_text(encoding="utf-8"))["final"]
        objectives = list(final["objectives"].values()) if final else []
        rows = [(float(speed), row) for one in objectives for speed, row in one["speeds"].items() if row.get("held")]
        asked = {speed for speed, _ in rows} | {float(speed) for one in objectives for speed in one.get("refused", ())}
        tried = final["policy"] if final else ""
        why = {str(said) for one in objectives if not one["speeds"] for said in dict(one.get("refused", {})).values()}
    except FileNotFoundError:
        raise PolicyError(
            f"{folder}: has no summary.json yet. Commands are found in the final: finish the run."
        ) from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise PolicyError(f"{path}: not what a run writes ({type(error).__name__}: {error}).") from error
    if not objectives:
        raise PolicyError(
            f"{folder}: no policy of this run kept a speed in a final, so no commands are known. "
            "Export without --held-speed."
        )
    own = policy in ("best", tried)
    if not own and policy != PRETRAINED:
        raise PolicyError(
            f"{folder}: the final was that of {tried} against the pretrained policy, so commands of {policy} are not "
            "known. Export without them, and trim on the robot."
        )
    if not rows and why:
        raise PolicyError(
            f"{folder}: its final was to hold a speed and was refused, so no command of it counts. "
            f"{' '.join(sorted(why))} Export without them, and trim on the robot."
        )
    if not rows:
        raise PolicyError(
            f"{folder}: its final held no speed, so no commands were found. Export without them, and trim on the robot."
        )
    found: dict[float, float] = {}
    for speed, row in rows:  # objectives share a final's recordings, and so its commands
        mine = row if own else row.get("reference")
        command = _sent(path, mine)
        if not mine.get("falls"):
            found.setdefault(speed, command)
    speeds = tuple(sorted(found))
    return HeldCommands(speeds, tuple(found[speed] for speed in speeds), tuple(sorted(asked - found.keys())))


def _sent(path: Path, row: Any) -> float:
    command = row.get("commanded") if isinstance(row, dict) else None
    if not isinstance(command, float | int) or isinstance(command, bool):
        raise PolicyError(f"{path}: a held speed lacks the command that was sent. Export without them.")
    return float(command)
