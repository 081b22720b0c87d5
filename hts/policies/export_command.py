"""`hts export`: a policy of a run, or of a file, written for the robot's computer."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path

from hts.atomic import atomic_write
from hts.contracts import RobotSpec
from hts.errors import ConfigError, PolicyError, RunError, unknown_name
from hts.places import check_new_file


def export_policy(
    folder: Path | None, policy: str, format: str, to: Path, robot: RobotSpec | None = None, held_speed: bool = False
) -> Path:
    """Write a policy of the run in `folder` to the file `to`; that path.

    policy: "best", "pretrained", a candidate's id or a .safetensors file, without a folder always a file; format:
    "onnx" or "torchscript"; robot: whose the policy must be, None for any; held_speed: with the commands in front that
    the run's final found (`HeldCommands`).
    Before it is there, its actions are compared with the policy's on random observations, and on those of the run's
    recordings. What the gate found of it, or that nobody is known to have tried it, goes into a file beside it,
    `gate_notes.place`.
    Raises PolicyError for a policy that is not there, is damaged or another robot's, RunError if `to` exists (nothing
    is overwritten) or cannot be made, ConfigError for a held speed without a run.
    """
    from hts.policies import export
    from hts.policies.export_checks import check_export, random_observations, recorded_observations
    from hts.policies.files import load_policy
    from hts.policies.gate_notes import note_of, place, untried
    from hts.policies.held_commands import held_commands_of

    if held_speed and folder is None:
        raise ConfigError(
            "--held-speed: a policy file has no final. Name the run's folder: hts export DIR --held-speed"
        )
    check_new_file(to)
    if folder is None or Path(policy).suffix == ".safetensors":
        path = given_file(policy, (".safetensors",))
    else:
        path = find_policy(folder, policy)
    found = load_policy(path, robot)
    held = held_commands_of(folder, policy) if held_speed and folder is not None else None
    gate = note_of(path, vars(found.card), folder) or untried(vars(found.card), folder)
    beside, note = place(to), json.dumps(gate, indent=1) + "\n"
    if beside.exists() and note != beside.read_text(encoding="utf-8", errors="replace"):
        raise RunError(
            f"{beside}: exists already, and tells of another policy, or something else of this one. Move it away, or "
            "choose another --to."
        )
    observations = [random_observations(found)]
    if folder is not None and (folder / "data.zarr").is_dir():
        observations.append(recorded_observations(found, folder / "data.zarr"))
    to.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".export-", dir=to.parent) as temporary:
        trial = Path(temporary) / to.name
        write = export.to_onnx if format == "onnx" else export.to_torchscript
        written = write(found, trial, held)
        check_export(found, written, format, observations, held)
        atomic_write(beside, note)  # first, so that no policy lies there without it
        return atomic_write(to, written.read_bytes())


def given_file(policy: str | Path, endings: Sequence[str]) -> Path:
    """The file that was named instead of a run's policy. Raises PolicyError if it is none."""
    from hts.policies.files import ELSEWHERE

    path = Path(policy)
    if path.suffix not in endings or not path.is_file():
        other = path.suffix.lower() in ELSEWHERE and path.is_file()
        how = f" One of another library comes in by: hts policy import {path} --robot NAME --to FILE.safetensors"
        raise PolicyError(
            f"{policy}: expected a policy file that exists, ending in {' or '.join(endings)}.{how if other else ''}"
        )
    return path


def find_policy(folder: Path, policy: str) -> Path:
    """The .safetensors of that name in a run folder; `policies/` wins over `iterations/`. Raises PolicyError."""
    files = sorted((folder / "policies").glob("*.safetensors")) + sorted(
        (folder / "iterations").glob("*/candidates/*.safetensors")
    )
    policies = [file for file in files if file.with_suffix(".json").is_file()]
    by_name = {file.stem: file for file in reversed(policies)}
    if policy not in by_name:
        raise PolicyError(f"{folder}: " + unknown_name("policy", policy, by_name))
    return by_name[policy]
