"""Finds the compiled steps of `kernel.py`, and does without where a machine cannot have them.

numba compiles once a machine and keeps the result beside the module, or, where that folder cannot be written, in the
user's cache folder (the environment variable NUMBA_CACHE_DIR names another). Where neither can be written, each process
of a twin compiles for itself, which takes some seconds.
"""

from __future__ import annotations

import ctypes
import logging
from functools import cache
from pathlib import Path
from types import ModuleType

SYMBOLS = ("mj_step", "mj_setState", "mj_getState")
LIBRARIES = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")


@cache
def load() -> ModuleType | None:
    """`kernel.py`; None, and a line in the log, where numba or the engine cannot be loaded."""
    try:
        _name_engine()
        from hts.worlds.twin import kernel
    except (ImportError, OSError, AttributeError) as error:
        logging.getLogger(__name__).warning(
            "The twin runs at less than half its speed, with the same results: its steps could not be compiled "
            "(%s: %s). Install numba and mujoco as hts's constraints.txt has them.",
            type(error).__name__,
            error,
        )
        return None
    return kernel


def _name_engine() -> None:
    """Makes the engine's functions known to compiled code by their names. Raises OSError or AttributeError where they
    are not to be had."""
    import llvmlite.binding as llvm
    import mujoco

    folder = Path(mujoco.__file__).parent
    paths = [path for pattern in LIBRARIES for path in sorted(folder.glob(pattern))]
    if not paths:
        raise OSError(f"no library of the engine in {folder}")
    library = ctypes.CDLL(str(paths[0]))  # loaded already: this is the one that the engine's Python module uses
    for name in SYMBOLS:
        llvm.add_symbol(name, ctypes.cast(getattr(library, name), ctypes.c_void_p).value)
