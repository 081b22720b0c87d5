"""Names that people type, in options, keys and folders."""

from __future__ import annotations

import re

from hts.plugins import Entry, Registry
from hts.testing.checks.ensure import ensure


def name_can_be_typed(entry: Entry, registry: Registry) -> None:
    """Its name is made of letters, digits, _ and -, a letter first: it stands in --set keys and folder names."""
    ensure(re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", entry.name) is not None, f"is named '{entry.name}'")
