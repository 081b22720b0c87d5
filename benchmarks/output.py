"""How a benchmark answers: JSON on standard output, and in a file if one is named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def give(result: dict[str, Any], out: Path | None = None) -> None:
    """Print result, and write it to out."""
    text = json.dumps(result, indent=1)
    if out:
        out.write_text(text + "\n")
    print(text)
