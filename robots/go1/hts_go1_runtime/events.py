"""What happened in a session: on the disk first, and said aloud where somebody still reads."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from hts_go1_runtime.errors import Stopped
from hts_go1_runtime.log import TRY_AGAIN_SECONDS, write_whole


class Events:
    """What happened in a session, one JSON line each, in logs/events.jsonl; said aloud too. By two threads: neither a
    disk nor a terminal makes a step late, and a terminal that is gone or stands still keeps nothing from the disk. What
    a full disk refuses waits, in order, and is written once there is space; what is said aloud does not wait for it.
    To be used within `terminal.that_may_go`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._queue: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._shown: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._work, self._speak)]
        for thread in self._threads:
            thread.start()

    def say(self, what: str, **numbers: Any) -> None:
        """Note something."""
        line = json.dumps({"at": time.strftime("%Y-%m-%dT%H:%M:%S%z"), "what": what, **numbers}) + "\n"
        self._queue.put(lambda: append_whole(self._path, line))
        self._shown.put(" ".join([what, *(f"{key}={value}" for key, value in numbers.items())]))

    @contextlib.contextmanager
    def stops(self) -> Iterator[None]:
        """Note what stops the robot while inside."""
        try:
            yield
        except Stopped as stopped:
            self.say("stopped", reason=stopped.reason, detail=stopped.detail)
            raise

    def keep(self, path: Path, text: str) -> None:
        """Write a small file."""
        self._queue.put(lambda: write_whole(path, text))

    def close(self, seconds: float = 10.0) -> None:
        """Wait until all is written and said, at most so long."""
        end = time.monotonic() + seconds
        self._queue.put(None)
        self._threads[0].join(seconds)
        self._shown.put(None)
        self._threads[1].join(max(0.0, end - time.monotonic()))

    def _work(self) -> None:
        waiting: deque[Callable[[], None]] = deque()
        over = said = False
        while not over or waiting:
            with contextlib.suppress(queue.Empty):
                item = self._queue.get(timeout=TRY_AGAIN_SECONDS if waiting else None)
                over = over or item is None
                if item is not None:
                    waiting.append(item)
            try:
                while waiting:
                    waiting[0]()
                    waiting.popleft()
            except OSError as error:
                if not said:
                    self._shown.put(f"{error.filename or self._path}: cannot be written yet ({error.strerror})")
                said = True

    def _speak(self) -> None:
        while (text := self._shown.get()) is not None:
            print(text, flush=True)


def append_whole(path: Path, line: str) -> None:
    """A line at the end of a file, or nothing. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    try:
        size, left = os.fstat(handle).st_size, line.encode()
        try:
            while left:
                left = left[os.write(handle, left) :]
        except OSError:
            os.ftruncate(handle, size)  # of a full disk: half a line is worse than none
            raise
    finally:
        os.close(handle)
