"""Import every kind of malformed log, many times over, and print the count by kind.

    python tests/recordings/fuzz.py [--count 6] [--seed 0]

Each case goes through `hts import` into a store that holds a recording already. A bad one must end with one clear line,
an exit code that is not 0 and the store as it was, byte for byte; a good one must be stored as it is. None may run code
or take memory without bound.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import resource
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any
from unittest import mock

import malformed as table
import numpy as np
import yaml

MOST_MEGABYTES = 500
"""By which all cases together may raise the highest use of memory."""
FORBIDDEN = ("pickle.find_class", "os.system", "os.exec", "os.posix_spawn", "subprocess.Popen", "socket.connect")
_ran: list[str] = []
_watching = False


class Registry:
    """One robot, and the readers that come with hts."""

    def make_robot(self, name: str) -> Any:
        return table.ROBOT()

    def make_log_reader(self, name: str, settings: Any = None) -> Any:
        from hts import builtin
        from hts.errors import ConfigError, unknown_name

        known = ("csv", "parquet", "npz", "ros", "lerobot")
        if name not in known:
            raise ConfigError(unknown_name("log reader", name, known))
        return getattr(builtin, f"make_{name}")({})


def watch() -> None:
    """From now on whatever runs code of a file, or a process, is remembered. A hook cannot be taken off again."""

    def hook(event: str, arguments: Any) -> None:
        if _watching and event in FORBIDDEN:
            _ran.append(f"{event} {arguments!r:.80}")

    sys.addaudithook(hook)


def state_of(folder: Path) -> dict[str, str]:
    """Every file below a folder, with its hash."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def run(made: Any, store: Path) -> tuple[int, str, str]:
    """`hts import` of a case: exit code, what it printed, what it printed as errors."""
    global _watching  # noqa: PLW0603
    from hts.cli.main import main

    mapping = made.folder / "mapping.yaml"
    text = yaml.safe_dump(made.given) if made.text is None else made.text
    mapping.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "surrogateescape"))
    arguments = ["import", *map(str, made.files), "--robot", "logger", "--mapping", str(mapping), "--to", str(store)]
    out, err = io.StringIO(), io.StringIO()
    _watching = True
    try:
        with mock.patch("hts.plugins.load", Registry), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main(arguments)
    finally:
        _watching = False
    return code, out.getvalue(), err.getvalue()


def faults(made: Any, expected: str, store: Path) -> list[str]:
    """What is wrong with how a case ended; nothing if all is well. expected: "bad", "good" or "either"."""
    from hts.recordings import RecordingStore

    before = state_of(store)
    code, out, err = run(made, store)
    after = state_of(store)
    found = [f"ran code: {what}" for what in _ran]
    _ran.clear()
    if (made.folder / "ran").exists():
        found.append("ran what a file holds")
    if any(character in out + err for character in "\x1b\x07\0"):
        found.append("control characters reached the terminal")
    if code == 0 and expected == "bad":
        found.append(f"was stored: {out.strip():.200}")
    elif code == 0:
        new = set(RecordingStore(store).ids()) - {path.split("/")[0] for path in before}
        if {path: after[path] for path in before} != before or len(new) > 1:
            found.append("changed what was there")
        if RecordingStore(store).validate():
            found.append("the store is damaged")
        if expected == "good" and new:
            found += differs(made, RecordingStore(store).read(new.pop()))
    else:
        lines = err.splitlines()
        if expected == "good":
            found.append(f"was refused: {err.strip():.300}")
        if len(lines) != 1 or not lines[0].startswith("error: ") or len(lines[0]) < 30:
            found.append(f"not one clear line: {err:.300}")
        if "Traceback" in err or len(err) > 2500:
            found.append(f"no clear line: {err:.300}")
        if after != before:
            found.append("the store is not as it was")
    return found


def differs(made: Any, recording: Any) -> list[str]:
    """Whether what was stored is what was made: the gauge at every stamp that was kept."""
    if made.given.get("reader") == "lerobot":
        return []
    names = [name.strip('"') for name in made.names]
    at, amps = names.index("t"), names.index("amps")
    rows = [(float(row[at]), float(row[amps])) for row in made.rows if row[amps] not in ("", "nan", "NULL")]
    stamps, shown = np.array(rows).T
    wanted = np.interp(stamps[0] / 1000 + recording.time, stamps / 1000, shown)
    return [] if np.allclose(recording.values("draw"), wanted, atol=2e-3) else ["other values were stored"]


def main(arguments: list[str] | None = None) -> int:
    """Print the count by kind, then the sum; 1 if any case went wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=6, help="cases of each kind")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args(arguments)
    watch()
    counts: Counter[str] = Counter()
    wrong: list[str] = []
    kinds = [(e, n) for e, group in (("bad", table.BAD), ("either", table.EITHER), ("good", table.GOOD)) for n in group]
    with tempfile.TemporaryDirectory() as place:
        store = Path(place) / "store.zarr"
        first = table.case(Path(place), 10**6)
        table.GOOD["as_it_is"](first)
        run(first, store)
        highest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        for number, (expected, name) in enumerate(kinds):
            for turn in range(chosen.count):
                folder = Path(place) / f"{name}{turn}"
                folder.mkdir()
                made = table.case(folder, chosen.seed + 1000 * number + turn)
                {"bad": table.BAD, "either": table.EITHER, "good": table.GOOD}[expected][name](made)
                wrong += [f"{name} {turn}: {fault}" for fault in faults(made, expected, store)]
                counts[f"{expected:6}  {name}"] += 1
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - highest) / 1024
    for kind, count in counts.items():
        print(f"{count:4}  {kind}")
    bad = sum(count for kind, count in counts.items() if not kind.startswith("good"))
    print(
        f"{bad} malformed inputs of {len(table.BAD) + len(table.EITHER)} kinds, {counts.total() - bad} unusual valid "
        "ones of"
    )
    print(f"{len(table.GOOD)} kinds; {len(wrong)} went wrong; the highest use of memory grew by {grown:.0f} MB")
    if grown > MOST_MEGABYTES:
        wrong.append(f"memory grew by {grown:.0f} MB, at most {MOST_MEGABYTES} are allowed")
    for line in wrong:
        print(line)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
