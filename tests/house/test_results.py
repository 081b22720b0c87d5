"""Numbers of README and results come from committed lines: blocks are up to date, and nothing else claims anything."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
OLDER = REPOSITORY / "docs/results/older-numbers.json"
MOST_OLDER = {
    "README.md": 2,
    "docs/results.md": 0,
    "docs/results-version-before.md": 0,
    "docs/results-development.md": 0,
    "docs/results-earlier.md": 0,
}
"""Numbers in watched places that are no results: "95 % interval", "within 10 %". Only ever lower these."""


def test_every_number_of_the_pages_comes_from_the_lines():
    done = subprocess.run(
        [sys.executable, str(REPOSITORY / "benchmarks/realities.py"), "write-docs", "--check"],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_older_numbers_only_get_fewer():
    older = json.loads(OLDER.read_text(encoding="utf-8"))
    assert set(older) == set(MOST_OLDER)
    for page, found in older.items():
        assert sum(found.values()) <= MOST_OLDER[page], page
