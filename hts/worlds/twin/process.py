"""`python -m hts.worlds.twin.process`: the twin's own process.

It reads JSON lines from stdin and answers each by JSON lines on stdout; recordings go to a spool store that the
parent names. The first line says which twin it is, and is answered once the twin is ready:

    {"settings": {...}, "robot": "...", "robot_settings": {...}, "objectives": {...}, "seed": 0, "name": "twin", "spool": "DIR"}

Then any of

    {"do": "idle"}
    {"do": "collect", "policies": [PATH | null, ...], "schedule": {...}}
    {"do": "head_to_heads", "policies": [PATH, ...], "reference": PATH, "speeds": [...]}

Answers: {"progress": 0.25} any number of times, then {"done": ...} or {"error": "one line", "kind": "WorldError"}.
The process ends when stdin does, even in the midst of work, so a killed parent leaves nothing running.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TextIO

from hts.config import ScheduleConfig
from hts.errors import HtsError
from hts.worlds.base import file_hash, in_groups, request_id, seed_sequence
from hts.worlds.twin.parameters import TwinSettings

PROGRESS_SECONDS = 0.5


class Twin:
    """The twin behind the process: makes batches of robots and writes what they record into the spool."""

    def __init__(self, start: dict[str, Any]) -> None:
        from hts import plugins
        from hts.recordings.store import RecordingStore
        from hts.worlds.twin.instruments import make_instruments

        registry = plugins.load()
        self.settings = TwinSettings.model_validate(start["settings"])
        self.robot = registry.make_robot(start["robot"], start["robot_settings"])
        self.seed, self.name = int(start["seed"]), start["name"]
        self._make = lambda: make_instruments(registry, self.robot, start["objectives"], self.settings.instruments)
        self._make()  # wrong settings are told at once
        self.spool = RecordingStore(Path(start["spool"]), create=True)

    def idle(self) -> dict[str, float]:
        """Idle level of each real channel."""
        levels: dict[str, float] = {}
        for instrument in self._make().values():
            levels |= instrument.idle()
        return levels

    def collect(self, request: dict[str, Any], progress: Callable[[float], None]) -> list[str]:
        """Ids of one recording per policy."""
        from hts.worlds.twin.programme import collection

        schedule = ScheduleConfig.model_validate(request["schedule"])
        policies = request["policies"]
        name = request_id("collect", self.seed, [path and file_hash(path) for path in policies], request["schedule"])
        sessions = collection(policies, schedule, name)
        return [ids[0] for ids in self._run(sessions, name, progress)]

    def head_to_heads(self, request: dict[str, Any], progress: Callable[[float], None]) -> list[list[str]]:
        """Ids of each policy's recordings: at each speed in turn, its four blocks."""
        from hts.worlds.twin.programme import head_to_head

        reference, speeds, settings = request["reference"], request["speeds"], self.settings
        policies = request["policies"]
        known = file_hash(reference)
        names = [
            [request_id("head_to_head", self.seed, number, file_hash(path), known, speed) for speed in speeds]
            for number, path in enumerate(policies)
        ]
        sessions = [
            head_to_head(path, reference, speed, settings.warmup_seconds, settings.block_seconds, session)
            for path, row in zip(policies, names, strict=True)
            for speed, session in zip(speeds, row, strict=True)
        ]
        ids = self._run(sessions, request_id(*names, settings.block_seconds), progress)
        width = len(speeds)
        return [sum(ids[i * width : (i + 1) * width], []) for i in range(len(policies))]

    def _run(self, sessions: Sequence[Any], request: str, progress: Callable[[float], None]) -> list[list[str]]:
        from hts.worlds.twin.session import Batch

        ids: list[list[str]] = []
        groups = in_groups(len(sessions), self.settings.max_worlds)
        for number, group in enumerate(groups):
            seeds = seed_sequence(self.seed, request, number)
            batch = Batch(self.robot, self.settings, self._make(), len(group), seeds)
            try:
                recordings = batch.run(
                    [sessions[i] for i in group], self.name, lambda x, n=number: progress((n + x) / len(groups))
                )
            finally:
                batch.close()
            ids += [[self.spool.write(recording) for recording in row] for row in recordings]
        return ids


def requests() -> Callable[[], str]:
    """Lines of stdin, one a call. When stdin ends, a thread ends the process at once, whatever it is doing."""
    lines: queue.Queue[str] = queue.Queue()

    def listen() -> None:
        for line in sys.stdin:
            lines.put(line)
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    return lines.get


def answers() -> Callable[[dict[str, Any]], None]:
    """Writes answers to the real stdout; whatever else prints goes to stderr and cannot garble them."""
    channel: TextIO = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())

    def answer(content: dict[str, Any]) -> None:
        channel.write(json.dumps(content) + "\n")
        channel.flush()

    return answer


def main() -> None:
    """Serve until stdin ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle; it closes stdin
    answer, listen = answers(), requests()
    last = [0.0]

    def progress(share: float) -> None:
        if time.monotonic() - last[0] > PROGRESS_SECONDS:
            last[0] = time.monotonic()
            answer({"progress": share})

    twin: Twin | None = None
    while True:
        request = json.loads(listen())
        try:
            if twin is None:
                twin = Twin(request)
                answer({"done": "ready"})
            elif request["do"] == "idle":
                answer({"done": twin.idle()})
            elif request["do"] == "collect":
                answer({"done": twin.collect(request, progress)})
            else:
                answer({"done": twin.head_to_heads(request, progress)})
        except HtsError as error:
            answer({"error": str(error), "kind": type(error).__name__})


if __name__ == "__main__":
    main()
