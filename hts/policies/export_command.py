"""`hts export`: a policy of a run, written for the robot's computer."""

from __future__ import annotations

from pathlib import Path

from hts.errors import PolicyError, RunError, unknown_name


def export_policy(folder: Path, policy: str, format: str, to: Path) -> Path:
    """Write a policy of the run in `folder` to the file `to`; that path.

    policy: "best", "pretrained" or a candidate's id; format: "onnx" or "torchscript".
    Raises PolicyError for a policy that is not there or is damaged, RunError if `to` exists: nothing is overwritten.
    """
    from hts.policies import export
    from hts.policies.files import load_policy

    if to.exists():
        raise RunError(f"{to}: exists already. Choose another file with --to.")
    found = load_policy(find_policy(folder, policy))
    return export.to_onnx(found, to) if format == "onnx" else export.to_torchscript(found, to)


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
