"""One process of the twin, seen from the run: start it, ask it, tell how it ended."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from hts.errors import BY_NAME, WorldError

TAIL_LINES = 3  # of stderr, in the message about its end


class Child:
    """A twin's process, ready when made. log: where its stderr goes; start: first line of process.py's protocol.

    Raises WorldError if the log cannot be written or the process does not come up; what the twin itself refuses
    (a wrong setting, a broken policy) arrives as the error that it raised over there.
    """

    def __init__(self, log: Path, start: Mapping[str, Any]) -> None:
        self._log_path = log
        try:
            log.parent.mkdir(parents=True, exist_ok=True)
            self._log = log.open("w", encoding="utf-8")
        except OSError as error:
            raise WorldError(
                f"{log}: the twin cannot write here ({error.strerror}). Choose a folder with --out that can be written."
            ) from error
        # One core each: that is what several processes are for.
        # Nothing is drawn, so no library need look for a display.
        environment = {
            **os.environ,
            "OMP_NUM_THREADS": "1",
            "MUJOCO_GL": "disable",
            "PYTHONPATH": os.pathsep.join(part for part in sys.path if part),
        }
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "hts.worlds.twin.process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            encoding="utf-8",
            env=environment,
        )
        try:
            self.ask(start)
        except BaseException:
            self.close()
            raise

    @property
    def pid(self) -> int:
        return self._process.pid

    def ask(self, request: Mapping[str, Any], progress: Callable[[float], None] | None = None) -> Any:
        """The answer to one request. Raises the HtsError that the twin raised, or WorldError if the process ended."""
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
        except OSError:
            raise self._ended() from None
        for line in self._process.stdout:
            answer = json.loads(line)
            if "done" in answer:
                return answer["done"]
            if "error" in answer:
                error = BY_NAME.get(answer["kind"], WorldError)(answer["error"])
                error.add_note(answer["trace"])  # seen with HTS_DEBUG=1
                raise error
            if progress is not None:
                progress(answer["progress"])
        raise self._ended()

    def close(self) -> None:
        """End the process, whatever it is doing. May be called from another thread than `ask`."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._log):
            if pipe is not None:
                with suppress(BrokenPipeError):  # what was still in the buffer has nobody to read it
                    pipe.close()
        if self._log_path.exists() and self._log_path.stat().st_size == 0:
            self._log_path.unlink()

    def _ended(self) -> WorldError:
        """One line about a process that ended by itself, with the end of what it said."""
        code = self._process.wait()
        text = self._log_path.read_text(encoding="utf-8", errors="replace")
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        said = " | ".join(lines[-TAIL_LINES:]) or "nothing"
        if len(lines) > TAIL_LINES:
            said += f" (all of it in {self._log_path})"
        how = f"by signal {-code}" if code < 0 else f"with exit code {code}"
        if -code == signal.SIGKILL:
            how += " (which the system sends to what takes more memory than there is)"
        return WorldError(f"The twin's process ended {how}; it said: {said}.")
