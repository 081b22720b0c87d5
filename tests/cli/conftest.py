"""A small disk that a test may fill."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

RUN = "hts.run.algorithm,hts.run.ready,hts.report"  # torch and the like


def can_mount() -> bool:
    done = subprocess.run(
        ["unshare", "--mount", "--map-root-user", "sh", "-c", "mount -t tmpfs tmpfs /mnt"],
        capture_output=True,
        check=False,
    )
    return done.returncode == 0


HTS = """
hts() { printf '%s\\0' "$BASHPID" "$PWD" "$@" > "$HTS_ASKED"; read -r status < "$HTS_ANSWERED"; return "$status"; }
trap ': > "$HTS_ASKED"' EXIT
"""


@pytest.fixture
def on_a_disk(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """on_a_disk(size, script, modules): run a script that has $DISK, a small disk, and `hts`, which is quick to start
    where it needs these modules. Skips where not allowed."""
    if shutil.which("unshare") is None or not can_mount():
        pytest.skip("this system does not let a test mount a small disk")
    disk = tmp_path / "disk"
    disk.mkdir()

    def run(size: str, script: str, modules: str = RUN) -> subprocess.CompletedProcess[str]:
        begin = f'set -u\nmount -t tmpfs -o size={size} tmpfs "$DISK"\n{HTS}'
        server = (sys.executable, "-W", "ignore", str(Path(__file__).with_name("preloaded.py")), modules)
        return subprocess.run(
            ["unshare", "--mount", "--map-root-user", *server, "bash", "-c", begin + script],
            capture_output=True,
            text=True,
            timeout=1000,
            check=False,
            env={**os.environ, "DISK": str(disk), "OUT": str(tmp_path)},
        )

    return run
