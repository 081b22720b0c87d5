"""Fixtures for the tests of a plugin package; installed with hts, and imported by every pytest: so nothing heavy here.

hts_kit              robot `tiny`, objective `fake`, selector `plain` and world `known` are plugins during this test
hts_fake_objective   the objective `fake`, hts_tiny_robot the robot `tiny`: the objects themselves
hts_known_world      the world `known` for robot `tiny` and objective `fake`
hts_check            hts_check("my-package"): fails with one line for each thing that `hts check` finds
hts_tiny_run         hts_tiny_run(objective="mine"): a whole run of the smallest size, in seconds
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from hts.api import Run
    from hts.contracts import Objective, Robot, World


@pytest.fixture
def hts_kit() -> Iterator[None]:
    """The kit's plugins are installed while the test runs, for this process and for those that it starts."""
    from hts.testing.packages import kit_installed

    with kit_installed():
        yield


@pytest.fixture
def hts_fake_objective() -> Objective:
    """The objective `fake`: work of the joints, less is better."""
    from hts.testing.examples.objective.objective import Fake

    return Fake()


@pytest.fixture
def hts_tiny_robot() -> Robot:
    """The robot `tiny`: a cart with a model, two joints and a policy that drives at the commanded speed."""
    from hts.testing.examples.robot.robot import Tiny

    return Tiny()


@pytest.fixture
def hts_known_world(hts_tiny_robot: Robot, hts_fake_objective: Objective) -> World:
    """The world `known`: every policy saves exactly 20 % of what the channel `fake_level` shows above 5 W."""
    from hts.testing.known_world import KnownWorld

    return KnownWorld(hts_tiny_robot, [hts_fake_objective], {hts_fake_objective.target.name: 5.0})


@pytest.fixture
def hts_check(hts_kit: None) -> Callable[[str], None]:
    """hts_check(package): what `hts check PACKAGE` does, as an assertion."""
    from hts.plugins import load
    from hts.testing.conformance import check_package

    def check(package: str) -> None:
        lines = [finding.line() for finding in check_package(load(), package) if finding.fault is not None]
        if lines:
            pytest.fail("\n".join(lines), pytrace=False)

    return check


@pytest.fixture
def hts_tiny_run(hts_kit: None, tmp_path: Path) -> Callable[..., Run]:
    """hts_tiny_run(objective="fake", robot="tiny", world="known", selector=None, settings=None): see `tiny_run`."""

    def start(*given: Any, **named: Any) -> Run:
        from hts.testing.tiny_run import tiny_run

        return tiny_run(tmp_path / f"run-{len(list(tmp_path.iterdir()))}", *given, **named)

    return start
