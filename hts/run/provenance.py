"""Where a result came from: versions, commit, diff, seeds, hardware."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = (
    "hard-to-sim", "hard-to-sim-power", "hard-to-sim-noise", "hard-to-sim-go1", "torch", "torchrl", "tensordict", "mujoco", "mujoco-warp",
    "warp-lang", "dm_control", "numpy", "scipy", "zarr", "onnx", "onnxruntime", "pydantic",
)  # fmt: skip


def collect(seed: int, engine: str, plugins: dict[str, str]) -> dict[str, Any]:
    """JSON values; plugins: entry point -> distribution and version. A package that is not installed is left out."""
    return {
        "python": sys.version.split()[0],
        "packages": {name: version for name in PACKAGES if (version := _version(name))},
        "plugins": plugins,
        "commit": _git("rev-parse", "HEAD"),
        "diff": _git("diff", "HEAD"),
        "seed": seed,
        "engine": engine,
        "hardware": {"machine": platform.machine(), "system": platform.platform(), "cores": os.cpu_count(), "accelerator": _accelerator()},
    }


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _git(*arguments: str) -> str | None:
    """Output of git in the source tree; None for an installed package or without git."""
    try:
        done = subprocess.run(
            ["git", *arguments], cwd=Path(__file__).parent, capture_output=True, text=True, timeout=20, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _accelerator() -> str | None:
    import torch

    return torch.cuda.get_device_name() if torch.cuda.is_available() else None
