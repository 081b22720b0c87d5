"""Where a result came from: versions, commit, whether the sources were changed, seeds, hardware."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path
from shlex import quote
from typing import Any

from hts.config import RunConfig
from hts.errors import RunError
from hts.plugins import Registry
from hts.run.stage_files import read_stage
from hts.whole_paths import files_of
from hts.yaml_text import load_mapping_file

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")  # at the beginning of a requirement (PEP 508)


def collect(seed: int, engine: str, plugins: dict[str, str], diff: bool = False) -> dict[str, Any]:
    """JSON values; plugins: entry point -> the distribution that registered it.

    diff: keep what `git diff HEAD` says of the sources too. Without it only its SHA-256 is kept, so that two results
    can be shown to come from the same sources, and nobody's unpublished work lies in a folder that is passed on.
    """
    changes = _git("diff", "HEAD")
    return {
        "python": sys.version.split()[0],
        "packages": packages(plugins.values()),
        "plugins": plugins,
        "commit": _git("rev-parse", "HEAD"),
        "diff_sha256": hashlib.sha256(changes.encode()).hexdigest() if changes else None,  # null: as committed
        **({"diff": changes} if diff else {}),
        "seed": seed,
        "engine": engine,
        "hardware": {
            "machine": platform.machine(),
            "system": platform.platform(),
            "cores": os.cpu_count(),
            "accelerator": _accelerator(),
        },
    }


def config_sha256(folder: Path, config: RunConfig, registry: Registry) -> str:
    """Of the settings in config.yaml of a run's folder, without where files lie: a folder may move, with or without
    them. config: the same, read."""
    settings = load_mapping_file(folder / "config.yaml")
    for section, kind, one in (("robot", "robots", config.robot), ("world", "worlds", config.world)):
        for key in files_of(registry, kind, one):
            settings[section][key] = "a file"
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


TO_EVALUATE = (
    "Put it back as the run wrote it; what an evaluation is to have otherwise is said with it, `hts evaluate DIR --set "
    "evaluation.KEY=VALUE` or `--set world.KEY=VALUE`."
)
"""What to do, for an evaluation."""

TO_REPORT = "The page shows these settings beside results of those; put the file back as the run wrote it."
"""What it means, for a report."""


def check_config(folder: Path, config: RunConfig, registry: Registry, advice: str | None = None) -> None:
    """Raise RunError if config.yaml says other settings than the run was begun with: half of its stages would be
    another run's. A run of before that was kept passes. advice: what to do, by default for who goes on with a run."""
    path = folder / "provenance.json"
    begun_with = read_stage(path).get("config_sha256") if path.exists() else None
    found = config_sha256(folder, config, registry)
    if begun_with is not None and found != begun_with:
        file, command = folder / "config.yaml", "oracle" if config.reward_source == "oracle" else "run"
        anew = (
            f"Begin a new run with what it says now, `hts {command} --config {quote(str(file))} --out DIR`, or put it "
            "back as the run wrote it."
        )
        raise RunError(
            f"{file}: the SHA-256 of its settings is {found[:12]}…, the run was begun with {begun_with[:12]}…. "
            f"{advice or anew}"
        )


def other_versions(kept: Mapping[str, Any]) -> str:
    """In words, which packages that the plugins of a run come from have another version than when it was begun; ""
    where none has. kept: its provenance.json; what that does not say, or is gone, is passed over."""
    before, ours = kept.get("packages"), kept.get("plugins")
    if not isinstance(before, Mapping) or not isinstance(ours, Mapping):
        return ""
    now = {name: _version(name) for name in sorted({str(one) for one in ours.values()})}
    return ", ".join(
        f"{name} {before[name]} (now {version})"
        for name, version in now.items()
        if version is not None and before.get(name) not in (None, version)
    )


def packages(distributions: Iterable[str]) -> dict[str, str]:
    """Name -> version of these distributions and of what they require themselves, extras included, sorted by name.

    What is not installed (most extras) is left out.
    """
    found: dict[str, str] = {}
    for distribution in distributions:
        try:
            required = metadata.requires(distribution) or []
        except metadata.PackageNotFoundError:
            continue
        names = [match.group() for line in required if (match := NAME.match(line))]
        for name in (distribution, *names):
            version = _version(name)
            if version is not None:
                found[name] = version
    return dict(sorted(found.items()))


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _git(*arguments: str) -> str | None:
    """Output of git in the source tree; None without git, and for an installed package, also where its environment lies
    inside somebody else's repository."""
    here = Path(__file__)
    try:
        _asked_of_git(here.parent, "ls-files", "--error-unmatch", here.name)  # is it of this repository at all?
        return _asked_of_git(here.parent, *arguments)
    except (OSError, subprocess.SubprocessError):
        return None


def _asked_of_git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, timeout=20, check=True)
    return done.stdout.strip()


def _accelerator() -> str | None:
    import torch

    return torch.cuda.get_device_name() if torch.cuda.is_available() else None
