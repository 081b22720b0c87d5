"""An objective's own λ behind the model of an iteration."""

from __future__ import annotations

import json
import shutil
from types import SimpleNamespace

import pytest

from hts import plugins
from hts.api import load, resume
from hts.errors import PluginError
from hts.run.learning import own_weights_of
from hts.testing.checks.made_up import walk
from hts.testing.examples.objective.objective import Fake
from hts.testing.packages import kit_installed, on_path, write_package
from hts.testing.tiny_run import tiny_run

PLUGIN = '''
from hts import hookimpl
from hts.testing.examples.objective.objective import Fake

HTS_API = 2


class Spread(Fake):
    """λ of one worth behind every sensor: a share of its standard deviation; where `few`, too few."""

    def __init__(self, name, few):
        super().__init__()
        self.name, self.few, self.weights = name, few, (1.0, 2.0)

    def weights_for(self, spread, recordings):
        assert recordings and {one.role for one in recordings} <= {"collection", "reference", "policy"}
        return (spread,) if self.few else (spread, 3 * spread)


@hookimpl
def hts_objectives(register):
    register("spread", lambda settings: Spread("spread", False))
    register("few", lambda settings: Spread("few", True))
'''


@pytest.fixture(autouse=True)
def installed(tmp_path):
    package = write_package(tmp_path / "site", "spread-demo", {"spread_demo.py": PLUGIN}, {"spread": "spread_demo"})
    with kit_installed(), on_path(package):
        yield


def weights_of(run, iteration: int = 0) -> list[float]:
    return [one["weights"]["spread"] for one in run.summary["iterations"][iteration]["candidates"]]


def test_candidates_get_the_weights_that_the_objective_gives_behind_the_fitted_model(tmp_path):
    run = tiny_run(tmp_path / "run", "spread", settings={"sweep.weights.spread": None})
    low, high = weights_of(run)
    assert high == pytest.approx(3 * low) and low not in (1.0, 2.0)


def test_weights_that_a_configuration_names_are_taken_as_they_are(tmp_path):
    run = tiny_run(tmp_path / "run", "spread", settings={"sweep.weights.spread": [0.7]})
    assert weights_of(run) == [0.7]


def test_nobody_asks_for_weights_that_the_configuration_names(tmp_path):
    """A fault in them stops no run that does not need them."""
    run = tiny_run(tmp_path / "run", "few", settings={"sweep.weights.few": [0.7]})
    assert "weights" not in json.loads((run.folder / "iterations/00/fit.json").read_text())["few"]


def test_a_run_that_an_earlier_version_began_keeps_its_weights(tmp_path):
    settings = {"sweep.weights.spread": None, "iterations": 2, "sweep.anchors": ["pretrained"]}
    run = tiny_run(tmp_path / "run", "spread", settings=settings)
    fit = json.loads((run.folder / "iterations/00/fit.json").read_text())
    del fit["spread"]["weights"]
    (run.folder / "iterations/00/fit.json").write_text(json.dumps(fit))
    shutil.rmtree(run.folder / "iterations/01")
    for name in ("summary.json", "final.json", "confirm.json"):
        (run.folder / name).unlink(missing_ok=True)
    resume(run.folder)
    assert weights_of(load(run.folder), 1) == [1.0, 2.0]


def test_a_sample_that_no_machine_makes_is_not_among_the_data():
    """As the model was fitted: one glitch would move a mean current by half of it."""
    seen = []

    class Keeps(Fake):
        def weights_for(self, spread, recordings):
            seen.extend(recordings)
            return self.weights

    objective, registry = Keeps(), plugins.load()
    recordings = [walk(objective, registry, seed=seed) for seed in range(2)]
    target = objective.target.name
    recordings[0].channels[target].values[50] = 65_535.0
    own_weights_of(objective, SimpleNamespace(target_std=1.0), recordings)
    assert max(float(one.values(target).max()) for one in seen) < 1000.0


def test_too_few_weights_end_in_one_line(tmp_path):
    with pytest.raises(PluginError, match="'few': weights_for gave .* as many finite λ of at least 0"):
        tiny_run(tmp_path / "run", "few", settings={"sweep.weights.few": None})


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (lambda: 0.5, "TypeError: 'float' object is not iterable"),
        (lambda: 1 / 0, "ZeroDivisionError: division by zero"),
    ],
)
def test_weights_that_cannot_be_had_end_in_one_line(given, said, monkeypatch):
    objective, registry = Fake(), plugins.load()
    recordings = [walk(objective, registry, seed=0)]
    monkeypatch.setattr(objective, "weights_for", lambda spread, known: given())
    with pytest.raises(PluginError, match=rf"^Objective 'fake': weights_for\(\) failed, {said}"):
        own_weights_of(objective, SimpleNamespace(target_std=1.0), recordings)
