"""Actors of other libraries, brought as plain layers in a safetensors file that their owners write at home.

    layer.0.weight (units, O), layer.0.bias, layer.1.weight, …
                        linear layers, an ELU between two; the last gives J actions, or J means and then J sigmas, of
                        which the means count
    mean, std (O,)      observations are normalised to (o - mean) / std; left out: they are not
    clip ()             and then kept within +-clip; left out: they are not
    log_std (J,)        sigma of exploration; left out: the caller's
    example_observation (n, O), example_action (n, J)            raw observations, and the mean actions of the original

The examples are replayed: a policy that does not give the original's actions, to 1e-5, is refused. So nothing about the
original is taken on trust but what the examples cannot show: the meaning of the observation's entries, the joint
order, and that an action is a target of this robot's joints.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch.nn import functional as F

from hts.errors import PolicyError
from hts.policies.card_checks import LARGEST_OBSERVATION, MOST_LAYERS, MOST_UNITS
from hts.policies.export import CLIP
from hts.policies.translate import Network

FIRST = "layer.0.weight"
TOLERANCE = 1e-5
"""Largest difference of a replayed action, action units, or relative where actions are larger than 1."""
FEWEST_EXAMPLES = 16

Tensors = Mapping[str, torch.Tensor]


def holds_layers(path: Path) -> bool:
    """Whether it is a safetensors file of plain layers; False for any other file, and for none."""
    try:
        with safe_open(path, "pt") as opened:
            return FIRST in opened.keys()  # noqa: SIM118 - no dictionary
    except (OSError, SafetensorError):
        return False


def layers_of(path: Path, joints: int) -> tuple[Network, tuple[torch.Tensor, torch.Tensor], dict[str, Any]]:
    """The network in a file of plain layers, its examples (observations (n, I), actions (n, A)), and what the card
    should say. Raises PolicyError naming the file and what was found."""
    given = _read(path)
    layers = _layers(path, given)
    inputs, outputs = layers[0][0].shape[1], layers[-1][0].shape[0]
    if outputs == 2 * joints:  # means and sigmas side by side
        layers[-1] = tuple(value[:joints] for value in layers[-1])  # type: ignore[assignment]
        outputs = joints
    if outputs != joints:
        raise PolicyError(f"{path}: its layers map {inputs} observations to {outputs} actions, expected {joints}.")
    examples = _examples(path, given, inputs, outputs)
    mean, std, clip = _normaliser(path, given, inputs)
    log_std = None
    if "log_std" in given:
        if given["log_std"].numel() != outputs:
            raise PolicyError(f"{path}: 'log_std' has {given['log_std'].numel()} numbers for {outputs} joints.")
        log_std = given["log_std"].flatten()
    return Network(layers, mean, std, clip, log_std), examples, {"kind": "layers"}


def replay_examples(path: Path, tensors: Tensors, layers: int, ours: torch.Tensor, wanted: torch.Tensor) -> float:
    """How far the policy is from the original's actions at most. ours (n, O), wanted (n, J): in our order and units.

    Raises PolicyError, with the reason as far as the examples show it, for more than 1e-5.
    """
    off = difference(actions_of(tensors, layers, ours), wanted)
    if not off <= TOLERANCE:
        raise PolicyError(f"{path}: {_why(tensors, layers, ours, wanted, off)}")
    return off


def _read(path: Path) -> dict[str, torch.Tensor]:
    """Its tensors as float32. Raises PolicyError for a damaged file, or numbers that are not finite."""
    try:
        with safe_open(path, "pt") as opened:
            found = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118 - no dictionary
    except (OSError, SafetensorError) as error:
        raise PolicyError(f"{path}: not a whole safetensors file ({error}). Write or copy it again.") from error
    for name, value in found.items():
        if not value.is_floating_point() or not bool(torch.isfinite(value).all()):
            raise PolicyError(f"{path}: '{name}' holds what are no finite numbers. Write it again as float32.")
    return {name: value.float() for name, value in found.items()}


def _layers(path: Path, given: Tensors) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """(weight, bias) of each linear layer, in order."""
    named = [name for name in given if name.startswith("layer.")]
    count = len(named) // 2
    expected = [f"layer.{index}.{what}" for index in range(count) for what in ("bias", "weight")]
    if sorted(named) != sorted(expected) or not 2 <= count <= MOST_LAYERS:
        raise PolicyError(
            f"{path}: it has {', '.join(sorted(named)[:6])}, expected layer.0, layer.1, … with weight and bias each, "
            "and at least one hidden layer."
        )
    layers = [(given[f"layer.{index}.weight"], given[f"layer.{index}.bias"]) for index in range(count)]
    before = None
    for index, (weight, bias) in enumerate(layers):
        fits = weight.ndim == 2 and bias.shape == weight.shape[:1] and before in (None, weight.shape[1])
        if not fits or weight.shape[0] > MOST_UNITS or weight.shape[1] > LARGEST_OBSERVATION:
            shapes = f"{tuple(weight.shape)} and {tuple(bias.shape)}"
            raise PolicyError(f"{path}: layer {index} has the shapes {shapes}, which do not fit what comes before.")
        before = weight.shape[0]
    return layers


def _examples(path: Path, given: Tensors, inputs: int, outputs: int) -> tuple[torch.Tensor, torch.Tensor]:
    found = [given.get(f"example_{what}", torch.zeros(0)) for what in ("observation", "action")]
    shapes = [tuple(value.shape) for value in found]
    count = len(found[1])
    if count < FEWEST_EXAMPLES or shapes != [(count, inputs), (count, outputs)]:
        raise PolicyError(
            f"{path}: example_observation and example_action have the shapes {shapes[0]} and {shapes[1]}, expected (n, "
            f"{inputs}) and (n, {outputs}) with n at least {FEWEST_EXAMPLES}: raw observations, and what the original "
            "does with them."
        )
    if bool((found[1] == found[1][0]).all()):
        raise PolicyError(f"{path}: all its examples have one action, which proves nothing. Give varied observations.")
    return found[0], found[1]


def _normaliser(path: Path, given: Tensors, inputs: int) -> tuple[torch.Tensor, torch.Tensor, float | None]:
    """Mean, spread, and the limit of normalised observations, None for none."""
    mean, std = given.get("mean", torch.zeros(inputs)), given.get("std", torch.ones(inputs))
    if mean.shape != (inputs,) or std.shape != (inputs,) or bool((std <= 0).any()):
        raise PolicyError(
            f"{path}: mean and std have the shapes {tuple(mean.shape)} and {tuple(std.shape)}, expected ({inputs},) "
            "each, std above 0."
        )
    clip = float(given["clip"]) if "clip" in given and given["clip"].numel() == 1 else None
    if clip is not None and clip <= 0:
        raise PolicyError(f"{path}: clip is {clip:g}, expected a number above 0; leave it out if nothing is clipped.")
    return mean, std, clip


def actions_of(
    tensors: Tensors,
    layers: int,
    observations: torch.Tensor,
    activation: Callable[[torch.Tensor], torch.Tensor] = F.elu,
    clip: float = CLIP,
) -> torch.Tensor:
    """Mean actions (n, J) of a policy's tensors, in double precision."""
    x = (observations.double() - tensors["observation_mean"].double()) / tensors["observation_std"].double()
    x = x.clamp(-clip, clip)
    for index in range(layers):
        x = F.linear(x, *(tensors[f"actor.{index}.{what}"].double() for what in ("weight", "bias")))
        x = activation(x) if index < layers - 1 else x
    return x


def difference(found: torch.Tensor, wanted: torch.Tensor) -> float:
    """The largest, in action units, relative where the wanted one is larger than 1; NaN for numbers that are none."""
    return float(((found - wanted.double()).abs() / wanted.double().abs().clamp(min=1.0)).max())


def _why(tensors: Tensors, layers: int, observations: torch.Tensor, wanted: torch.Tensor, off: float) -> str:
    """What the original does otherwise, as far as the examples show it."""
    text = f"its actions are not those of its examples, off by up to {off:.2g}"
    for name, activation in (("Tanh", torch.tanh), ("ReLU", F.relu), ("SiLU", F.silu), ("GELU", F.gelu)):
        if difference(actions_of(tensors, layers, observations, activation), wanted) <= TOLERANCE:
            return f"{text}: its activation is {name}, hts computes ELU. Train it with ELU."
    found = actions_of(tensors, layers, observations)
    if difference(found.tanh(), wanted) <= TOLERANCE:
        return f"{text}: the original squashes actions by tanh, hts does not. Use a distribution that does not squash."
    low, high = wanted.double().amin(0), wanted.double().amax(0)
    if difference(torch.minimum(torch.maximum(found, low), high), wanted) <= TOLERANCE:
        return (
            f"{text}: the original clips actions at {float(high.max()):g}, hts does not. Widen its action space, or "
            "give the actions before they are clipped."
        )
    if difference(actions_of(tensors, layers, observations, clip=float("inf")), wanted) <= TOLERANCE:
        return f"{text}: the original does not clip observations so tightly. Correct or leave out `clip`."
    return f"{text}. Check the order of the layers, mean and std, and that the observations are raw."
