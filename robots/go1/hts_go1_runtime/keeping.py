"""Rows on their way to the disk: which are whole there, and what becomes of them where the disk refuses.

A visit does not end before its rows are on the disk: what a full one refuses waits in memory. Who cannot free it sends
a signal (Ctrl-C) once that has been said; then the rows go to the folder for temporary files instead.
"""

from __future__ import annotations

import contextlib
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.events import Events
from hts_go1_runtime.log import RowLog
from hts_go1_runtime.operator_key import handled
from hts_go1_runtime.rows import Row

PATIENCE = 10.0  # s that rows may take to the other folder
GLANCE = 0.02  # s
GIVES_UP = (signal.SIGINT, signal.SIGTERM)  # a terminal that goes sends others, and often more than one


class Keeper:
    """done: names of the logs that are whole."""

    def __init__(self, events: Events) -> None:
        self.done: list[str] = []
        self._events = events
        self._open: list[tuple[RowLog, Row]] = []  # walked, but not whole on the disk yet
        self._left: list[RowLog] = []  # broken off
        self._unnamed: list[RowLog] = []  # whose name was taken meanwhile
        self._elsewhere: list[RowLog] = []  # walked, and written into another folder
        self._asked = self._lost = False

    def walked(self, log: RowLog, row: Row) -> None:
        """A row that is over."""
        self._open.append((log, row))
        self.look()

    def broken_off(self, log: RowLog) -> None:
        """A row that is to be walked again; what there is of it is kept apart."""
        log.closing(whole=False)
        self._left.append(log)

    def check(self, current: RowLog) -> None:
        """Raise RuntimeFault if the disk refuses rows. current: the log that is being written."""
        for log in [current, *(one for one, _ in self._open)]:
            if log.fault:
                raise RuntimeFault(f"{log.fault}. The robot sits; free space, then run the same again.")

    def look(self) -> None:
        """Note which logs are whole on the disk now."""
        for log, row in list(self._open):
            if not log.closing().is_set():
                continue
            self._open.remove((log, row))
            if log.unnamed:
                self._unnamed.append(log)
                self._events.say("not recorded", log=row.log, why=log.unnamed)
            elif log.elsewhere:
                self._elsewhere.append(log)
            else:
                self.done.append(row.log)
                self._events.say("recorded", log=row.log, samples=log.rows)

    def wait(self) -> None:
        """Until all is on the disk; the robot is damped. Or, by a signal, in a folder for temporary files."""
        while self._pending() and not self._fault():
            self.look()
            time.sleep(GLANCE)
        if not self._pending():
            return
        with heard() as signals:  # from before it is said, so that none is lost
            self._events.say(
                "waiting for the disk: free space, what was recorded is in memory; Ctrl-C writes it to a temporary "
                "folder",
                why=self._fault(),
            )
            answered = 0
            while self._pending() and not self._lost:
                self.look()
                if any(not self._asked or one in GIVES_UP for one in signals[answered:]):
                    self._leave()
                    answered = len(signals)  # what came meanwhile is no answer to what has just been said
                time.sleep(GLANCE)
        self.look()

    def check_kept(self) -> None:
        """Raise RuntimeFault for rows that were walked and are not where they belong."""
        if self._lost:
            raise RuntimeFault("What the disk refused is lost: it was given up. Free space, then run the same again.")
        if self._elsewhere:
            folder = Path(self._elsewhere[0].elsewhere).parent
            raise RuntimeFault(
                f"The disk refused rows; they are in {folder}. Free space, move the .csv there into the bundle's logs "
                "and what is in mappings into logs/mappings, then run the same again."
            )
        if self._unnamed:
            raise RuntimeFault(f"{self._unnamed[0].unnamed}. Look at both, and move away the one that is none.")

    def _pending(self) -> list[RowLog]:
        self.look()
        logs = [log for log, _ in self._open]
        return [*logs, *(log for log in self._left if not log.closing(whole=False).is_set())]

    def _fault(self) -> str:
        return next((log.fault for log in self._pending() if log.fault), "")

    def _leave(self) -> None:
        """Write what waits somewhere else; where that cannot be done either, the next time gives it up."""
        if self._asked:
            self._lost = True
            self._events.say("given up: what the disk refused is lost")
            return
        self._asked = True
        try:
            folder = Path(tempfile.mkdtemp(prefix="hts-rows-"))
        except OSError as error:
            self._events.say("cannot be written elsewhere; Ctrl-C once more gives it up", why=str(error))
            return
        for log in self._pending():
            log.write_elsewhere(folder)
        end = time.monotonic() + PATIENCE
        while self._pending() and time.monotonic() < end:
            time.sleep(GLANCE)
        if self._pending():
            why = self._fault() or f"nothing was written for {PATIENCE:g} s"
            self._events.say("cannot be written elsewhere; Ctrl-C once more gives it up", why=why)
        else:
            self._events.say("what the disk refused is in another folder", folder=str(folder))


@contextlib.contextmanager
def heard() -> Iterator[list[int]]:
    """The signals that come while inside, which then do nothing else."""
    numbers: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield numbers  # only that one may ask for signals
        return
    with handled(lambda number, frame: numbers.append(number)):
        yield numbers
