"""Checkpoints of rsl_rl, of all its generations: legged_gym's, Isaac Lab's and mjlab's `model_N.pt`."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from hts.errors import PolicyError
from hts.policies.card_checks import LARGEST_OBSERVATION, MOST_LAYERS, MOST_UNITS
from hts.policies.translate import Network

# rsl_rl's EmpiricalNormalization divides by std + 0.01 (rsl_rl/modules/normalization.py).
EPSILON = 0.01
LARGEST_FILE = 2**30  # bytes


OWN = (
    "A network of your own comes in as a .safetensors with layer.0.weight and so on "
    "(docs/policies-from-elsewhere.md, 'Your own code')."
)


def from_checkpoint(path: Path) -> tuple[Network, dict[str, Any], bool]:
    """Its actor, what the card should say of it, and whether it normalises. Raises PolicyError."""
    data = weights_of(path)
    try:
        state, normaliser, log_std = _parts(path, data)
        layers = _layers(path, state)
        iteration = data.get("iter", 0)
        made = {"kind": "rsl_rl", "iteration": iteration if isinstance(iteration, int) else 0}
        inputs, outputs = layers[0][0].shape[1], layers[-1][0].shape[0]
        mean, spread = (torch.zeros(inputs), torch.ones(inputs)) if normaliser is None else normaliser
        if mean.shape != (inputs,) or spread.shape != (inputs,):
            raise PolicyError(f"{path}: its normaliser has {mean.numel()} entries, its actor {inputs} observations.")
        if bool((spread <= 0).any()):
            raise PolicyError(f"{path}: its normaliser has a spread that is not above 0. Use another checkpoint.")
    except (AttributeError, TypeError, KeyError, RuntimeError) as error:  # parts that are no tensors
        what = f"{type(error).__name__}: {error}".splitlines()[0]
        raise PolicyError(f"{path}: its parts are not those of an rsl_rl checkpoint ({what[:120]}).") from error
    kept = log_std if log_std is not None and log_std.shape == (outputs,) else None
    return Network(layers, mean, spread, None, kept), made, normaliser is not None


def weights_of(path: Path) -> Mapping[str, Any]:
    """The checkpoint's dictionary, read without running any of it."""
    if not path.is_file():
        raise PolicyError(f"{path}: no such file.")
    if path.stat().st_size > LARGEST_FILE:
        raise PolicyError(f"{path}: has more than {LARGEST_FILE >> 20} MB; no such policy has.")
    if zipfile.is_zipfile(path):
        try:
            with zipfile.ZipFile(path) as archive:
                entries = archive.infolist()
        except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
            raise PolicyError(
                f"{path}: a damaged archive ({error}). Copy it again from where it was trained."
            ) from error
        if sum(entry.file_size for entry in entries) > LARGEST_FILE:
            raise PolicyError(f"{path}: unpacks to more than {LARGEST_FILE >> 20} MB; no such policy does.")
        if any(entry.filename.endswith("constants.pkl") for entry in entries):
            raise PolicyError(
                f"{path}: a TorchScript file. That is a program, and loading it would run it. "
                "Use the checkpoint it was exported from, or a .safetensors or .onnx of the policy."
            )
    try:
        data = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many classes, one for each way a file can be broken or unsafe
        objects = re.findall(r"GLOBAL ([\w.]+)", str(error))  # torch's advice is to run them; ours is not
        why = str(error).splitlines()[0] if str(error) else type(error).__name__
        held = f"it holds Python objects such as {objects[0]}, which would have to be run" if objects else why
        raise PolicyError(
            f"{path}: cannot be read as weights only ({held[:160]}). Save its state_dicts as plain tensors."
        ) from error
    if not isinstance(data, Mapping):
        raise PolicyError(
            f"{path}: holds a {type(data).__name__}, expected an rsl_rl checkpoint with 'model_state_dict'."
        )
    return data


def _parts(
    path: Path, data: Mapping[str, Any]
) -> tuple[dict[str, torch.Tensor], tuple[torch.Tensor, torch.Tensor] | None, torch.Tensor | None]:
    """Layers by `N.weight`; mean and spread of the normaliser or None; log sigma or None.

    rsl_rl up to 3 keeps one model_state_dict (actor.N.*, std or log_std, actor_obs_normalizer.*; before 3 the
    normaliser lies beside it, obs_norm_state_dict); from 4 on an actor_state_dict (mlp.N.*, distribution.*,
    obs_normalizer.*).
    """
    extra: tuple[str, ...]
    if "actor_state_dict" in data:
        state, prefix, extra = data["actor_state_dict"], "mlp.", ("obs_normalizer.", "distribution.", "std", "log_std")
    elif "model_state_dict" in data:
        state, prefix, extra = data["model_state_dict"], "actor.", ("actor_obs_normalizer.", "std", "log_std", "critic")
    else:
        raise PolicyError(
            f"{path}: has the parts {sorted(map(str, data))[:8]}, expected 'model_state_dict' or 'actor_state_dict' of "
            f"rsl_rl. {OWN}"
        )
    strange = [name for name in state if not name.startswith((prefix, *extra))]
    if strange:
        raise PolicyError(
            f"{path}: its actor is more than layers and a normaliser ('{str(strange[0])[:60]}'): only plain rsl_rl "
            f"actors can be read. {OWN}"
        )
    layers = {name.removeprefix(prefix): value.float() for name, value in state.items() if name.startswith(prefix)}
    inside = {name.split(".")[-1]: value for name, value in state.items() if name.startswith(extra[0])}
    found = inside or data.get("obs_norm_state_dict") or {}
    normaliser = None
    if found:
        if "_mean" not in found or "_std" not in found:
            raise PolicyError(f"{path}: its normaliser has {sorted(map(str, found))[:8]}, expected '_mean' and '_std'.")
        normaliser = found["_mean"].float().flatten(), found["_std"].float().flatten() + EPSILON
    std = state.get("std", state.get("distribution.std_param"))
    log_std = state.get("log_std", state.get("distribution.log_std_param"))
    if log_std is None and std is not None:
        if bool((std <= 0).any()):
            raise PolicyError(
                f"{path}: its sigma of exploration (std) is {float(std.min()):g} for an action, expected above 0. Use "
                "another checkpoint."
            )
        log_std = std.float().log()
    return layers, normaliser, None if log_std is None else log_std.float()


def _layers(path: Path, state: Mapping[str, torch.Tensor]) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """(weight, bias) of each linear layer; between two lies an activation, so they are numbered 0, 2, 4, ..."""
    count = len(state) // 2
    expected = {f"{2 * index}.{what}" for index in range(count) for what in ("weight", "bias")}
    if not state or set(state) != expected:
        raise PolicyError(
            f"{path}: its actor has {sorted(state)[:6]}, expected linear layers 0, 2, 4, ... with weight and bias."
        )
    layers = [(state[f"{2 * index}.weight"], state[f"{2 * index}.bias"]) for index in range(count)]
    if any(weight.ndim != 2 for weight, _ in layers) or count < 2:
        raise PolicyError(f"{path}: its actor is not a plain network with at least one hidden layer.")
    before = None
    for index, (weight, bias) in enumerate(layers):
        fits = before in (None, weight.shape[1]) and bias.shape == weight.shape[:1] and 0 not in weight.shape
        if not fits or weight.shape[0] > MOST_UNITS or weight.shape[1] > LARGEST_OBSERVATION or count > MOST_LAYERS:
            shapes = f"{tuple(weight.shape)} and {tuple(bias.shape)}"
            raise PolicyError(f"{path}: layer {2 * index} has the shapes {shapes}, which do not fit the one before.")
        before = weight.shape[0]
    return layers
