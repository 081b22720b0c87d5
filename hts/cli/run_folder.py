"""Is this a run folder?"""

from __future__ import annotations

from pathlib import Path

from hts.errors import RunError


def existing_run(folder: Path) -> Path:
    """The folder itself. Raises RunError where there is no run in it."""
    if not folder.exists():
        raise RunError(f"{folder}: there is no such folder. Give the folder that `hts run` named at its end.")
    if not (folder / "config.yaml").is_file():
        raise RunError(f"{folder}: holds no run (no config.yaml). Give the folder that `hts run` named at its end.")
    return folder
