"""The robot of these tests, and what is drawn of a reality. Helpers are found beside the tests."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from hts import plugins
from hts.worlds.realities.ranges import drawn_parameters

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="module")
def registry():
    return plugins.load()


@pytest.fixture(scope="module")
def robot(registry):
    return registry.make_robot("go1")


@pytest.fixture(scope="module")
def parameters(registry):
    return drawn_parameters(registry)


@pytest.fixture
def run(tmp_path) -> Path:
    (tmp_path / "config.yaml").write_text("preset: smoke\n")
    return tmp_path


@pytest.fixture
def policy(tmp_path, robot) -> Path:
    from hts.policies.export import to_onnx
    from hts.policies.files import load_policy

    return to_onnx(load_policy(robot.pretrained_policy()), tmp_path / "walk.onnx")
