"""What a GPU, or too little memory, does to a command: one line with what to do. Imports neither torch nor warp."""

from __future__ import annotations

FEWER = (
    "Lower the number of worlds (--set finetune.num_envs=N; of `hts pretrain` --set num_envs=N), train fewer "
    "candidates together (--set finetune.max_candidates=P), or free memory that other programs hold"
)
INSTEAD = "or go without a GPU: --engine mujoco"

MEMORY = (
    "out of memory",
    "failed to allocate",
    "can't allocate memory",
    "cannot allocate memory",
    "std::bad_alloc",
    "failed to map segment from shared object",  # of a library that is loaded only now
)
THREADS = "can't start new thread"
DRIVER = ("driver version is insufficient", "driver on your system is too old", "unsupported ptx", "ptx was compiled")
ABSENT = ("no cuda-capable device", "no nvidia driver", "no cuda gpus are available", "not compiled with cuda")
BROKEN = ("cuda error", "cuda driver error", "cublas_status", "cudnn_status")


def device_fault(error: BaseException | None) -> str | None:
    """What happened on the device and what to do; None if no device is at fault.

    The libraries say so with classes of their own or with a RuntimeError, so the text decides, in this order: memory,
    driver, no device, anything else that CUDA reports.
    """
    while error is not None:
        if isinstance(error, MemoryError):
            return f"Out of memory. {FEWER}."
        if isinstance(error, (RuntimeError, AssertionError, ImportError, OSError)):
            found = _in_text(str(error))
            if found:
                return found
        error = error.__cause__ or error.__context__
    return None


def _in_text(text: str) -> str | None:
    low, first = text.lower(), text.strip().split("\n")[0].rstrip(". ")
    if any(phrase in low for phrase in MEMORY):
        return f"Out of memory ({_short(first)}). {FEWER}."
    if THREADS in low:
        return (
            "The system starts no more threads: memory, or what one user may start, is used up. Raise the limit "
            "(`ulimit -u`, `ulimit -v`), or end other programs."
        )
    if any(phrase in low for phrase in DRIVER):
        return (
            f"The NVIDIA driver is too old for the installed packages ({_short(first)}). Update the driver, {INSTEAD}."
        )
    if any(phrase in low for phrase in ABSENT):
        return f"No CUDA device can be used ({_short(first)}). Install or repair the NVIDIA driver, {INSTEAD}."
    if any(phrase in low for phrase in BROKEN):
        return (
            f"The GPU reported an error ({_short(first)}). Give the command again; if it comes back, look at "
            f"`nvidia-smi` and restart the machine, {INSTEAD}."
        )
    return None


def _short(text: str, most: int = 160) -> str:
    """The first sentences of a library's message, as many as fit."""
    if len(text) <= most:
        return text
    kept = text[:most].rsplit(". ", 1)[0]
    return kept if len(kept) < most else text[:most].rsplit(" ", 1)[0] + " …"
