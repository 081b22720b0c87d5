"""Which engine a run gets: the one that was asked for if it can work here, with `auto` the fastest that can;
and making it."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from hts.engines import check_engine
from hts.errors import ConfigError

if TYPE_CHECKING:
    import mujoco

    from hts.sim.engine import Engine


def select_engine(name: str, device: str = "auto", tell: Callable[[str], None] | None = None) -> str:
    """`mujoco` or `warp`: what `name` stands for on this machine.
    `auto` is `warp` where CUDA and the package are there.

    device: where the engine is to run, as `EnvConfig.device`; tell: gets one line if a GPU is there and `auto` cannot
    use it. Raises ConfigError, one line with what to do, for an engine nobody knows or one that cannot work here; so
    call it before anything is spent.
    """
    check_engine(name)
    if name == "mujoco" or (name == "auto" and device == "cpu"):  # warp on a CPU is for tests, nobody's first choice
        return "mujoco"
    if name == "auto" and not has_driver():  # known without torch, which takes seconds to load
        return "mujoco"
    try:
        require_warp(device)
    except ConfigError as error:
        if name == "warp":
            raise
        import torch

        if tell is not None and torch.cuda.is_available():
            tell(f"A GPU is here and the engine is mujoco all the same: {error}")
        return "mujoco"
    return "warp"


def has_driver() -> bool:
    """Whether NVIDIA's driver library is installed."""
    try:
        ctypes.CDLL("nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1")
    except OSError:
        return False
    return True


def require_warp(device: str = "auto") -> None:
    """Raises ConfigError where the warp engine cannot work: no CUDA, an old driver, or the package is missing."""
    from hts.sim.warp_setup import import_warp, torch_device, warp_device

    place = torch_device(device)
    warp, _ = import_warp()
    warp_device(warp, place)


def make_engine(
    name: str, models: Sequence[mujoco.MjModel], assignment: Sequence[int], substeps: int, **options: Any
) -> Engine:
    """The engine called `name`; "auto" is the fastest that works here (see `select_engine`).

    models: M compiled variants of one robot that differ in numbers only; assignment (W,): variant of each world.
    Raises ConfigError for an unknown engine or one whose package or device is missing.
    """
    check_engine(name)
    if name == "auto":
        name = select_engine(name, options.get("device", "auto"))
    if name == "mujoco":
        from hts.sim.mujoco_engine import MujocoEngine

        return MujocoEngine(models, assignment, substeps, threads=options.get("threads", 0))
    from hts.sim.warp_engine import make_warp_engine

    return make_warp_engine(
        models,
        assignment,
        substeps,
        device=options.get("device", "auto"),
        contacts_per_world=options.get("contacts_per_world", 0),
        constraints_per_world=options.get("constraints_per_world", 0),
        keep_physics_steps=options.get("keep_physics_steps", False),
    )
