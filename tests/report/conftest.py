"""Helpers of the report's tests are found beside them, and what several of them need."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def words_only(monkeypatch):
    """Figures take most of the time; tests of the page's words do without."""
    monkeypatch.setattr("hts.report.page._figures", lambda run, objective: [])
