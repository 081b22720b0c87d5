"""Measurement models on disk: `NAME.safetensors` with the numbers, `NAME.json` beside it with the rest.

No pickle: opening a file never runs code. The JSON names the SHA-256 of its numbers, so that two files of
different models cannot be mistaken for one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from pydantic import ValidationError
from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as dump_tensors

from hts.atomic import atomic_write
from hts.errors import PolicyError
from hts.measurement.models import MeasurementModel, MeasurementModelConfig

FORMAT = "hts-measurement-model"
VERSION = 1


def save(model: MeasurementModel, path: Path, notes: Mapping[str, Any] | None = None) -> Path:
    """Write the model to `path` (ending .safetensors) and its .json; returns `path`.

    notes: anything JSON can hold, such as the dataset it was fitted on. Each file appears whole or not at all.
    """
    path = Path(path).with_suffix(".safetensors")
    numbers = dump_tensors({name: value.detach().cpu().contiguous() for name, value in model.state_dict().items()})
    card = {
        "format": FORMAT,
        "version": VERSION,
        "config": model.config.model_dump(mode="json"),
        "input_sizes": list(model.input_sizes),
        "rate_hz": model.rate_hz,
        "sha256": hashlib.sha256(numbers).hexdigest(),
        "notes": dict(notes or {}),
    }
    atomic_write(path, numbers)
    atomic_write(path.with_suffix(".json"), json.dumps(card, indent=2) + "\n")
    return path


def load(path: Path, device: torch.device | str = "cpu") -> MeasurementModel:
    """The model saved at `path`, in evaluation mode. Raises PolicyError with what is wrong with which file."""
    path = Path(path).with_suffix(".safetensors")
    card = read_card(path)
    numbers = _read(path)
    if hashlib.sha256(numbers).hexdigest() != card["sha256"]:
        raise PolicyError(
            f"{path}: its {len(numbers)} bytes are not those that {path.with_suffix('.json').name} describes. "
            "The file is truncated, changed, or belongs to another model. Copy both files again, or fit anew."
        )
    try:
        config = MeasurementModelConfig.model_validate(card["config"])
        model = MeasurementModel(config, card["input_sizes"], card["rate_hz"])
        model.load_state_dict(load_tensors(numbers))
    except (SafetensorError, ValidationError, RuntimeError, ValueError, TypeError) as error:
        reason = str(error).splitlines()[0]
        raise PolicyError(f"{path}: not a measurement model this version can read ({reason}). Fit anew.") from error
    return model.eval().to(device)


def read_card(path: Path) -> dict[str, Any]:
    """The JSON beside a model: config, input_sizes, rate_hz, sha256, notes. Raises PolicyError."""
    side = Path(path).with_suffix(".json")
    try:
        card = json.loads(_read(side))
    except ValueError as error:
        raise PolicyError(f"{side}: not JSON ({error}). It was cut off or is another file. Fit anew.") from error
    if not isinstance(card, dict) or card.get("format") != FORMAT:
        found = card.get("format") if isinstance(card, dict) else type(card).__name__
        raise PolicyError(f"{side}: describes {found!r}, expected {FORMAT!r}. Give the path of a measurement model.")
    if card.get("version") != VERSION:
        raise PolicyError(
            f"{side}: format version {card.get('version')}, this hts reads version {VERSION}. "
            "Open it with the hts that wrote it, or fit anew."
        )
    missing = [key for key in ("config", "input_sizes", "rate_hz", "sha256") if key not in card]
    if missing:
        raise PolicyError(f"{side}: '{missing[0]}' is missing. The file was edited or cut off. Fit anew.")
    return card


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise PolicyError(f"{path}: cannot be read ({error.strerror}). Expected a measurement model there.") from error
