"""Kill a run at random moments, resume it, and see that nothing shows. A script, not a test:

    python tests/run/kill_and_resume.py --kills 20 --seed 0
    python tests/run/kill_and_resume.py --kills 3 -- --objective power --robot go1 --preset smoke --seed 7

One run goes undisturbed. Then, so many times: the same run is started, its whole process group gets SIGKILL at a random
moment, and `hts resume` goes on (or `hts run` again, if the moment was before there was anything to resume). Checked:
`summary.json` (but for wall_seconds) and the history of fine-tuning equal the undisturbed ones, stages that were
finished when the kill came were not written again, every recording is whole, and there are as many as there should be.
In the killed runs a checkpoint is written after each batch of fine-tuning, so that there are some to go on from.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SMOKE = ("--objective", "power", "--robot", "go1", "--preset", "smoke")
EAGER = (
    "import hts.training.finetune as f; f.CHECKPOINT_SECONDS = 0.0; "
    "from hts.cli.main import main; raise SystemExit(main())"
)


@dataclass
class Trial:
    """What one kill and resume came to. wrong: what differs from the undisturbed run, empty if nothing."""

    after: float
    finished: list[str]
    checkpoint: bool
    wrong: list[str] = field(default_factory=list)


def start(*arguments: str | Path, log: Path) -> subprocess.Popen[bytes]:
    """`hts` in a process group of its own, with a checkpoint after each batch."""
    environment = {"OMP_NUM_THREADS": "1", **os.environ}
    with log.open("ab") as file:
        return subprocess.Popen(
            [sys.executable, "-c", EAGER, *map(str, arguments)],
            stdout=file,
            stderr=file,
            env=environment,
            start_new_session=True,
        )


def finish(*arguments: str | Path, log: Path) -> None:
    """`hts` to its end. Raises RuntimeError if that is not a good one."""
    if start(*arguments, log=log).wait() != 0:
        raise RuntimeError(f"hts {' '.join(map(str, arguments))} failed: {log.read_text()[-500:]}")


def kill(process: subprocess.Popen[bytes]) -> None:
    """SIGKILL to the process and all that it started."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        pass  # it ended by itself just now
    process.wait()


def stage_files(folder: Path) -> dict[str, tuple[int, int]]:
    """Results of finished stages: name -> inode and time of writing."""
    found = [*folder.glob("*.json"), *folder.glob("iterations/*/*.json"), *folder.glob("config.yaml")]
    return {str(path.relative_to(folder)): (path.stat().st_ino, path.stat().st_mtime_ns) for path in sorted(found)}


def outcome(folder: Path) -> dict[str, Any]:
    """Everything of a finished run that a kill must not change."""
    from hts.recordings.store import RecordingStore

    summary = json.loads((folder / "summary.json").read_text())
    del summary["wall_seconds"]
    tuned = {
        str(path.relative_to(folder)): json.loads(path.read_text())
        for path in sorted(folder.glob("iterations/*/finetune.json"))
    }
    return {"summary.json": summary, **tuned, "recordings": list(RecordingStore(folder / "data.zarr").ids())}


def damages(folder: Path) -> list[str]:
    """What is wrong with the recordings that can be seen in the run's store."""
    from hts.recordings.store import RecordingStore

    if not (folder / "data.zarr" / "zarr.json").exists():
        return []
    return [damage.message for damage in RecordingStore(folder / "data.zarr").validate()]


def kill_and_resume(
    first: Sequence[str | Path],
    folder: Path,
    expected: dict[str, Any],
    moment: Callable[[], bool],
    log: Path,
    resume: Callable[[Path], object] | None = None,
) -> Trial:
    """Start `hts *first` on `folder`, kill it when `moment()` is true, resume (where `resume` is given, by that instead
    of by the command), compare with `expected`."""
    began = time.monotonic()
    process = start(*first, log=log)
    while process.poll() is None and not moment():
        time.sleep(0.01)
    kill(process)
    before = stage_files(folder) if folder.exists() else {}
    names = [name for name in before if name not in ("config.yaml", "provenance.json", "segments.json")]
    trial = Trial(time.monotonic() - began, names, bool(list(folder.glob("iterations/*/checkpoint-*"))))
    trial.wrong += damages(folder)
    begun = (folder / "config.yaml").exists()
    try:
        if resume is not None:
            resume(folder)
        else:
            finish(*(["resume", folder] if begun else first), log=log)
    except RuntimeError as error:
        trial.wrong.append(str(error))
        return trial
    after = stage_files(folder)
    # segments.json is written by the final stage beside its result, so it may come twice
    again = [name for name, was in before.items() if name != "segments.json" and after.get(name) != was]
    trial.wrong += [f"{name} was written again" for name in again]
    found = outcome(folder)
    trial.wrong += [f"{name} differs" for name in expected if found.get(name) != expected[name]]
    trial.wrong += damages(folder)
    return trial


def main() -> int:
    """The number of trials that went wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--out", type=Path, help="keep the folders here; default: a temporary one, removed at the end")
    parser.add_argument("arguments", nargs="*", default=list(SMOKE), help="of `hts run`; default: a smoke run")
    given = parser.parse_args()
    moments = random.Random(given.seed)
    with tempfile.TemporaryDirectory(prefix="hts-kill-") as temporary:
        place = given.out or Path(temporary)
        place.mkdir(parents=True, exist_ok=True)
        command = ["run", *(given.arguments or SMOKE), "--out"]
        began = time.monotonic()
        finish(*command, place / "undisturbed", log=place / "undisturbed.log")
        length = time.monotonic() - began
        expected = outcome(place / "undisturbed")
        print(f"undisturbed: {length:.0f} s, {len(expected['recordings'])} recordings", flush=True)
        print(f"{'kill':>4} {'after':>7} {'checkpoint':>10}  {'stages finished':<60} result", flush=True)
        failures = 0
        for number in range(given.kills):
            folder, at = place / f"killed-{number:02d}", time.monotonic() + moments.uniform(0.0, length)
            trial = kill_and_resume(
                [*command, folder],
                folder,
                expected,
                lambda at=at: time.monotonic() >= at,
                place / f"killed-{number:02d}.log",
            )
            failures += bool(trial.wrong)
            stages = " ".join(Path(name).stem for name in trial.finished) or "none"
            result = "; ".join(trial.wrong) or "same"
            shown = "yes" if trial.checkpoint else "no"
            print(f"{number:>4} {trial.after:>5.1f} s {shown:>10}  {stages:<60} {result}", flush=True)
        print(f"{given.kills - failures} of {given.kills} the same as undisturbed", flush=True)
    return failures


if __name__ == "__main__":
    sys.exit(min(main(), 1))
