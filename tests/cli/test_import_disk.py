"""A disk that fills up while logs are imported: one line, nothing half-written, and nothing lost once there is room."""

from __future__ import annotations

import numpy as np
import yaml

JOINTS = [f"{leg}_{part}_joint" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf")]
SCRIPT = """
into="--robot go1 --mapping $OUT/m.yaml --to $DISK/data.zarr"
import_all() { hts import "$OUT"/a.csv "$OUT"/b.csv "$OUT"/c.csv $into "$@"; }
hts import "$OUT/a.csv" $into > "$OUT/zeroth.out" 2>&1
find "$DISK/data.zarr" -type f -exec sha256sum {} + | sort > "$OUT/before"
used=$(du -sk "$DISK" | cut -f1)
mount -o remount,size=$((used + 200))k "$DISK"
import_all > "$OUT/first.out" 2> "$OUT/first.err"; echo $? > "$OUT/first.code"
find "$DISK/data.zarr" -type f -exec sha256sum {} + | sort > "$OUT/after"
import_all --dry-run --figure "$DISK/p.png" > "$OUT/figure.out" 2> "$OUT/figure.err"; echo $? > "$OUT/figure.code"
mount -o remount,size=100m "$DISK"
import_all > "$OUT/second.out" 2> "$OUT/second.err"; echo $? > "$OUT/second.code"
hts data validate "$DISK/data.zarr" > "$OUT/validate.out" 2>&1
ls -A "$DISK/data.zarr" > "$OUT/listing"
"""


def logs(folder):
    """Three logs of 40 s, 192 kB each once they are stored."""
    for number, name in enumerate("abc"):
        steps = np.arange(2000)
        torque = np.sin(steps[:, None] / 9 + number + np.arange(12))
        rows = np.column_stack([20 * steps, torque, 3 + torque[:, 0] ** 2])
        header = ",".join(["t", *JOINTS, "amps"])
        np.savetxt(folder / f"{name}.csv", rows, fmt="%.5f", delimiter=",", header=header, comments="")
    mapping = {
        "time": {"column": "t", "unit": "ms"},
        "rate_hz": 50,
        "joints": {joint: joint for joint in JOINTS},
        "channels": {
            "joint_torque": {"columns": "{joint}", "unit": "N*m"},
            "supply": {"columns": "amps", "unit": "A", "idle": 1.9},
        },
    }
    (folder / "m.yaml").write_text(yaml.safe_dump(mapping))


def test_a_full_disk_stops_an_import_with_one_line_and_loses_nothing(on_a_disk, tmp_path):
    logs(tmp_path)
    done = on_a_disk("100m", SCRIPT, modules="hts.recordings.store,hts.recordings.drawing")

    def text(name):
        return (tmp_path / name).read_text()

    line = text("first.err")
    assert text("first.code").strip() == "2", done.stderr + line + text("zeroth.out")
    assert line.count("\n") == 1 and line.startswith(f"error: {tmp_path}/disk/data.zarr: writing a recording failed"), (
        line
    )
    assert "The disk is full: free some space. Nothing is half-written; give the command again afterwards." in line
    before, after = set(text("before").splitlines()), set(text("after").splitlines())
    assert before and before <= after
    assert text("figure.code").strip() == "2" and text("figure.err").count("\n") == 1
    assert "p.png: the picture cannot be written" in text("figure.err")
    assert text("second.code").strip() == "0", text("second.err")
    assert "(was there already)" in text("second.out")
    assert "3 recordings, all whole" in text("validate.out")
    assert len(text("listing").split()) == 4  # and no leftover
