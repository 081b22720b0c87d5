"""A run: Algorithm 1 in `algorithm`, its stages' work in `learning` and `reality`, its bookkeeping in the rest."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hts.config import RunConfig


def start_run(config: RunConfig, out: Path, *, dry_run: bool = False) -> Path:
    """Run into the new folder `out`; returns it. dry_run: only say what it would cost, which needs no heavy library.

    Raises RunError if the folder holds something already; nothing is ever overwritten.
    """
    if dry_run:
        from hts.config_loading import check_names
        from hts.plugins import load
        from hts.run.cost import estimate, print_estimate

        registry = load()
        check_names(config, registry)
        print_estimate(estimate(config, registry))
        return Path(out)
    from hts.run import algorithm

    return algorithm.start(config, Path(out))


def resume_run(folder: Path) -> Path:
    """Go on where a run stopped; a finished run only prints its table again."""
    from hts.run import algorithm

    return algorithm.resume(Path(folder))
