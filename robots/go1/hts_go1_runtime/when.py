"""When a row was recorded: a log's own stamps are of a clock that begins anew whenever its computer does."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path

BEGAN, BOOT = "began_at", "boot"
"""Notes of a log: the date (ISO, with the time zone), and what the system calls its time since it was switched on.
`hts` reads both to tell rows of one visit from rows of two."""
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


def noted(simulated: bool) -> dict[str, str]:
    """The notes of a row that begins now; none by the clock of a simulation, which has no date."""
    if simulated:
        return {}
    try:
        boot = {BOOT: BOOT_ID.read_text(encoding="ascii").strip()}
    except (OSError, ValueError):  # another system
        boot = {}
    return {BEGAN: datetime.now().astimezone().isoformat(timespec="milliseconds"), **boot}


def began(logs: Path, name: str) -> float | None:
    """When a row's log began, s since 1970: as its mapping notes, whatever copying did to the files since; else by the
    file's time. None where there is no log."""
    try:
        changed = (logs / f"{name}.csv").stat().st_mtime
    except OSError:
        return None
    try:
        content = json.loads((logs / "mappings" / f"{name}.yaml").read_text(encoding="utf-8"))
        return datetime.fromisoformat(content["recording"]["notes"][BEGAN]).timestamp()
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):  # none, an older one, or edited
        return changed
