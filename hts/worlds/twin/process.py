"""`python -m hts.worlds.twin.process`: the twin's own process. A world starts one per core.

It reads JSON lines from stdin and answers each by JSON lines on stdout; recordings go to a spool store that the
parent names. The first line says which twin it is, and is answered once the twin is ready:

    {"settings": {...}, "robot": "...", "robot_settings": {...}, "objectives": {...}, "seed": 0, "name": "twin",
     "spool": "DIR"}

Then any of

    {"do": "idle"}
    {"do": "check"}                                                     compile the machine, read its instruments
    {"do": "run", "sessions": [...], "request": "hex", "group": 0}      sessions as in programme.py

Answers: {"progress": 0.25} any number of times, then {"done": ...} or
{"error": "one line", "kind": "WorldError", "trace": "Traceback ..."}.
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
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TextIO

from hts.contracts import FollowVelocity
from hts.errors import HtsError, UnfitWorldError
from hts.guarded import guarded
from hts.worlds.base import seed_sequence
from hts.worlds.twin.parameters import TwinSettings, resolved_settings
from hts.worlds.twin.programme import Session

PROGRESS_SECONDS = 0.5


class Twin:
    """The twin behind the process: makes batches of robots and writes what they record into the spool."""

    def __init__(self, start: dict[str, Any]) -> None:
        from hts import plugins
        from hts.recordings.store import RecordingStore
        from hts.worlds.twin.instruments import maker

        registry = plugins.load()
        self.robot = registry.make_robot(start["robot"], start["robot_settings"])
        self.settings = resolved_settings(TwinSettings.model_validate(start["settings"]), start["robot"])
        self.seed, self.name = int(start["seed"]), start["name"]
        self.wanted = {
            name: registry.make_objective(name, settings).real_channels
            for name, settings in start["objectives"].items()
        }
        self._make = maker(registry, self.robot, start["objectives"], self.settings)
        self.spool = RecordingStore(Path(start["spool"]), create=True)

    def do(self, request: dict[str, Any], progress: Callable[[float], None]) -> Any:
        """What is answered to a request."""
        if request["do"] == "idle":
            return self.idle()
        if request["do"] == "check":
            return self.check()
        return self.run(request, progress)

    def idle(self) -> dict[str, float]:
        """Idle level of each real channel."""
        levels: dict[str, float] = {}
        for instrument in self._make().values():
            levels |= instrument.idle()
        return levels

    def check(self) -> str:
        """A twin of this robot can be made, and its instruments measure what every objective wants."""
        from hts.worlds.twin.instruments import check_idle_levels, check_readings
        from hts.worlds.twin.model import build

        if not isinstance(self.robot.task(), FollowVelocity):
            raise UnfitWorldError(
                f"A twin walks at commanded velocities; robot '{self.robot.spec.name}' has another task. Start a run "
                "in another world: --world field, or one that a plugin brings."
            )
        instruments = self._make()
        shown = {one.name: (which, one) for which, instrument in instruments.items() for one in instrument.channels}
        for name, target in ((name, one) for name, wanted in self.wanted.items() for one in wanted):
            if target.name not in shown:
                raise UnfitWorldError(
                    f"Objective '{name}' wants '{target.name}', which no instrument of this twin measures "
                    f"({', '.join(sorted(shown))}). Name the right one in the objective's class."
                )
            which, given = shown[target.name]
            if (given.unit, given.shape) != (target.unit, target.shape):
                raise UnfitWorldError(
                    f"Objective '{name}' wants '{target.name}' in {target.unit}, shape {target.shape}; instrument "
                    f"'{which}' measures it in {given.unit}, shape {given.shape}. Use one Channel for both."
                )
        check_readings(instruments, self.robot)
        check_idle_levels(instruments, {name: wanted[0].name for name, wanted in self.wanted.items()})
        build(self.robot, self.settings.dynamics)
        return "ready"

    def run(self, request: dict[str, Any], progress: Callable[[float], None]) -> list[list[str]]:
        """Ids of each session's recordings."""
        from hts.worlds.twin.session import Batch

        sessions = [Session.model_validate(session) for session in request["sessions"]]
        seeds = seed_sequence(self.seed, request["request"], request["group"])
        batch = Batch(self.robot, self.settings, self._make(), len(sessions), seeds)
        try:
            rows = batch.run(sessions, self.name, progress)
        finally:
            batch.close()
        return [[self.spool.write(recording) for recording in row] for row in rows]


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
                twin = guarded("The twin", partial(Twin, request))
                answer({"done": "ready"})
            else:
                answer({"done": guarded("The twin", partial(twin.do, request, progress))})
        except HtsError as error:
            answer({"error": str(error), "kind": type(error).__name__, "trace": traceback.format_exc()})


if __name__ == "__main__":
    main()
