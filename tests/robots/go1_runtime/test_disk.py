"""A disk that fills up under the runtime: the robot sits, one line says why, and nothing that was recorded is lost."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

# 72 KiB: the pages of the first row's log (36) and of the small files beside it (20) fit. The second row takes 720, so
# that the disk is full long before the row is over, however late the writing thread comes.
SAMPLES = {"00": 50, "01": 1000}
SCRIPT = """
mkfifo "$OUT/keys"
exec 3<> "$OUT/keys"  # an input that does not end
cp -r "$BUNDLE" "$DISK/bundle"
used=$(du -sk "$DISK" | cut -f1)
mount -o remount,size=$((used + 72))k "$DISK"
runtime() {
  "$PYTHON" -W ignore -m hts_go1_stand_in --port 0 --lockstep --tick-ms 20 --quiet-seconds 300 \\
    --loss 0.01 --late 0.02 > "$OUT/$1.robot" &
  until grep -q ready "$OUT/$1.robot"; do sleep 0.1; done
  port=$(sed 's/.*127.0.0.1:\\([0-9]*\\),.*/\\1/' "$OUT/$1.robot")
  "$PYTHON" -m hts_go1_runtime run "$DISK/bundle" --link udp://127.0.0.1:$port --lockstep --yes --priority 0 \\
    --idle-seconds 1 --warmup 0 > "$OUT/$1.out" 2> "$OUT/$1.err" <&3
  echo $? > "$OUT/$1.code"
  kill %%
  wait
}
(
  until grep -q "waiting for the disk" "$OUT/first.out" 2> /dev/null; do sleep 0.1; done
  sleep 0.5
  cp -r "$DISK/bundle/logs" "$OUT/while-full"
  mount -o remount,size=100m "$DISK"
) &
freeing=$!
set -m
runtime first
wait $freeing
runtime second
cp -r "$DISK/bundle/logs" "$OUT/logs"
"""


@pytest.mark.slow
def test_a_disk_that_fills_up_under_a_visit_costs_no_row_that_was_walked(change, tmp_path):
    if shutil.which("unshare") is None:
        pytest.skip("this system does not let a test mount a small disk")

    def lengthen(manifest):
        manifest["rows"][1]["schedule"]["commands"][0]["seconds"] = 20.0

    bundle = change(lengthen)
    disk = tmp_path / "disk"
    disk.mkdir()
    path = os.pathsep.join(part for part in sys.path if part)
    variables = {"DISK": disk, "OUT": tmp_path, "BUNDLE": bundle, "PYTHON": sys.executable, "PYTHONPATH": path}
    mount = 'mount -t tmpfs -o size=100m tmpfs "$DISK" || exit 99\n'
    done = subprocess.run(
        ["unshare", "--mount", "--map-root-user", "bash", "-c", mount + SCRIPT],
        capture_output=True,
        text=True,
        timeout=1000,
        check=False,
        env={**os.environ, **{name: str(value) for name, value in variables.items()}},
    )
    if done.returncode == 99 or "Operation not permitted" in done.stderr:
        pytest.skip("this system does not let a test mount a small disk")

    def text(name: str) -> str:
        return (tmp_path / name).read_text()

    assert text("first.code").strip() == "2", done.stderr + text("first.out") + text("first.err")
    assert text("first.err").count("\n") == 1
    assert text("first.err").startswith(f"refused: {disk}/bundle/logs/.0")
    assert "No space left on device" in text("first.err")
    assert "The robot sits; free space, then run the same again." in text("first.err")
    assert "waiting for the disk: free space, what was recorded is in memory" in text("first.out")
    assert "sat down" in text("first.out")
    for left in (tmp_path / "while-full").glob(".*.partial"):
        assert left.read_text() == "" or left.read_text().endswith("\n")
    assert text("second.code").strip() == "0", text("second.err")
    recorded = [row for name in ("first", "second") for row in rows_of(text(f"{name}.out"))]
    assert sorted(recorded) == ["00", "01"]
    assert rows_of(text("first.out")), "a row that was walked before the disk was full was recorded again"
    for name in recorded:
        check_read(tmp_path / "logs", name)
    for line in text("logs/events.jsonl").splitlines():
        json.loads(line)


def rows_of(said: str) -> list[str]:
    """Rows that a visit says it has recorded."""
    return [line.split("log=")[1].split()[0] for line in said.splitlines() if line.startswith("recorded ")]


def check_read(logs: Path, name: str) -> None:
    """hts takes the log as it is."""
    from hts import plugins
    from hts.recordings.mapping import load_mapping
    from hts.recordings.reading import read_log

    registry = plugins.load()
    mapping = load_mapping(logs / "mappings" / f"{name}.yaml")
    recording = read_log(registry, [logs / f"{name}.csv"], mapping, registry.make_robot("go1"))
    assert recording.num_samples == SAMPLES[name]
