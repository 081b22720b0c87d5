"""A fitted measurement model with its objective's reward, in one file for those who train elsewhere.

The file is safetensors: numbers, and in its header one JSON text. A plugin's model can be written too, since its step
is written down as operations (`operations.py`) and not as a class that the reader would have to have; one whose step
needs another operation than these is refused by that operation's name. Beside the
programs it holds a reference: inputs of some worlds, where their episodes ended, and what this `hts` gives for them in
its own env. Who opens the file replays it first, with another torch, maybe on another device, and refuses what differs.

`integrations/rsl_rl` reads it, with torch alone.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save as dump_tensors
from tensordict import TensorDict
from torch import Tensor

from hts.atomic import atomic_write
from hts.contracts import MeasurementModel, Objective
from hts.errors import ConfigError, RunError
from hts.measurement.files import written
from hts.measurement.operations import Recorded
from hts.measurement.pessimism import pessimistic_reward
from hts.measurement.transform import MeasurementTransform

FORMAT = "hts-measurement-program"
VERSION = 1
HEADER = "hts"
"""Key of the JSON in the header of the safetensors file."""
STEPS, WORLDS = 60, 4
"""Size of the reference."""
TOLERANCE = 1e-5
"""Largest difference from the model, absolute and relative, of predictions in standard deviations and of rewards."""


def export_model(
    model: MeasurementModel,
    objective: Objective,
    to: Path,
    *,
    joint_names: Sequence[str] | None = None,
    notes: Mapping[str, Any] | None = None,
) -> Path:
    """Write the model and the objective's reward to the file `to`; returns it.

    joint_names: the order of joints that the inputs have, None where it is not known; notes: anything JSON can hold.
    Raises RunError if `to` exists, ConfigError for a model that cannot be written down or whose memory is not as the
    file says it.
    """
    to = Path(to)
    if to.exists():
        raise RunError(f"{to}: exists already. Choose another file with --to.")
    if model.settles and model.settles_in_physics_steps:
        raise ConfigError(
            f"Model '{model.name or type(model).__name__}' was fitted to physics steps and looks at each of them; the "
            "reward of a file reads one row a control step. Fit without them to export: give the model "
            "physics_steps=false."
        )
    model = model.to("cpu")
    channels = model.signals.inputs
    with torch.no_grad():
        reference = _reference(model, objective)
        initial = _initial_state(model)
        programs, recorded = _programs(model, objective, reference)
    card = {
        "format": FORMAT,
        "version": VERSION,
        "model": model.name or type(model).__name__,
        "objective": objective.name,
        "inputs": [written(channel) for channel in channels],
        "target": written(model.signals.target),
        "rate_hz": model.signals.rate_hz,
        "joint_names": None if joint_names is None else list(joint_names),
        "target_mean": float(model.target_mean),
        "target_std": float(model.target_std),
        "programs": programs,
        "tolerance": TOLERANCE,
        "notes": dict(notes or {}),
    }
    tensors = {**recorded.constants, "initial": initial, **{f"reference.{k}": v for k, v in reference.items()}}
    text = json.dumps(card, allow_nan=False)
    atomic_write(to, dump_tensors({name: value.contiguous() for name, value in tensors.items()}, {HEADER: text}))
    return to


def _programs(
    model: MeasurementModel, objective: Objective, reference: Mapping[str, Tensor]
) -> tuple[dict[str, Any], Recorded]:
    """`reward`, what training looks at; and `sensor`, what the sensor would show, where that is another thing."""
    inputs, state = reference["inputs"][0], model.initial_state(WORLDS)
    model.step(inputs, state)  # what it makes of its weights once is made before anything is written down

    def stepped(inputs: Tensor, state: Tensor) -> tuple[Tensor, ...]:
        prediction, after = model.step(inputs, state)
        reward = pessimistic_reward(objective.reward, prediction, model.pessimism)
        return prediction.mean, reward, model.outside(inputs), after

    def settled(inputs: Tensor) -> tuple[Tensor, ...]:
        prediction = model.settled(inputs)
        return prediction.mean, pessimistic_reward(objective.reward, prediction, model.pessimism), model.outside(inputs)

    def shown(inputs: Tensor, state: Tensor) -> tuple[Tensor, ...]:
        prediction, after = model.step(inputs, state)
        return prediction.mean, after

    recorded, name = Recorded(), model.name or type(model).__name__
    both = {"inputs": inputs, "state": state}
    programs: dict[str, Any] = {}
    if model.settles:
        model.settled(inputs)
        programs["reward"], again = recorded.record(settled, {"inputs": inputs}, name)
        programs["sensor"], again_shown = recorded.record(shown, both, name)
        _check(name, lambda inputs, state: again(inputs), reference)
        states = model.initial_state(7), model.initial_state(7)
        for now in reference["inputs"][:5, [0, 1, 2, 3, 0, 1, 2]]:
            found, wanted = again_shown(now, states[0]), shown(now, states[1])
            _close(name, found[0], wanted[0])
            states = found[1], wanted[1]
    else:
        programs["reward"], again = recorded.record(stepped, both, name)
        _check(name, again, reference, model)
    return programs, recorded


def _check(name: str, program: Any, reference: Mapping[str, Tensor], model: MeasurementModel | None = None) -> None:
    """What was written down gives what the env gave, for other numbers of worlds than it was written down with."""
    for worlds in ([1, 0], [0, 1, 2, 3, 2, 1, 0]):
        state = torch.empty(len(worlds), 0) if model is None else model.initial_state(len(worlds))
        for index, now in enumerate(reference["inputs"]):
            found = program(now[worlds], state)
            for value, key in zip(found, ("measured", "reward", "outside"), strict=False):
                _close(name, value, reference[key][index, worlds])
            if model is not None:
                state = model.reset(found[3], reference["ended"][index, worlds].bool())


def _close(name: str, found: Tensor, wanted: Tensor) -> None:
    if not torch.allclose(found, wanted, rtol=TOLERANCE, atol=TOLERANCE):
        raise ConfigError(
            f"Measurement model '{name}': written down as operations it is off by {(found - wanted).abs().max():.2g}. "
            "Its step depends on the number of worlds or on something that is not in its arguments."
        )


def _reference(model: MeasurementModel, objective: Objective) -> dict[str, Tensor]:
    """inputs (T, W, F), ended (T, W), and what the env's own transform makes of them, (T, W) each."""
    held = model.tensors()
    low, high = (held.get(name, torch.tensor(torch.nan)) for name in ("input_low", "input_high"))
    random = torch.Generator().manual_seed(0)
    share = torch.rand(STEPS, WORLDS, model.signals.num_inputs, generator=random)
    known = torch.isfinite(low) & torch.isfinite(high)
    # A little beyond the range too, so that `outside` is not 0 everywhere.
    inputs = torch.where(known, low + (high - low) * (1.1 * share - 0.05), 4.0 * share - 2.0).float()
    ended = torch.rand(STEPS, WORLDS, generator=random) < 0.05
    inside = MeasurementTransform.of(objective, model)
    inside.prepare(WORLDS, torch.device("cpu"))
    rows: dict[str, list[Tensor]] = {"measured": [], "reward": [], "outside": []}
    for now, over in zip(inputs, ended, strict=True):
        parts = now.split(list(model.signals.sizes), 1)
        channels = TensorDict(
            {
                one.name: part.reshape(1, WORLDS, *one.shape)
                for one, part in zip(model.signals.inputs, parts, strict=True)
            },
            [1, WORLDS],
        )
        entries = inside.evaluate(inside.record(channels))
        for key, entry in zip(rows, inside.out_keys, strict=True):
            rows[key].append(entries[entry].reshape(WORLDS).clone())
        inside.forget(over)
    return {"inputs": inputs, "ended": ended.to(torch.uint8), **{key: torch.stack(row) for key, row in rows.items()}}


def _initial_state(model: MeasurementModel) -> Tensor:
    """The memory of one world that has just begun. Raises ConfigError where worlds begin in different ways, or where a
    reset is not to begin again."""
    initial = model.initial_state(3)
    state = torch.randn(initial.shape, generator=torch.Generator().manual_seed(1))
    begun = torch.tensor([True, False, True])
    mask = begun.view(-1, *(1,) * (initial.ndim - 1))
    plain = torch.equal(model.reset(state, begun), torch.where(mask, initial, state))
    if not plain or not torch.equal(initial, initial[:1].expand_as(initial)):
        raise ConfigError(
            f"Measurement model '{model.name}': not every world begins with the same memory, or a reset does not lead "
            "back to it, as the contract of a model says. It cannot be written to a file of operations."
        )
    return initial[0].clone()
