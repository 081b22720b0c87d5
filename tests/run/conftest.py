"""Runs that differ in their ends only share what comes before."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from hts.api import Run, load
from hts.run import resume_run
from hts.run.stages import Stages
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run


class StoppedHere(Exception):
    """As somebody stops a run."""


def stop_before(stage: str, path: Path, settings: Mapping[str, Any], options: Mapping[str, Any]) -> None:
    """`tiny_run` into `path`, stopped where `stage` would begin."""
    do = Stages.do

    def begin(self: Stages, name: str, *rest: Any) -> Any:
        if name == stage:
            raise StoppedHere
        return do(self, name, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Stages, "do", begin)
        with pytest.raises(StoppedHere):
            tiny_run(path, settings=settings, **options)


@pytest.fixture(scope="module")
def run_on(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Run]:
    """run_on("iterations/00/gate", path, settings, selector=None): a tiny run with the kit's plugins, of which what
    comes before that stage is made once for all runs of the module with these settings: for tests that change nothing
    that happens earlier. It is a copy that was stopped there and goes on."""
    made: dict[str, Path] = {}

    def run(stage: str, path: Path, settings: Mapping[str, Any], **options: Any) -> Run:
        key = json.dumps([stage, settings, options], sort_keys=True)
        with kit_installed():
            if key not in made:
                folder = tmp_path_factory.mktemp("stopped") / "run"
                stop_before(stage, folder, settings, options)
                made[key] = folder
            shutil.copytree(made[key], path)
            resume_run(path)
        return load(path)

    return run


@pytest.fixture(scope="session")
def finished(kit_run: Any) -> Run:
    """A tiny run with the kit's plugins; nobody may write into its folder."""
    return load(kit_run.folder)
