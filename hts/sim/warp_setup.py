"""What the `warp` engine needs before the first step: packages, a device, buffers of the right size,
models per world."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
import torch

from hts.errors import ConfigError, HtsError, SimulationError

DRIVER = (12, 4)  # CUDA graphs with conditional nodes, in which the solver stops as soon as all worlds have converged
MOST_CONTACTS = 96  # per world, where the worst case of a robot is larger; `WarpEngine.check` watches it
INSTEAD = "or use --engine mujoco"
UNREAD = {
    "dof_length"
}  # follows from the masses; mujoco_warp reads it for sleeping bodies only, which nothing here has


def import_warp() -> tuple[ModuleType, ModuleType]:
    """`warp` and `mujoco_warp`, with their messages switched off. Raises ConfigError where they are missing."""
    try:
        import mujoco_warp
        import warp
    except ImportError as error:
        raise ConfigError(
            f"The warp engine cannot be loaded ({error}): pip install 'hard-to-sim[gpu]', {INSTEAD}."
        ) from error
    warp.config.log_level = max(warp.config.log_level, warp.LOG_WARNING)
    return warp, mujoco_warp


def torch_device(name: str) -> torch.device:
    """The device called `name`; "auto" is the current CUDA device. Raises ConfigError where CUDA does not work."""
    if name == "cpu":
        return torch.device("cpu")
    if torch.version.cuda is None:
        raise ConfigError(
            f"The warp engine needs CUDA, but this PyTorch is a CPU build: install a CUDA build, {INSTEAD}."
        )
    try:
        torch.cuda.init()
        device = torch.device("cuda", torch.cuda.current_device()) if name == "auto" else torch.device(name)
        if device.type != "cuda":
            raise ConfigError(
                f"The warp engine runs on cuda or cpu, not on '{name}': set env.device to auto, {INSTEAD}."
            )
        return device if device.index is not None else torch.device("cuda", torch.cuda.current_device())
    except (RuntimeError, AssertionError) as error:
        reason = str(error).strip().split("\n")[0].split(". ")[0].rstrip(".")
        raise ConfigError(
            f"The warp engine needs a working CUDA device ({reason}): install or update the NVIDIA driver, {INSTEAD}."
        ) from error


def warp_device(wp: ModuleType, device: torch.device) -> Any:
    """Warp's name for a torch device. Raises ConfigError where Warp cannot use it or the driver is too old."""
    if device.type == "cpu":
        return wp.get_device("cpu")
    driver = wp.get_cuda_driver_version()
    if not wp.is_cuda_available() or driver is None:
        raise ConfigError(f"PyTorch sees '{device}', Warp sees no CUDA device: update the NVIDIA driver, {INSTEAD}.")
    if driver < DRIVER or not wp.is_conditional_graph_supported():
        found, needed = (".".join(map(str, version)) for version in (driver, DRIVER))
        raise ConfigError(
            f"The NVIDIA driver supports CUDA {found}, the warp engine needs {needed} or newer: update the driver, "
            f"{INSTEAD}."
        )
    try:
        return wp.device_from_torch(device)
    except (RuntimeError, ValueError, IndexError) as error:
        raise ConfigError(
            f"Warp cannot use the device '{device}' ({error}): set env.device to cuda:0, {INSTEAD}."
        ) from error


def explained(error: Exception, worlds: int, device: torch.device) -> HtsError:
    """The one line for an exception raised while building or stepping: out of memory, or not supported."""
    text = " ".join(str(error).split())
    if isinstance(error, torch.OutOfMemoryError) or "allocate" in text or "out of memory" in text.lower():
        room = ""
        if device.type == "cuda":
            free, total = (size / 2**30 for size in torch.cuda.mem_get_info(device))
            room = f" ({free:.1f} of {total:.1f} GiB are free)"
        return SimulationError(
            f"{worlds} worlds do not fit into the memory of '{device}'{room}: "
            "lower finetune.num_envs or train fewer candidates together."
        )
    if isinstance(error, (NotImplementedError, ValueError)):
        return ConfigError(f"The warp engine cannot simulate this model ({text}): change the model, {INSTEAD}.")
    return SimulationError(f"The warp engine failed on '{device}': {text}")


def contacts_of_pair(model: mujoco.MjModel, first: int, second: int) -> int:
    """The most contacts that two geoms can make with each other."""
    kind = mujoco.mjtGeom
    types = {int(model.geom_type[first]), int(model.geom_type[second])}
    if kind.mjGEOM_HFIELD in types:
        return 8
    if kind.mjGEOM_SPHERE in types or types == {kind.mjGEOM_PLANE, kind.mjGEOM_ELLIPSOID}:
        return 1
    if kind.mjGEOM_CAPSULE in types and types <= {kind.mjGEOM_PLANE, kind.mjGEOM_CAPSULE, kind.mjGEOM_BOX}:
        return 2
    return 4 if kind.mjGEOM_PLANE in types else 8


def buffer_sizes(models: Sequence[mujoco.MjModel], pairs: np.ndarray) -> tuple[int, int]:
    """Contacts and constraint rows per world that suffice in the worst case, or `MOST_CONTACTS` and what follows from
    it.

    pairs (n, 2): geoms that may touch. Rows: one per joint with friction or a limit, six per equality, and for
    each contact 2 (condim - 1) with a pyramidal cone, condim with an elliptic one, 1 without friction.
    """
    model = models[0]
    contacts = min(max(1, sum(contacts_of_pair(model, int(a), int(b)) for a, b in pairs)), MOST_CONTACTS)
    condim = int(max([1, *model.geom_condim, *model.pair_dim]))
    pyramidal = model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    per_contact = max(1, 2 * (condim - 1)) if pyramidal else condim
    friction = np.any([m.dof_frictionloss > 0 for m in models], axis=0).sum()
    friction += np.any([m.tendon_frictionloss > 0 for m in models], axis=0).sum()
    limits = model.jnt_limited.sum() + model.tendon_limited.sum()
    return contacts, int(contacts * per_contact + friction + limits + 6 * model.neq)


def put_models(wp: ModuleType, mjw: ModuleType, models: Sequence[mujoco.MjModel], assignment: Sequence[int]) -> Any:
    """A `mujoco_warp.Model` on Warp's current device in which world w has the numbers of models[assignment[w]].

    Only fields that differ between the variants get a row per world (or per variant, where worlds take the variants
    in turn: mujoco_warp reads row w % rows). Raises ConfigError where variants differ in what all worlds must share.
    """
    built = mjw.put_model(models[0])
    used = sorted(set(assignment))
    if len(used) == 1 and used[0] == 0:
        return built
    with wp.ScopedDevice("cpu"):
        variants = {index: mjw.put_model(models[index]) for index in used}
    count, worlds = len(models), np.asarray(assignment)
    in_turn = len(worlds) >= count and bool((worlds == np.arange(len(worlds)) % count).all())
    rows = np.arange(count) if in_turn else worlds
    for target, originals in (
        (built, list(variants.values())),
        (built.opt, [variant.opt for variant in variants.values()]),
    ):
        for field in dataclasses.fields(target):
            values = [_numbers(getattr(original, field.name)) for original in originals]
            if field.name in UNREAD or all(np.array_equal(values[0], value) for value in values[1:]):
                continue
            if not isinstance(field.type, wp.array) or field.type.shape[:1] != ("*",):
                raise ConfigError(
                    f"The variants of the model differ in '{field.name}', which all worlds of the warp engine share: "
                    f"do not randomise it, {INSTEAD}."
                )
            by_index = dict(zip(variants, values, strict=True))
            stacked = np.concatenate([by_index[int(row)] for row in rows])
            array = wp.array(stacked, dtype=getattr(target, field.name).dtype)
            array._is_batched = True
            setattr(target, field.name, array)
    return built


def _numbers(value: Any) -> np.ndarray:
    """A field of a mujoco_warp model as numbers; empty for what is neither an array nor a number."""
    if isinstance(value, (bool, int, float, np.generic, np.ndarray)):
        return np.asarray(value)
    from warp import array

    return value.numpy() if isinstance(value, array) else np.empty(0)
