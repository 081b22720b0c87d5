"""Two objectives in one run, on a world in which what each policy gains is known before.

The world asks each policy which λ it was made with. Whoever was rewarded for one objective saves 20 % of it and loses
5 % of the other; for both, 12 % of each. A second iteration saves half as much again as the first.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from hts import api
from hts.config_loading import load_config
from hts.errors import ConfigError, RunError
from hts.testing.packages import kit_installed, on_path, write_package

PLUGIN = '''
"""Objectives `calm` and `cheap`, and the world that knows both."""

from hts import hookimpl

HTS_API = 2


@hookimpl
def hts_objectives(register):
    register("calm", lambda settings: make("calm"))
    register("cheap", lambda settings: make("cheap"))


@hookimpl
def hts_worlds(register):
    register("exchange", make_exchange)


def make(called):
    from hts.channels import Channel
    from hts.config import Named
    from hts.testing.examples.objective.objective import Fake

    class Toy(Fake):
        name = called
        target = Channel(f"{called}_level", "W", (), "what this one costs")
        instrument = None

        def measurement_model(self):
            return Named(name="lstm", hidden=8 if called == "calm" else 6)  # or both are paid alike, to the bit

        def score(self, segments):
            measured = segments.values(self.target.name).mean(axis=1)
            return {"net": measured - segments.idle(self.target.name), "gross": 1.0 + 0 * segments.speed}

    return Toy()


def make_exchange(settings, context):
    from two_objectives_world import Exchange

    return Exchange(context, **settings)
'''

WORLD = """
from hts.contracts import World
from hts.policies.deploy import DeployedPolicy
from hts.recordings.recording import Series
from hts.testing.known_world import make_known


class Exchange(World):
    name = "exchange"
    simulated = True

    def __init__(self, context, better=1.5):
        self.known, self.better = make_known({"saving": 0.0}, context), better

    def idle(self):
        return self.known.idle()

    def collect(self, policies, schedule):
        return [recording.replace(world=self.name) for recording in self.known.collect(policies, schedule)]

    def head_to_head(self, policy, reference, speeds):
        made = DeployedPolicy(policy).card.made
        weights = made["weights"]
        alone = {name: weight for name, weight in weights.items() if weight}
        gains = {name: (0.12 if len(alone) == 2 else 0.2 if name in alone else -0.05) for name in weights}
        gains = {name: gain * self.better ** made["iteration"] if gain > 0 else gain for name, gain in gains.items()}
        return [self._charged(recording, gains) for recording in self.known.head_to_head(policy, reference, speeds)]

    def _charged(self, recording, gains):
        channels = dict(recording.channels)
        for name, gain in gains.items() if recording.role == "policy" else ():
            channel = f"{name}_level"
            idle, series = recording.idle[channel], channels[channel]
            channels[channel] = Series(series.channel, idle + (series.values - idle) * (1 - gain))
        return recording.replace(world=self.name, channels=channels)
"""


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def two_objectives(tmp_path_factory) -> Iterator[None]:
    folder = tmp_path_factory.mktemp("installed")
    files = {"two_objectives.py": PLUGIN, "two_objectives_world.py": WORLD}
    write_package(folder, "two-objectives", files, {"two": "two_objectives"})
    with kit_installed(), on_path(folder):
        yield


@pytest.fixture(scope="module")
def run(two_objectives, tmp_path_factory) -> Path:
    from hts.testing.tiny_run import tiny_run

    folder = tmp_path_factory.mktemp("several") / "run"
    settings = {
        **{f"sweep.weights.{name}": [0.0, 1.0] for name in ("calm", "cheap")},
        "sweep.anchors": ["front"],
        "iterations": 2,
        "selection.elites": 3,
    }
    tiny_run(folder, ["calm", "cheap"], world="exchange", settings=settings)
    return folder


def summary_of(folder: Path) -> dict:
    return json.loads((folder / "summary.json").read_text())


ALONE, BOTH, OTHER = 0.2 * 1.5, 0.12 * 1.5, -0.05  # savings of the second iteration


def test_every_combination_of_weights_but_all_zero_is_trained(run):
    for iteration in summary_of(run)["iterations"]:
        assert [tuple(candidate["weights"].values()) for candidate in iteration["candidates"]] == [
            (0.0, 1.0),
            (1.0, 0.0),
            (1.0, 1.0),
        ]


def test_each_objective_has_a_measurement_model_and_a_score_in_simulation(run):
    for iteration in summary_of(run)["iterations"]:
        assert set(iteration["measurement_models"]) == {"calm", "cheap"}
        assert set(iteration["pretrained_sim_scores"]) == {"calm", "cheap"}
        for candidate in iteration["candidates"]:
            assert set(candidate["sim_scores"]) == {"calm", "cheap"}
            assert candidate["sim_score"] == pytest.approx(sum(candidate["sim_scores"].values()))


def test_the_measured_front_holds_the_three_that_nothing_beats_over_all_iterations(run):
    front = {entry["id"]: entry for entry in summary_of(run)["front"]["real"]}
    assert set(front) == {"01-00", "01-01", "01-02"}  # the first iteration's are each beaten by its own successor
    known = {"01-00": (OTHER, ALONE), "01-01": (ALONE, OTHER), "01-02": (BOTH, BOTH)}
    for name, (calm, cheap) in known.items():
        gains = front[name]["improvements"]
        assert front[name]["iteration"] == 1
        assert gains["calm"]["improvement"] == pytest.approx(calm, abs=1e-4)
        assert gains["cheap"]["selection_score"] == pytest.approx(cheap, abs=1e-4)
        low, high = gains["cheap"]["improvement_ci95"]
        assert low - 1e-6 <= gains["cheap"]["improvement"] <= high + 1e-6


def test_the_simulated_front_of_each_iteration_is_told_by_ids(run):
    simulation = summary_of(run)["front"]["simulation"]
    assert [entry["iteration"] for entry in simulation] == [0, 1]
    for index, entry in enumerate(simulation):
        known = {"pretrained", *(candidate["id"] for candidate in summary_of(run)["iterations"][index]["candidates"])}
        assert entry["ids"] and set(entry["ids"]) <= known


def test_the_best_is_the_compromise_and_the_final_head_to_head_has_both_objectives(run):
    summary = summary_of(run)
    assert [iteration["best"] for iteration in summary["iterations"]] == ["00-02", "01-02"]
    assert summary["final"]["policy"] == "01-02"
    assert set(summary["final"]["objectives"]) == {"calm", "cheap"}
    for entry in summary["final"]["objectives"].values():
        for result in entry["speeds"].values():
            assert result["improvement"] == pytest.approx(BOTH, abs=1e-4)


def test_each_combination_of_weights_goes_on_from_the_policy_that_went_furthest_in_its_direction(run):
    first, second = summary_of(run)["iterations"]
    assert {candidate["anchor"] for candidate in first["candidates"]} == {"pretrained"}
    assert [candidate["anchor"] for candidate in second["candidates"]] == ["00-00", "00-01", "00-02"]


def test_the_report_shows_the_front_as_figure_words_and_table(run):
    page = (run / "report.html").read_text()
    assert "3 of 6 policies tried in simulated reality are beaten by no other in calm and cheap together." in page
    assert "01-02 (final)" in page and "1 calm + 1 cheap" in page
    assert (run / "figures" / "front.svg").is_file()


def test_the_table_at_the_end_shows_the_front(run, capsys):
    from rich.console import Console

    from hts.report.table import print_table

    print_table(summary_of(run), Console(width=100))
    shown = capsys.readouterr().out
    assert "front: beaten by no other" in shown
    (row,) = [line for line in shown.splitlines() if line.strip().startswith("01-01")]
    assert f"{100 * ALONE:.1f} %" in row and f"−{100 * -OTHER:.1f} %" in row


def test_stopped_before_the_second_iteration_it_goes_on_from_the_same_front(run, tmp_path):
    from hts import api

    again = Path(shutil.copytree(run, tmp_path / "again"))
    for stage in ("finetune", "simulate", "test"):
        (again / f"iterations/01/{stage}.json").unlink()
    for stage in ("final", "summary"):
        (again / f"{stage}.json").unlink()
    api.resume(again)  # its report is there still, and drawing it shows nothing here
    whole, resumed = summary_of(run), summary_of(again)
    assert {**resumed, "wall_seconds": 0} == {**whole, "wall_seconds": 0}


@pytest.mark.parametrize(
    ("stage", "keys"),
    [
        ("iterations/01/test", ("results", "01-01", "real")),
        ("iterations/01/test", ("results", "01-01", "tested", "selection_score")),
        ("iterations/01/simulate", ("objective_scores", "01-01")),
        ("iterations/01/fit", ()),
        ("final", ("objectives",)),
    ],
)
def test_a_stage_that_lacks_one_of_the_objectives_is_named(run, tmp_path, stage, keys):
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    (folder / "summary.json").unlink()
    path = folder / f"{stage}.json"
    found = part = json.loads(path.read_text())
    for key in keys:
        part = part[key]
    del part["cheap"]
    path.write_text(json.dumps(found))
    with pytest.raises(RunError, match=rf"^{path}: damaged \(nothing about cheap") as caught:
        api.resume(folder)
    assert "Delete it and resume" in str(caught.value) and "\n" not in str(caught.value)


def test_a_fall_in_reality_keeps_a_policy_off_the_front(two_objectives, run):
    from hts.plugins import load
    from hts.run.front import real_front
    from hts.run.job import Job

    class Told(Job):
        """A finished run in which the compromise of the second iteration fell."""

        def read(self, stage, iteration=None):
            result = super().read(stage, iteration)
            if (stage, iteration) == ("test", 1):
                result["results"]["01-02"]["tested"]["fell"] = True
            return result

    from hts.config_loading import read_config

    job = Told(read_config(run / "config.yaml"), run, load(), None)
    # Then the first iteration's compromise is beaten by nobody: 12 % of each.
    assert {policy.id for policy in real_front(job, 2)} == {"01-00", "01-01", "00-02"}


# ----------------------------------------------------------------------------------------------- what is chosen


def config(*objectives: str, **given):
    return load_config(objectives=objectives, robot="hopper", **given)


@pytest.mark.parametrize("preset", ["smoke", "quick", "paper"])
def test_several_objectives_choose_the_selector_made_for_them(preset):
    assert config("calm", "cheap", preset=preset).selection.selector.name == "pareto"
    assert config("calm", preset=preset).selection.selector.name == "hierarchical"


def test_several_objectives_keep_the_shorter_iterations_of_paper_and_what_its_baseline_had():
    one, several = config("calm", preset="paper"), config("calm", "cheap", preset="paper")
    assert (one.iterations, one.finetune.steps) == (4, 30_000_000)
    assert (several.iterations, several.finetune.steps) == (5, 10_000_000)
    baselines = config("calm", preset="paper", baseline=True), config("calm", "cheap", preset="paper", baseline=True)
    assert [(one.finetune.steps, one.selection.elites) for one in baselines] == [(7_500_000, 12), (3_125_000, 15)]
    assert (one.finetune.renew_noise, one.sweep.kl_bounds, one.sweep.trust_region.most) == (True, (40.0,), 100.0)
    assert several.sweep.kl_bounds == (16.0,)
    assert (one.gate.nearer_for, one.gate.nearer) == ("first", (0.75, 0.5, 0.25))
    for kept in (several, *baselines):
        assert not kept.finetune.renew_noise and kept.sweep.trust_region.most == 40.0
        assert (kept.gate.nearer, kept.finetune.env.randomisation.models) == ((0.5, 0.25), 32)
        assert kept.gate.nearer_for == "nobody"
    seeing = config("calm", preset="paper", oracle=True)
    assert not seeing.finetune.renew_noise and seeing.gate.nearer_for == "nobody"
    exact = config("calm", "cheap", preset="paper-exact")
    assert (exact.iterations, exact.finetune.steps) == (4, 4_000_000)


def test_a_selector_that_is_asked_for_is_kept(tmp_path):
    named = config("calm", "cheap", overrides=["selection.selector.name=hierarchical"])
    assert (named.selection.selector.name, named.selection.elites) == ("hierarchical", 6)
    file = tmp_path / "mine.yaml"
    file.write_text("objectives: {calm: {}, cheap: {}}\nselection: {elites: 2}\n")
    several = load_config(file=file, robot="hopper")
    assert (several.selection.selector.name, several.selection.elites) == ("pareto", 2)
    assert load_config(file=file, objectives=["calm"], robot="hopper").selection.selector.name == "hierarchical"


def test_weights_that_leave_nothing_to_learn_from_are_refused():
    with pytest.raises(ConfigError, match="every λ is 0"):
        config("calm", "cheap", overrides=["sweep.weights={calm: [0], cheap: [0.0]}"])
    assert config("calm", "cheap", overrides=["sweep.weights.calm=[0]"]).sweep.weights == {"calm": (0.0,)}


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("-1", "is not a number of at least 0"),
        (".nan", "weights.calm.0: expected a finite number"),
        (".inf", "weights.calm.0: expected a finite number"),
    ],
)
def test_a_weight_is_a_number_of_at_least_zero(value, said):
    with pytest.raises(ConfigError, match=said):
        config("calm", overrides=[f"sweep.weights.calm=[{value}]"])


def test_an_anchor_that_nobody_knows_is_refused():
    with pytest.raises(ConfigError, match="'best', 'pretrained' or 'front'"):
        config("calm", overrides=["sweep.anchors=[bset]"])


def test_a_dry_run_lists_the_combinations_and_the_selector(two_objectives):
    from hts.plugins import load
    from hts.run.cost import estimate

    given = load_config(objectives=["calm", "cheap"], robot="tiny", preset="quick")
    cost = estimate(given, load())
    assert cost["selector"] == "pareto"
    assert cost["combinations"].split(", ")[::3] == ["0.5 calm", "0.5 cheap", "0.5 calm + 0.5 cheap"]
    assert cost["candidates"] == 2 * 9 and cost["tested on the robot"] == 2 * 6


def test_who_fell_in_a_second_trial_or_in_a_final_is_off_the_front(run):
    from hts.config_loading import read_config
    from hts.plugins import load
    from hts.run.front import real_front
    from hts.run.job import Job
    from hts.run.summary import fell_later

    again = {"results": {"a": {"tested": {"fell": True}}, "b": {"refused_falls": {"0.8": 1}}, "c": {"tested": None}}}
    walked, open_loop = {"speeds": {"0.8": {"falls": 0}}}, {"speeds": {"0.8": {"falls": 1}}}
    given_up = [{"policy": "e", "falls": 2}, {"policy": "f", "falls": 0}]
    final = {"policy": "d", "objectives": {"fake": walked | {"open_loop": open_loop}}, "given_up": given_up}
    assert fell_later(again, final) == {"a", "b", "d", "e"}
    assert fell_later(None, {"policy": "d", "objectives": {"fake": walked}}) == set()

    job = Job(read_config(run / "config.yaml"), run, load(), None)
    assert {policy.id for policy in real_front(job, 2, {"01-02"})} == {"01-00", "01-01", "00-02"}
