"""Is this a run folder?"""

from __future__ import annotations

from pathlib import Path

from hts.errors import ConfigError, RunError
from hts.places import CURVE, PRETRAINED_FILE


def existing_run(folder: Path) -> Path:
    """The folder itself. Raises RunError where there is no run in it."""
    if not folder.exists():
        raise RunError(f"{folder}: there is no such folder. Give the folder that `hts run` named at its end.")
    policy = folder / PRETRAINED_FILE
    if not (folder / "config.yaml").is_file() and policy.is_file() and (folder / CURVE).is_file():
        raise RunError(
            f"{folder}: holds a finished pretraining and no run, so there is nothing to go on with. Its policy is "
            f"{policy}: `hts play --policy {policy}` shows it; to start runs from it, let the robot's "
            "pretrained_policy() name it (some robots have a setting for that: `hts plugins NAME`)."
        )
    if not (folder / "config.yaml").is_file():
        raise RunError(f"{folder}: holds no run (no config.yaml). Give the folder that `hts run` named at its end.")
    return folder


def run_or_policy_file(folder: Path | None, policy: str | None) -> str:
    """The policy that was asked for: of a run, "best" by default, or without one a file that must be named.

    Raises RunError where there is no run in the folder, ConfigError where neither is given.
    """
    if folder is not None:
        existing_run(folder)
        return policy or "best"
    if policy is None:
        raise ConfigError(
            "Neither a run folder nor a policy file was given. Give one: DIR, or --policy FILE.safetensors."
        )
    return policy
