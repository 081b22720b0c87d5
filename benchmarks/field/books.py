"""What the operator has done so far, kept in OUT/operator.json so that the operator itself may be killed."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Any

from hts.atomic import atomic_write


class Books:
    """Entries by kind: starts of hts, visits, kills, imports. Threads may write at the same time."""

    def __init__(self, out: Path) -> None:
        self.path = out / "operator.json"
        self._lock = threading.Lock()
        self._kept: dict[str, Any] = json.loads(self.path.read_text()) if self.path.exists() else {}
        self._before, self._began = float(self._kept.get("wall_s", 0.0)), time.monotonic()

    def add(self, kind: str, **entry: Any) -> None:
        """Note something, for good."""
        with self._lock:
            self._kept.setdefault(kind, []).append(entry)
            self._kept["wall_s"] = self.wall_seconds
            atomic_write(self.path, json.dumps(self._kept, indent=1) + "\n")

    def entries(self, kind: str) -> list[dict[str, Any]]:
        """All of a kind, oldest first."""
        with self._lock:
            return list(self._kept.get(kind, []))

    @property
    def wall_seconds(self) -> float:
        """Since the first start, without the time between an end and the next start."""
        return round(self._before + time.monotonic() - self._began, 1)
