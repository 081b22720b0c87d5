"""A run loads what is installed once, and hands it to everything that makes something of it."""

from __future__ import annotations

import pytest

from hts import plugins
from hts.contracts import WorldContext
from hts.testing import tiny_run


@pytest.mark.slow
def test_a_whole_run_asks_every_plugin_once(hts_tiny_run, monkeypatch):
    asked, before = [], plugins.load()
    monkeypatch.setattr(tiny_run, "load_plugins", lambda: before)  # it looks at the robot's task before the run begins
    offers = plugins._offers
    monkeypatch.setattr(plugins, "_offers", lambda point, package: asked.append(point.value) or offers(point, package))
    hts_tiny_run(settings={"robot.name": "tiny"})
    assert "hts.builtin" in asked and len(asked) == len(set(asked))


def test_a_world_asks_the_registry_that_it_was_given(hts_kit, tmp_path, monkeypatch):
    registry = plugins.load()
    monkeypatch.setattr(plugins, "load", None)  # nobody may call it
    context = WorldContext("tiny", {}, {"fake": {}}, seed=0, folder=tmp_path, registry=registry)
    world = registry.make_world("known", {}, context)
    assert dict(world.idle()) and world.simulated is True
    world.on_progress(lambda share: None)
    assert world.head_to_head_seconds() == 320.0  # four blocks of 80 s: it does not say otherwise
