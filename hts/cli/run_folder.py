"""Of a run, or without one: which policy a command is about."""

from __future__ import annotations

from pathlib import Path

from hts.errors import ConfigError
from hts.places import existing_run


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
