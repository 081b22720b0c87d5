"""The side of the twin that a run talks to. The twin itself runs in another process, so nothing can look into it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from hts import errors
from hts.config import ScheduleConfig
from hts.contracts import Settings, World, WorldContext
from hts.errors import HtsError, WorldError
from hts.recordings.recording import Recording
from hts.recordings.store import RecordingStore
from hts.worlds.base import ORDER
from hts.worlds.twin.parameters import TwinSettings

STEPS_PER_SECOND = 35_000.0  # physics steps of a twin on two cores, for the estimate of `cost`
TAIL_LINES = 3  # of the twin's stderr, in the message about its end


def make_twin(settings: Settings, context: WorldContext) -> TwinWorld:
    """The world `twin`. Its process starts with the first request."""
    return TwinWorld(TwinSettings.model_validate(dict(settings)), context)


class TwinWorld(World):
    """Simulated reality. A request that is repeated word for word gives the same recordings.

    So several recordings of one policy are asked for in one call: `collect([policy] * 3, schedule)`.
    `on_progress`, if set, is called with the done share of the current request.
    """

    name = "twin"

    def __init__(self, settings: TwinSettings, context: WorldContext) -> None:
        self.settings, self._context = settings, context
        self._process: subprocess.Popen[str] | None = None
        self._log: IO[str] | None = None
        self._folder = Path(context.folder) / "twin"
        self.on_progress: Callable[[float], None] | None = None

    def idle(self) -> Mapping[str, float]:
        return self._ask({"do": "idle"})

    def collect(self, policies: Sequence[Path | None], schedule: ScheduleConfig) -> list[Recording]:
        """As `World.collect`; a policy None stands in the default pose by the robot's own stand mode."""
        request = {"do": "collect", "policies": [_path(p) for p in policies], "schedule": schedule.model_dump(mode="json")}
        return [self._fetch(name) for name in self._ask(request)] if policies else []

    def head_to_head(self, policy: Path, reference: Path, speeds: Sequence[float]) -> list[Recording]:
        return self.head_to_heads([policy], reference, speeds)[0]

    def head_to_heads(
        self, policies: Sequence[Path], reference: Path, speeds: Sequence[float]
    ) -> list[list[Recording]]:
        """All policies at all speeds side by side, each pair on a twin of its own."""
        if not policies or not speeds:
            return [[] for _ in policies]
        request = {
            "do": "head_to_heads", "policies": [_path(p) for p in policies], "reference": _path(reference),
            "speeds": [float(speed) for speed in speeds],
        }  # fmt: skip
        return [[self._fetch(name) for name in names] for names in self._ask(request)]

    def head_to_head_seconds(self) -> float:
        """Robot time of one head-to-head at one speed, s."""
        return self.settings.warmup_seconds + len(ORDER) * self.settings.block_seconds

    def cost(self, robot_seconds: float) -> Mapping[str, float]:
        steps = robot_seconds / self.settings.dynamics.physics_dt
        return {"robot_minutes": robot_seconds / 60.0, "wall_seconds": steps / STEPS_PER_SECOND}

    def close(self) -> None:
        """End the process and remove the spool."""
        process, self._process = self._process, None
        if process is not None:
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    _close_quietly(pipe)
            process.kill()
            process.wait()
        if self._log is not None:
            self._log.close()
            self._log = None
            shutil.rmtree(self._folder / "spool", ignore_errors=True)

    # ------------------------------------------------------------------------------------------ inside

    def _start(self) -> subprocess.Popen[str]:
        """Start the process and wait until the twin is ready."""
        context = self._context
        try:
            shutil.rmtree(self._folder / "spool", ignore_errors=True)  # left by a run that was killed
            self._folder.mkdir(parents=True, exist_ok=True)
            self._log = open(self._folder / "stderr.txt", "w", encoding="utf-8")  # noqa: SIM115: closed in `close`
        except OSError as error:
            raise WorldError(f"{self._folder}: the twin cannot write here ({error.strerror}). Choose another --out.") from error
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "hts.worlds.twin.process"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log, text=True, encoding="utf-8", env=environment,
        )  # fmt: skip
        self._exchange(self._process, {
            "settings": self.settings.model_dump(mode="json"), "robot": context.robot,
            "robot_settings": json.loads(json.dumps(dict(context.robot_settings), default=str)),
            "objectives": {name: dict(values) for name, values in context.objectives.items()},
            "seed": context.seed, "name": self.name, "spool": str(self._folder / "spool"),
        })  # fmt: skip
        return self._process

    def _ask(self, request: Mapping[str, Any]) -> Any:
        try:
            return self._exchange(self._process or self._start(), request)
        except BaseException:
            self.close()  # an answer that nobody waits for must not meet the next request
            raise

    def _exchange(self, process: subprocess.Popen[str], request: Mapping[str, Any]) -> Any:
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
        except (BrokenPipeError, OSError):
            raise self._crashed(process) from None
        for line in process.stdout:
            answer = json.loads(line)
            if "done" in answer:
                return answer["done"]
            if "error" in answer:
                kind = getattr(errors, answer["kind"], WorldError)
                raise (kind if issubclass(kind, HtsError) else WorldError)(answer["error"])
            if self.on_progress is not None:
                self.on_progress(answer["progress"])
        raise self._crashed(process)

    def _crashed(self, process: subprocess.Popen[str]) -> WorldError:
        """One line about a process that ended by itself, with the end of what it said."""
        code, log = process.wait(), self._folder / "stderr.txt"
        lines = [line.strip() for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
        said = " | ".join(lines[-TAIL_LINES:]) or "nothing"
        how = f"by signal {-code}" if code < 0 else f"with exit code {code}"
        return WorldError(f"The twin's process ended {how}; it said: {said} (all of it in {log}). `hts resume` tries again.")

    def _fetch(self, name: str) -> Recording:
        return RecordingStore(self._folder / "spool").read(name)


def _path(policy: Path | None) -> str | None:
    return None if policy is None else str(Path(policy).resolve())


def _close_quietly(pipe: IO[str]) -> None:
    try:
        pipe.close()
    except BrokenPipeError:
        return  # what was still in the buffer has nobody to read it
