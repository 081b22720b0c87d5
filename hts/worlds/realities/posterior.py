"""What the facts say: parameters of the draws that were kept against those of all draws."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hts.worlds.realities.folder import draws_of
from hts.worlds.realities.ranges import Drawn

Lines = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Narrowed:
    """One parameter: quartiles of its range (`prior`) and of what was kept (`posterior`), and how far its mean rank
    moved, in standard errors of a mean of so many: |z| above 3 is hardly chance, among a hundred parameters."""

    key: str
    prior: tuple[float, float, float]
    posterior: tuple[float, float, float]
    z: float


def accepted(folder: Path) -> str:
    """How many of the draws of a folder were kept, and what ended most of the others: one line."""
    lines = draws_of(folder).lines
    kept, others = sum(bool(line["kept"]) for line in lines), reasons(lines)
    others.pop("kept", None)
    ended = ", ".join(f"{reason} ({number})" for reason, number in others.most_common(4))
    share = f"kept {kept} of {len(lines)} draws ({kept / max(len(lines), 1):.2%})"
    return f"{share}; ended by {ended}" if ended else share


def narrowed(parameters: Sequence[Drawn], lines: Lines) -> list[Narrowed]:
    """Those that are single numbers, the most moved first. Prior and rank are those of the range itself."""
    found = []
    for one in parameters:
        if one.boolean or one.whole or one.counts:
            continue
        values = np.array([line["values"][one.key] for line in lines if line["kept"] and one.key in line["values"]])
        if len(values) < 2:
            continue
        if one.logarithmic:
            share = np.log(values / one.low) / np.log(one.high / one.low)
        else:
            share = (values - one.low) / (one.high - one.low)
        z = (share.mean() - 0.5) * np.sqrt(12 * len(values))  # a uniform share has a variance of 1/12
        low, middle, high = map(float, np.percentile(values, (25, 50, 75)))
        found.append(Narrowed(one.key, one.quartiles(), (low, middle, high), float(z)))
    return sorted(found, key=lambda one: -abs(one.z))


def reasons(lines: Lines) -> Counter[str]:
    """Why draws were dropped, without the numbers; "kept" for the others."""
    return Counter("kept" if line["kept"] else _kind(line["why"]) for line in lines)


def text(parameters: Sequence[Drawn], names: Sequence[str], lines: Lines, most: int = 12) -> str:
    """Tables in markdown."""
    kept, moved = sum(bool(line["kept"]) for line in lines), narrowed(parameters, lines)
    rows = [f"{kept} of {len(lines)} draws kept ({kept / max(len(lines), 1):.1%}).", ""]
    rows += ["| ended by | draws |", "|---|---|"]
    rows += [f"| {reason} | {number} |" for reason, number in reasons(lines).most_common()]
    rows += table_of(moved, most)
    on = {name: sum(line["kept"] and name in line["switches"] for line in lines) for name in names}
    rows += [
        "",
        "| structure | on, of the kept |",
        "|---|---|",
        *(f"| `{name}` | {on[name]} of {kept} |" for name in on),
    ]
    return "\n".join(rows)


def table_of(moved: Sequence[Narrowed], most: int) -> list[str]:
    """Lines of markdown. moved: the most moved first; most: how many are shown."""
    rows = ["", f"The {min(most, len(moved))} of {len(moved)} parameters that moved most:", ""]
    rows += ["| parameter | range: 25, 50, 75 % | kept: 25, 50, 75 % | z |", "|---|---|---|---|"]
    for one in moved[:most]:
        before, after = (", ".join(f"{value:.3g}" for value in three) for three in (one.prior, one.posterior))
        rows.append(f"| `{one.key}` | {before} | {after} | {one.z:+.1f} |")
    return rows


def _kind(why: str) -> str:
    """`standing 79.9 W` -> `standing`; what more is said after an `and` is left out."""
    if why.startswith("fell"):
        return "a fall"
    words = why.split(" and ")[0].split()
    name = " ".join(itertools.takewhile(lambda word: not word[:1].isdigit(), words))
    return f"{name.removesuffix(' at')}{', by statics' if why.endswith('by statics') else ''}"
