"""Measurement models on disk: `NAME.safetensors` with the numbers, `NAME.json` beside it with the rest.

No pickle: opening a file runs no code of its own. The JSON names the model as it is registered, so that what is
installed makes it again, and the SHA-256 of its numbers, so that two files of different models cannot be mistaken for
one.

Format 2 is written. Format 1, which knew one kind of model and no units, is read as `lstm`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as dump_tensors

from hts.atomic import atomic_write
from hts.channels import Channel
from hts.contracts import MeasurementModel, ModelContext, Signals
from hts.errors import ConfigError, HtsError, PluginError, PolicyError
from hts.guarded import guarded

if TYPE_CHECKING:
    from hts.plugins import Registry

FORMAT = "hts-measurement-model"
VERSION = 2
KEYS = {1: ("config", "input_sizes", "rate_hz", "sha256"), 2: ("model", "settings", "signals", "sha256")}
"""Version of the format -> what its JSON must hold."""


def save(model: MeasurementModel, path: Path, notes: Mapping[str, Any] | None = None) -> Path:
    """Write the model to `path` (ending .safetensors) and its .json; returns `path`.

    notes: anything JSON can hold, such as the dataset it was fitted on. Each file appears whole or not at all. Raises
    PluginError for a model that does not give its tensors.
    """
    path = Path(path).with_suffix(".safetensors")
    numbers = dump_tensors({name: value.detach().cpu().contiguous() for name, value in tensors_of(model).items()})
    card = {
        "format": FORMAT,
        "version": VERSION,
        "model": model.name,
        "settings": dict(model.settings),
        "signals": {
            "inputs": [written(channel) for channel in model.signals.inputs],
            "target": written(model.signals.target),
            "rate_hz": model.signals.rate_hz,
            "units_known": model.signals.units_known,
        },
        "sha256": hashlib.sha256(numbers).hexdigest(),
        "notes": dict(notes or {}),
    }
    text = json.dumps(card, indent=2) + "\n"  # what cannot be text stops it before the first file
    atomic_write(path, numbers)
    atomic_write(path.with_suffix(".json"), text)
    return path


def load(path: Path, device: torch.device | str = "cpu", registry: Registry | None = None) -> MeasurementModel:
    """The model saved at `path`. Raises PolicyError with what is wrong with which file, PluginError for a model that
    does not take what its file holds.

    registry: where the model is made by its name; None: of everything that is installed.
    """
    given, path = Path(path), Path(path).with_suffix(".safetensors")
    if given.is_dir() and not path.exists():
        inside = given / "model.safetensors"
        there = "which is there: give that path" if inside.is_file() else "which is not there"
        raise PolicyError(f"{given}: is a folder, expected a measurement model. `hts fit` writes {inside}, {there}.")
    card = read_card(path)
    numbers = _read(path)
    if hashlib.sha256(numbers).hexdigest() != card["sha256"]:
        raise PolicyError(
            f"{path}: its {len(numbers)} bytes are not those that {path.with_suffix('.json').name} describes. "
            "The file is truncated, changed, or belongs to another model. Copy both files again, or fit anew."
        )
    model = _made(path, card, registry)
    try:
        tensors = load_tensors(numbers)
    except SafetensorError as error:
        raise _unreadable(path, str(error)) from error
    _check_tensors(path, tensors, tensors_of(model))
    give_tensors(model, tensors)
    return moved(model, device)


def tensors_of(model: MeasurementModel) -> dict[str, torch.Tensor]:
    """All that was fitted, by name. Raises PluginError for an exception in it, and for anything but tensors."""
    what = f"Measurement model '{model.name}': tensors()"
    found = guarded(what, model.tensors)
    bad = [found] if not isinstance(found, Mapping) else [one for one in found.values() if not torch.is_tensor(one)]
    if bad:
        raise PluginError(f"{what} gave a {type(bad[0]).__name__}, expected a dict of name -> torch.Tensor.")
    return dict(found)


def give_tensors(model: MeasurementModel, tensors: Mapping[str, torch.Tensor]) -> None:
    """`model.load_tensors`. Raises PluginError for an exception in it."""
    guarded(f"Measurement model '{model.name}': load_tensors()", partial(model.load_tensors, tensors))


def moved(model: MeasurementModel, device: torch.device | str) -> MeasurementModel:
    """`model.to`. Raises PluginError for an exception in it, and where it gives back anything but the model."""
    what = f"Measurement model '{model.name}': to()"
    found = guarded(what, partial(model.to, device))
    if found is not model:
        raise PluginError(
            f"{what} gave a {type(found).__name__}, expected the model itself: move it, then return self."
        )
    return model


def read_card(path: Path) -> dict[str, Any]:
    """The JSON beside a model: model, settings, signals, sha256, notes (in format 1 config, input_sizes, rate_hz).
    Raises PolicyError."""
    side = Path(path).with_suffix(".json")
    try:
        card = json.loads(_read(side))
    except ValueError as error:
        raise PolicyError(f"{side}: not JSON ({error}). It was cut off or is another file. Fit anew.") from error
    if not isinstance(card, dict) or card.get("format") != FORMAT:
        found = card.get("format") if isinstance(card, dict) else type(card).__name__
        raise PolicyError(f"{side}: describes {found!r}, expected {FORMAT!r}. Give the path of a measurement model.")
    version = card.get("version")
    if version not in KEYS:
        raise PolicyError(
            f"{side}: format version {version}, this hts reads versions up to {VERSION}. "
            "Open it with the hts that wrote it, or fit anew."
        )
    missing = [key for key in KEYS[version] if key not in card]
    if missing:
        raise PolicyError(f"{side}: '{missing[0]}' is missing. The file was edited or cut off. Fit anew.")
    return card


def _made(path: Path, card: Mapping[str, Any], registry: Registry | None) -> MeasurementModel:
    """The unfitted model that the card describes."""
    if registry is None:
        from hts import plugins

        registry = plugins.load()
    try:
        name, settings, signals = _described_1(card) if card["version"] == 1 else _described_2(card)
        return registry.make_measurement_model(name, settings, ModelContext(signals))
    except ConfigError as error:  # another plugin, or other settings
        raise PolicyError(f"{path.with_suffix('.json')}: {error} The file needs what it was made with.") from error
    except (HtsError, KeyError, ValueError, TypeError, AttributeError) as error:
        raise _unreadable(path, f"{type(error).__name__}: {error}") from error


def _described_2(card: Mapping[str, Any]) -> tuple[str, dict[str, Any], Signals]:
    signals = card["signals"]
    inputs = tuple(_channel(one) for one in signals["inputs"])
    known = bool(signals.get("units_known", True))
    return (
        str(card["model"]),
        dict(card["settings"]),
        Signals(inputs, _channel(signals["target"]), float(signals["rate_hz"]), known),
    )


def _described_1(card: Mapping[str, Any]) -> tuple[str, dict[str, Any], Signals]:
    config, sizes = dict(card["config"]), card["input_sizes"]
    names, target = config.pop("inputs"), config.pop("target")
    kind = config.pop("kind", "lstm")
    inputs = tuple(Channel(str(name), "1", (int(size),)) for name, size in zip(names, sizes, strict=True))
    return kind, config, Signals(inputs, Channel(str(target), "1"), float(card["rate_hz"]), units_known=False)


def _check_tensors(path: Path, found: Mapping[str, torch.Tensor], wanted: Mapping[str, torch.Tensor]) -> None:
    """Raises PolicyError unless names and shapes are those of the model: a file is a stranger's until it fits."""
    for name in sorted({*found, *wanted}):
        if name not in wanted:
            raise _unreadable(path, f"it holds '{name}', which the model does not have")
        if name not in found:
            raise _unreadable(path, f"'{name}' is missing")
        shape, right = tuple(found[name].shape), tuple(wanted[name].shape)
        if shape != right:
            raise _unreadable(path, f"'{name}' has shape {shape}, the model has {right}")


def _unreadable(path: Path, reason: str) -> PolicyError:
    return PolicyError(f"{path}: not a measurement model this version can read ({' '.join(reason.split())}). Fit anew.")


def written(channel: Channel) -> dict[str, Any]:
    """Name, unit and shape, as JSON holds them."""
    return {"name": channel.name, "unit": channel.unit, "shape": list(channel.shape)}


def _channel(written: Mapping[str, Any]) -> Channel:
    return Channel(str(written["name"]), str(written["unit"]), tuple(int(size) for size in written["shape"]))


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise PolicyError(f"{path}: cannot be read ({error.strerror}). Expected a measurement model there.") from error
