"""A fitted measurement model from the one file that `hts export --measurement-model` writes: torch alone, no hts."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from hts_rsl_rl.errors import ModelFileError
from hts_rsl_rl.program import Program

FORMAT = "hts-measurement-program"
VERSIONS = (1,)
HEADER = "hts"
LARGEST_FILE = 256 * 2**20  # bytes; those of hts have some ten thousand
RESULTS = ("measured", "reward", "outside")
WALKED = 2  # worlds of the walk before anything runs


class Measured(NamedTuple):
    """What training sees of W worlds, each (W,).

    measured: the target in standard deviations of the data (`MeasurementModel.in_units` gives units); reward: r_real of
    the objective, per second, not weighted, not centred; outside: share of the inputs outside the data's range.
    """

    measured: Tensor
    reward: Tensor
    outside: Tensor


@dataclass(frozen=True)
class Input:
    """A channel that the model reads."""

    name: str
    unit: str
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        """Numbers per sample."""
        return math.prod(self.shape)


class MeasurementModel:
    """Predictions for many worlds at once, one control step at a time, with the memory in the caller's hands:

        model = MeasurementModel("cost.safetensors", device)
        state = model.initial_state(worlds)
        seen, state = model.step(inputs, state)        # inputs (W, F), channels side by side in the order of `inputs`
        state = model.reset(state, ended)              # where an episode is over, bool (W,)

    Opening a file runs no code that is in it, and replays the reference that hts wrote beside the model; what differs
    from it by more than 1e-5 is refused. A NaN never becomes a finite prediction.

    Attributes: name, objective; inputs and target, with units; rate_hz, of the control steps; joint_names, None where
    the file does not say; target_mean, target_std; off, the largest difference from the reference. Raises
    ModelFileError.
    """

    def __init__(self, path: str | Path, device: torch.device | str = "cpu") -> None:
        self.path, self.device = Path(path), torch.device(device)
        card, tensors = _read(self.path)
        try:
            self.name, self.objective = str(card["model"]), str(card["objective"])
            self.inputs = tuple(_input(one) for one in card["inputs"])
            self.target = _input(card["target"])
            self.rate_hz = float(card["rate_hz"])
            names = card["joint_names"]
            self.joint_names = None if names is None else tuple(str(name) for name in names)
            self.target_mean, self.target_std = float(card["target_mean"]), float(card["target_std"])
            programs = {str(name): dict(one) for name, one in dict(card["programs"]).items()}
            tolerance = min(1e-5, float(card["tolerance"]))
            reference = {name: tensors.pop(f"reference.{name}") for name in ("inputs", "ended", *RESULTS)}
            self._initial = tensors.pop("initial")
        except (KeyError, TypeError, ValueError) as error:
            raise ModelFileError(f"{self.path}: {type(error).__name__}: {error}. Export the model again.") from error
        if "reward" not in programs:
            raise ModelFileError(f"{self.path}: has no program 'reward'. Export the model again.")
        self._programs = {name: Program(one, tensors, f"{self.path}: {name}") for name, one in programs.items()}
        self._reward = self._programs["reward"]
        self._check_shapes(reference)
        for program in self._programs.values():
            program.to(self.device)
        self._initial = self._initial.to(self.device)
        self.off = self._replayed(reference, tolerance)

    @property
    def num_inputs(self) -> int:
        """F: numbers per sample over all inputs."""
        return sum(one.size for one in self.inputs)

    def initial_state(self, worlds: int) -> Tensor:
        """The memory of worlds that have just begun, (W, ...)."""
        return self._initial.unsqueeze(0).repeat(worlds, *(1,) * self._initial.ndim)

    def reset(self, state: Tensor, begun: Tensor) -> Tensor:
        """The state with the worlds in begun, bool (W,), as they begin; the others to the bit as they were."""
        return torch.where(begun.view(-1, *(1,) * self._initial.ndim), self._initial, state)

    def step(self, inputs: Tensor, state: Tensor) -> tuple[Measured, Tensor]:
        """One control step of W worlds: inputs (W, F) in the channels' units."""
        found = self._reward(*((inputs, state) if len(self._reward.arguments) == 2 else (inputs,)))
        return Measured(*found[:3]), found[3] if len(found) > 3 else state

    def sensor(self, inputs: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """What the sensor would show, (W,), with its delay: the same as `step` but for a model that knows it, whose
        reward looks at what the target would settle at. Keep a state of its own for it."""
        if "sensor" not in self._programs:
            seen, after = self.step(inputs, state)
            return seen.measured, after
        measured, after = self._programs["sensor"](inputs, state)
        return measured, after

    def in_units(self, measured: Tensor) -> Tensor:
        """From standard deviations to the target's unit, any shape."""
        return measured * self.target_std + self.target_mean

    # ------------------------------------------------------------------------------------------------- checking

    def _check_shapes(self, reference: dict[str, Tensor]) -> None:
        """Raises ModelFileError unless programs and reference are of one piece; nothing runs yet."""
        inputs = torch.zeros(WALKED, self.num_inputs, device="meta")
        state = torch.zeros(WALKED, *self._initial.shape, device="meta")
        for name, program in self._programs.items():
            remembers = "state" in program.arguments
            if program.arguments != ["inputs", *(["state"] if remembers else [])]:
                raise ModelFileError(f"{self.path}: {name}: takes {program.arguments}. Export the model again.")
            expected = [(WALKED,)] * (3 if name == "reward" else 1) + [tuple(state.shape)] * remembers
            found = [tuple(one.shape) for one in program.walk([inputs, state][: 1 + remembers])]
            if found != expected:
                raise ModelFileError(
                    f"{self.path}: {name}: gives {found}, expected {expected}. Export the model again."
                )
        steps, worlds = reference["ended"].shape if reference["ended"].ndim == 2 else (0, 0)
        whole = {"inputs": (steps, worlds, self.num_inputs)} | dict.fromkeys(("ended", *RESULTS), (steps, worlds))
        if not steps * worlds or any(tuple(reference[name].shape) != shape for name, shape in whole.items()):
            raise ModelFileError(f"{self.path}: its reference is incomplete. Export the model again.")

    def _replayed(self, reference: dict[str, Tensor], tolerance: float) -> float:
        """The largest difference from what hts gave. Raises ModelFileError where it is too large."""
        moved = {name: value.to(self.device) for name, value in reference.items()}
        state, worst = self.initial_state(moved["inputs"].shape[1]), 0.0
        for index, inputs in enumerate(moved["inputs"]):
            seen, state = self.step(inputs, state)
            state = self.reset(state, moved["ended"][index].bool())
            for name, value in zip(RESULTS, seen, strict=True):
                wanted = moved[name][index]
                off = ((value - wanted).abs() / (1.0 + wanted.abs())).max().item()
                if not off <= tolerance:
                    raise ModelFileError(
                        f"{self.path}: after {index + 1} steps '{name}' is off by {off:.2g} from what hts gave, "
                        f"more than {tolerance:g}. The file is damaged, or this torch ({torch.__version__}, "
                        f"{self.device.type}) computes otherwise: on a GPU switch TF32 off, or export the model again."
                    )
                worst = max(worst, off)
        return worst


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Header and tensors of a file. Raises ModelFileError."""
    if not path.is_file():
        raise ModelFileError(f"{path}: no such file. Write one: hts export --measurement-model FILE --to {path.name}")
    if path.stat().st_size > LARGEST_FILE:
        raise ModelFileError(
            f"{path}: has {path.stat().st_size} bytes, more than {LARGEST_FILE}. Is it the right file?"
        )
    try:
        with safe_open(path, "pt") as file:
            text = (file.metadata() or {}).get(HEADER)
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118, it is no dict
    except (SafetensorError, OSError) as error:
        line = " ".join(str(error).split())[:120]
        raise ModelFileError(f"{path}: not a safetensors file ({line}). Copy it again, or export it again.") from error
    try:
        card = json.loads(text) if text is not None else None
    except (ValueError, RecursionError) as error:
        raise ModelFileError(f"{path}: its header is not JSON. Copy it again, or export it again.") from error
    if not isinstance(card, dict) or card.get("format") != FORMAT:
        raise ModelFileError(
            f"{path}: is no exported measurement model (a model of `hts fit` has no program in it). Write one: "
            f"hts export --measurement-model {path.name} --to exported.safetensors"
        )
    if card.get("version") not in VERSIONS:
        raise ModelFileError(
            f"{path}: format version {str(card.get('version'))[:20]}, this package reads up to {VERSIONS[-1]}. Update "
            "hard-to-sim-rsl-rl, or export with the hts that it belongs to."
        )
    return card, tensors


def _input(written: Any) -> Input:
    shape = tuple(int(size) for size in written["shape"])
    if any(size < 1 or size > 10_000 for size in shape):
        raise ValueError(f"channel of shape {shape}")
    return Input(str(written["name"]), str(written["unit"]), shape)
