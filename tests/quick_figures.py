"""Reports of runs that are not about their report: `-p quick_figures` where this folder is searched for modules.

Each figure is an SVG only, its axes where they stand: the search for a layout and the PDF with its fonts are most of
the work of a report, which is a third of a small run.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from hts.report import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def saved_quickly(drawing: Figure, folder: Path, name: str) -> Path:
    """`hts.report.style.save`, quicker."""
    drawing.set_layout_engine(None)
    folder.mkdir(parents=True, exist_ok=True)
    drawing.savefig(folder / f"{name}.svg", metadata={"Date": None})
    return folder / f"{name}.svg"


@contextmanager
def drawn_quickly() -> Iterator[None]:
    """Figures of reports that this process makes meanwhile."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "save", saved_quickly)
        yield


@pytest.fixture(autouse=True, scope="module")
def quick_figures(request: pytest.FixtureRequest) -> Iterator[None]:
    """In tests of the report, and in processes of their own, figures are drawn as users get them."""
    with nullcontext() if request.path.parent.name == "report" else drawn_quickly():
        yield
