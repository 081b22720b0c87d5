"""Parts of benchmarks are found as when their script is run, and helpers of these tests beside them."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path[:0] = [str(Path(__file__).parents[2] / "benchmarks"), str(Path(__file__).parent)]


@pytest.fixture
def lines(tmp_path):
    """A folder with a file of three lines: three realities, savings of 10, 20 and 30 %."""
    from batch.lines import append
    from fake_lines import line

    for row in (line(reality=f"dev-{n:02d}", saved=(0.1 * n,) * 3) for n in (1, 2, 3)):
        append(tmp_path / "a.jsonl", row)
    return tmp_path
