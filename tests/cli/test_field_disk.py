"""A disk that fills up under a run with a robot: when its bundle is written, and when its logs are read."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCHEDULE = 'collection.schedule.commands=[{"seconds": 12, "vx": 0.6}]'
SCRIPT = f"""
small="--set collection.repeats=1 --set collection.exploring=1 --set sweep.kl_bounds=[1.0] --set finetune.num_envs=2"
small="$small --set measurement.epochs=1 --set simulation_test.num_envs=2 --set simulation_test.seconds=3"
small="$small --set gate.enabled=false"
say() {{ "$@" > "$OUT/$step.out" 2> "$OUT/$step.err"; echo $? > "$OUT/$step.code"; }}
room() {{ mount -o remount,size=$(($(du -sk "$DISK" | cut -f1) + $1))k "$DISK"; }}

head -c 3M /dev/zero > "$DISK/other"; room 1000
step=bundle say hts run --objective power --robot go1 --world field --preset smoke --out "$DISK/run" $small \\
  --set '{SCHEDULE}'
find "$DISK/run/world" -type f > "$OUT/left"
mount -o remount,size=100m "$DISK"
step=waiting say hts resume "$DISK/run"
cd "$DISK"/run/world/field/*/ && sha256sum -c --quiet SHA256SUMS > "$OUT/sums" 2>&1

"$PYTHON" -W ignore -m hts_go1_stand_in --port 0 --lockstep --tick-ms 20 --quiet-seconds 300 > "$OUT/robot" &
until grep -q ready "$OUT/robot"; do sleep 0.1; done
port=$(sed 's/.*127.0.0.1:\\([0-9]*\\),.*/\\1/' "$OUT/robot")
mkfifo "$OUT/keys"
exec 3<> "$OUT/keys"  # an input that does not end
link="--link udp://127.0.0.1:$port --lockstep"
step=visit say "$PYTHON" -m hts_go1_runtime run . $link --yes --idle-seconds 1 --mass 12 <&3
kill %1
sha256sum logs/*.csv > "$OUT/logs-before"

room 215  # a graph that is written anew fits, two recordings do not
step=import say hts resume "$DISK/run"
ls "$DISK/run" > "$OUT/listing"
mount -o remount,size=100m "$DISK"
step=after say hts resume "$DISK/run"
sha256sum logs/*.csv > "$OUT/logs-after"
step=validate say hts data validate "$DISK/run/data.zarr"
"""


@pytest.mark.slow
def test_a_full_disk_costs_a_run_with_a_robot_neither_bundle_nor_logs(on_a_disk, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHON", sys.executable)
    done: subprocess.CompletedProcess[str] = on_a_disk("100m", SCRIPT)

    def text(name: str) -> str:
        return (tmp_path / name).read_text()

    run = f"{tmp_path}/disk/run"
    for step in ("bundle", "import"):
        line = text(f"{step}.err")
        assert text(f"{step}.code").strip() == "2", done.stderr + line + text(f"{step}.out")
        assert line.count("\n") == 1 and line.startswith(f"error: {run}"), line
        assert "full" in line.lower() or "No space left on device" in line
        assert f"`hts resume {run}` then goes on" in line
    assert ".partial" not in text("left") and "SHA256SUMS" not in text("left")
    assert "data.zarr: writing a recording failed" in text("import.err")
    assert "collect.json" not in text("listing")
    assert text("waiting.code").strip() == "75", text("waiting.err")
    assert text("sums") == ""
    assert text("visit.code").strip() == "0", text("visit.err")
    assert text("after.code").strip() == "75", text("after.err")  # it waits for the next logs
    assert "(1 of 1): fit measurement models" in text("after.out")
    assert text("logs-before") == text("logs-after")
    assert "2 recordings, all whole" in text("validate.out")
