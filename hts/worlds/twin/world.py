"""The side of the twin that a run talks to. The twin itself runs in other processes, so nothing can look into it."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from hts.config import ScheduleConfig
from hts.contracts import HoldSpeed, Settings, World, WorldContext
from hts.cores import available
from hts.errors import WorldError
from hts.layers import plain
from hts.recordings.recording import Recording
from hts.recordings.store import RecordingStore
from hts.worlds.base import file_hash, in_groups, request_id, round_order, shared_out
from hts.worlds.twin.child import Child
from hts.worlds.twin.parameters import TwinSettings
from hts.worlds.twin.programme import Kept, Session, collection, head_to_head, session_seconds

STEPS_PER_SECOND = 35_000.0  # physics steps of a twin on one core, for the estimate of `cost`


def make_twin(settings: Settings, context: WorldContext) -> TwinWorld:
    """The world `twin`. Its processes start with the first request."""
    return TwinWorld(TwinSettings.model_validate(dict(settings)), context)


class TwinWorld(World):
    """Simulated reality. A request that is repeated word for word gives the same recordings.

    So several recordings of one policy are asked for in one call: `collect([policy] * 3, schedule)`.
    """

    name = "twin"
    simulated = True

    def __init__(self, settings: TwinSettings, context: WorldContext) -> None:
        self.settings, self._context = settings, context
        self._folder = Path(context.folder) / "twin"
        self._children: list[Child] = []
        self._report: Callable[[float], None] = lambda share: None
        self._hold: HoldSpeed | None = None
        self._found: dict[tuple[str, float], tuple[tuple[float, bool]]] = {}  # file and speed -> command, saturated

    def idle(self) -> Mapping[str, float]:
        return self._guarded(lambda: self._staff(1)[0].ask({"do": "idle"}))

    def check(self) -> None:
        """A twin of this robot can be compiled and its instruments measure the objectives;
        1 to 2 s in its own process."""
        self._guarded(lambda: self._staff(1)[0].ask({"do": "check"}))

    def collect(self, policies: Sequence[Path | None], schedule: ScheduleConfig) -> list[Recording]:
        """As `World.collect`; a policy None stands in the default pose by the robot's own stand mode."""
        paths = [None if policy is None else _path(policy) for policy in policies]
        request = self._request("collect", paths, schedule.model_dump(mode="json"))
        return [row[0] for row in self._run(collection(paths, schedule, request), request)]

    def head_to_head(self, policy: Path, reference: Path, speeds: Sequence[float]) -> list[Recording]:
        return self._heads("head to head", [policy], reference, speeds)[0]

    def head_to_heads(
        self, policies: Sequence[Path], reference: Path, speeds: Sequence[float]
    ) -> list[list[Recording]]:
        """All policies at all speeds side by side, each pair on a twin of its own, other ones than `head_to_head` has:
        a final repeats no trial."""
        return self._heads("head to heads", policies, reference, speeds)

    def _heads(
        self, what: str, policies: Sequence[Path], reference: Path, speeds: Sequence[float]
    ) -> list[list[Recording]]:
        """what: part of the request's name, so that two of different names have different sessions."""
        paths, against, settings = [_path(policy) for policy in policies], _path(reference), self.settings
        lengths = (settings.warmup_seconds, settings.block_seconds)
        request = self._request(what, [*paths, against], [list(speeds), *lengths, *self._holding()])
        sessions = [
            head_to_head(
                [path],
                against,
                [float(speed)],
                *lengths,
                request_id(request, number, float(speed)),
                hold=self._hold,
            )
            for number, path in enumerate(paths)
            for speed in speeds
        ]
        rows = self._run(sessions, request)
        width = len(speeds)
        return [[r for row in rows[i * width : (i + 1) * width] for r in row] for i in range(len(paths))]

    def head_to_head_sessions(
        self, policy: Path, reference: Path, speeds: Sequence[float], sessions: int
    ) -> list[Recording]:
        """Each session on a twin of its own: another charge, air and floor, commands found anew."""
        rows = self._heads("head to head", [policy] * sessions, reference, speeds)
        return [recording for row in rows for recording in row]

    def head_to_heads_in_session(
        self, policies: Sequence[Path], reference: Path, speeds: Sequence[float], block_seconds: float | None
    ) -> list[list[Recording]]:
        """Each policy on a twin of its own, all of them side by side."""
        paths, against, asked = [_path(policy) for policy in policies], _path(reference), [float(v) for v in speeds]
        lengths = (self.settings.warmup_seconds, self._block(block_seconds))
        request = self._request("session", [*paths, against], [asked, *lengths, *self._holding()])
        sessions = [
            head_to_head([path], against, asked, *lengths, request_id(request, number), hold=self._hold)
            for number, path in enumerate(paths)
        ]
        return self._run(sessions, request)

    def head_to_head_round(
        self,
        policies: Sequence[Path],
        reference: Path,
        speed: float | Sequence[float],
        number: int,
        block_seconds: float,
    ) -> list[list[Recording]]:
        """One session on a fresh twin at the stated charge, warmed up; the policies share the reference's blocks.

        Held commands are found in round 0 and kept for the rounds after it; a later round trims whom it does not know.
        They are part of a round's request, and only round 0 leaves any, so that asking again gives the same recordings.
        """
        paths, against = [_path(policy) for policy in policies], _path(reference)
        several = isinstance(speed, Sequence)
        speeds = [float(one) for one in speed] if isinstance(speed, Sequence) else [float(speed)]
        kept = self._kept_for([*paths, against], speeds) if number > 0 else []
        lengths = (self.settings.warmup_seconds, float(block_seconds))
        rest = [speeds if several else speeds[0], number, *lengths, *self._holding(kept)]
        request = self._request("round", [*paths, against], rest)
        name = request_id(request, 0)
        session = head_to_head(
            paths, against, speeds, *lengths, name, number, hold=self._hold, kept=[one for _, one in kept]
        )
        (recordings,) = self._run([session], request)
        order = round_order(len(paths), number)
        if number == 0:
            walkers = [against if who is None else paths[who] for who in order]
            self._keep_commands(recordings, walkers * len(speeds))
        return shared_out(recordings, order, len(paths))

    def hold_speed(self, hold: HoldSpeed | None) -> bool:
        self._hold, self._found = hold, {}
        return hold is not None

    def identity(self) -> Mapping[str, str]:
        """Name and hash of the reality; nothing for the twin of the settings, which the configuration holds."""
        reality, sha256 = self.settings.reality, self.settings.reality_sha256
        return {"reality": reality, "reality_sha256": sha256} if reality and sha256 else {}

    def on_progress(self, report: Callable[[float], None]) -> None:
        self._report = report

    def head_to_head_seconds(self) -> float:
        return self.head_to_head_session_seconds(1, None)

    def head_to_head_session_seconds(self, speeds: int, block_seconds: float | None) -> float:
        return session_seconds(1, speeds, self.settings.warmup_seconds, self._block(block_seconds), self._hold)

    def cost(self, robot_seconds: float) -> Mapping[str, float]:
        steps = robot_seconds / self.settings.dynamics.physics_dt
        return {"robot_minutes": robot_seconds / 60.0, "wall_seconds": steps / (STEPS_PER_SECOND * self._processes())}

    def close(self) -> None:
        """End the processes and remove the spool."""
        children, self._children = self._children, []
        for child in children:
            child.close()
        if children:
            shutil.rmtree(self._folder / "spool", ignore_errors=True)
            if self._folder.is_dir() and not any(self._folder.iterdir()):
                self._folder.rmdir()  # what remains otherwise is what a process said before it ended

    # ------------------------------------------------------------------------------------------ inside

    def _block(self, seconds: float | None) -> float:
        return self.settings.block_seconds if seconds is None else float(seconds)

    def _holding(self, kept: Sequence[tuple[str, Kept]] = ()) -> list[Any]:
        """What a request's name says about holding the speed; nothing where it is not held."""
        if self._hold is None:
            return []
        return [self._hold.named(), *([policy, one.asked, one.command] for policy, one in kept)]

    def _kept_for(self, paths: Sequence[str], speeds: Sequence[float]) -> list[tuple[str, Kept]]:
        """Commands found in round 0, each with the hash of its policy's file."""
        asked = [(path, file_hash(path), speed) for path in dict.fromkeys(paths) for speed in speeds]
        return [
            (name, Kept(policy=path, asked=speed, command=command, saturated=saturated))
            for path, name, speed in asked
            for command, saturated in self._found.get((name, speed), ())
        ]

    def _keep_commands(self, recordings: Sequence[Recording], paths: Sequence[str]) -> None:
        """Forget what was kept, and keep what these recordings say, each of the policy in `paths`."""
        self._found = {
            (file_hash(path), recording.schedule.commands[0].vx): (
                (float(recording.notes["held_command"]), recording.notes["held_saturated"] == "true"),
            )
            for recording, path in zip(recordings, paths, strict=True)
            if "held_command" in recording.notes
        }

    def _request(self, what: str, policies: Sequence[str | None], rest: Any) -> str:
        """A request's name, from its content; sessions on two realities are drawn apart, also from one seed."""
        machine = [self.settings.reality_sha256] if self.settings.reality_sha256 else []
        return request_id(what, self._context.seed, [path and file_hash(path) for path in policies], rest, *machine)

    def _processes(self) -> int:
        return self.settings.processes or available()

    def _staff(self, number: int) -> list[Child]:
        """At least so many processes, started as needed."""
        if not self._children:
            shutil.rmtree(self._folder / "spool", ignore_errors=True)  # left by a run that was killed
        context = self._context
        start = {
            "settings": self.settings.model_dump(mode="json"),
            "robot": context.robot,
            "robot_settings": plain(context.robot_settings),
            "objectives": plain(context.objectives),
            "seed": context.seed,
            "name": self.name,
            "spool": str(self._folder / "spool"),
        }
        while len(self._children) < number:
            self._children.append(Child(self._folder / f"stderr-{len(self._children)}.txt", start))
        return self._children

    def _run(self, sessions: Sequence[Session], request: str) -> list[list[Recording]]:
        """Recordings of each session; groups of sessions run in several processes side by side."""
        groups = in_groups(len(sessions), self.settings.max_worlds)
        if not groups:
            return []
        return self._guarded(lambda: self._share_out([[sessions[i] for i in group] for group in groups], request))

    def _share_out(self, groups: Sequence[Sequence[Session]], request: str) -> list[list[Recording]]:
        children = list(self._staff(min(len(groups), self._processes())))
        done, lock = [0.0] * len(groups), threading.Lock()

        def ask(number: int) -> list[list[str]]:
            def progress(share: float) -> None:
                with lock:
                    done[number] = share
                    self._report(sum(done) / len(done))

            with lock:
                child = children.pop()
            content = [session.model_dump(mode="json") for session in groups[number]]
            ids = child.ask({"do": "run", "sessions": content, "request": request, "group": number}, progress)
            progress(1.0)
            with lock:
                children.append(child)
            return ids

        with ThreadPoolExecutor(len(children)) as pool:
            futures = [pool.submit(ask, number) for number in range(len(groups))]
            try:
                for future in as_completed(futures):
                    future.result()
            except BaseException:
                for future in futures:
                    future.cancel()
                self.close()  # ends the other processes, or leaving the pool would wait for them
                raise
        spool = RecordingStore(self._folder / "spool")
        return [[spool.read(name) for name in row] for future in futures for row in future.result()]

    def _guarded(self, work: Callable[[], Any]) -> Any:
        """Do it; if it fails, end the processes: an answer that nobody waits for must not meet the next request."""
        try:
            return work()
        except BaseException:
            self.close()
            raise


def _path(policy: Path) -> str:
    path = Path(policy).resolve()
    if not path.is_file():
        raise WorldError(
            f"{path}: no such policy. Export one: `hts export DIR --policy best --format onnx --to {path.name}`."
        )
    return str(path)
