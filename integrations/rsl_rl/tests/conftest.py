"""The package is found where it lies; without rsl_rl what needs it is skipped and says so."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE)]

NEEDS = {"test_ppo": "rsl_rl", "test_known_optimum": "rsl_rl", "test_projection": "rsl_rl", "test_mjlab": "mjlab"}


def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.parent != HERE:
            continue
        needed = NEEDS.get(item.path.stem)
        if needed is not None and importlib.util.find_spec(needed) is None:
            item.add_marker(pytest.mark.skip(reason=f"{needed} is not installed here; `make test-rsl-rl` installs it"))
