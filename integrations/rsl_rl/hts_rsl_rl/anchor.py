"""The policy to stay close to, from a checkpoint of rsl_rl: read without running anything that is in it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import nn

from hts_rsl_rl.errors import AnchorError

RENAMED = (("actor_obs_normalizer.", "obs_normalizer."), ("actor.", "mlp."))
"""Beginnings of the names of an actor's numbers before rsl_rl 4 -> since."""
SIGMAS = {"std": "distribution.std_param", "log_std": "distribution.log_std_param"}
"""Names of sigma before rsl_rl 5 -> since."""
GIVE = "Give the model_N.pt of the policy that the data were recorded with."


def read_checkpoint(path: str | Path) -> dict[str, Any]:
    """What `runner.save` wrote, on the CPU. Raises AnchorError."""
    if not isinstance(path, str | Path) or not str(path):
        raise AnchorError(f"anchor_checkpoint is {path!r}; expected a file. {GIVE}")
    path = Path(path)
    if not path.is_file():
        raise AnchorError(f"anchor_checkpoint: {path} is no file. {GIVE}")
    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch names a dozen, pickle's own among them
        raise AnchorError(
            f"anchor_checkpoint: {path} cannot be read with weights_only=True ({_line(error)}). It was cut off, is "
            "another kind of file, or holds objects beside numbers; those are never loaded. Save it again with rsl_rl."
        ) from error
    if not isinstance(found, dict):
        raise AnchorError(f"anchor_checkpoint: {path} holds a {type(found).__name__}, expected what rsl_rl saves.")
    return found


def actor_state(checkpoint: Mapping[str, Any], path: str | Path) -> dict[str, torch.Tensor]:
    """The actor's numbers with the names of rsl_rl 5, also from checkpoints of rsl_rl 1 to 4."""
    if "actor_state_dict" in checkpoint:
        state = dict(checkpoint["actor_state_dict"])
    elif "model_state_dict" in checkpoint:
        state = {}
        for name, value in checkpoint["model_state_dict"].items():
            for old, new in RENAMED:
                if name.startswith(old):
                    state[new + name.removeprefix(old)] = value
            if name in SIGMAS:
                state[name] = value
    else:
        raise AnchorError(
            f"anchor_checkpoint: {path} has {_names(checkpoint)}; expected 'actor_state_dict' (rsl_rl 4 and later) or "
            "'model_state_dict'. Give a model_N.pt of PPO."
        )
    return {SIGMAS.get(str(name), str(name)): value for name, value in state.items()}


def critic_state(checkpoint: Mapping[str, Any]) -> dict[str, torch.Tensor] | None:
    """The critic's numbers of a checkpoint of rsl_rl 4 or later; None where there are none."""
    found = checkpoint.get("critic_state_dict")
    return None if found is None else dict(found)


def load_into(model: nn.Module, state: Mapping[str, torch.Tensor], what: str, path: str | Path) -> None:
    """Take over the numbers, if every name and shape is as the model has it; otherwise AnchorError and no change."""
    own = model.state_dict()
    for name in sorted({*own, *state}):
        if name not in state:
            raise AnchorError(f"anchor_checkpoint: {path} lacks '{name}' of the {what}. {REMEDY}")
        if name not in own:
            raise AnchorError(f"anchor_checkpoint: {path} has '{name}', which this run's {what} does not. {REMEDY}")
        if own[name].shape != state[name].shape:
            raise AnchorError(
                f"anchor_checkpoint: {path}: '{name}' has shape {tuple(state[name].shape)}, this run's {what} has "
                f"{tuple(own[name].shape)}. {REMEDY}"
            )
        if state[name].is_floating_point() and not bool(torch.isfinite(state[name]).all()):
            raise AnchorError(f"anchor_checkpoint: {path}: '{name}' is not finite. Give an earlier checkpoint.")
    model.load_state_dict(dict(state))


REMEDY = "Use the anchor's observations, hidden_dims, obs_normalization and std_type: those of its params/agent.yaml."


def fingerprint(state: Mapping[str, torch.Tensor]) -> str:
    """SHA-256 over names and numbers: the same policy, the same text."""
    digest = hashlib.sha256()
    for name in sorted(state):
        digest.update(name.encode())
        digest.update(state[name].detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


def _names(checkpoint: Mapping[str, Any]) -> str:
    names = sorted(map(str, checkpoint))
    return ", ".join(names[:6]) + (", …" if len(names) > 6 else "") if names else "nothing"


def _line(error: Exception) -> str:
    """The beginning of an error of torch, which may be a page, in one line of printable characters."""
    text = " ".join(str(error).split()) or type(error).__name__
    return "".join(c if c.isprintable() else "?" for c in text[:120])
