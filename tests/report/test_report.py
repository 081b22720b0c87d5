"""The report of a run, made from a run folder with known contents."""

from __future__ import annotations

import io
import json
import re
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from example_run import write_example_run
from read_page import SMALL, changed, page, text
from rich.console import Console

from hts.contracts import Comparison
from hts.report import figures, write_report
from hts.report.data import read_run
from hts.report.table import print_evaluation, print_table
from hts.testing.made_up_recordings import CostObjective


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    write_example_run(folder, iterations=2, weights=(0.5, 5.0), bounds=(0.2, 1.0), elites=3, block_seconds=30)
    write_report(folder)
    return folder


def test_the_page_shows_improvement_interval_speed_falls_and_segments_of_every_speed(run):
    summary = json.loads((run / "summary.json").read_text())
    shown = text(run)
    for speed, result in summary["final"]["objectives"]["cost"]["speeds"].items():
        low, high = (f"{100 * bound:.1f}" for bound in result["improvement_ci95"])
        gross = f"{100 * result['metrics']['gross_reduction']:.1f} %"
        row = f"{speed} m/s {100 * result['improvement']:.1f} % {low} to {high} % {gross} {float(speed):.2f} m/s"
        assert row in shown
    assert "0 56 (100 %)" in shown


def test_seconds_that_were_left_out_are_told_of_where_there_are_any(run, tmp_path, words_only):
    assert "<th>every second</th>" not in page(run)  # all of them count

    def wanders(summary):
        for speed in summary["final"]["objectives"]["cost"]["speeds"].values():
            speed["valid"] = 0.75
            every = {"improvement": 0.123, "improvement_ci95": [0.101, 0.145]}
            speed["every_second"] = {**every, "mean_speed": 0.83, "reference_mean_speed": 0.8}

    told = changed(tmp_path / "wanders", wanders)
    assert "<th>every second</th>" in page(told) and "<td>12.3 % (10.1 to 14.5 %)</td>" in page(told)

    def of_before(summary):
        wanders(summary)
        for speed in summary["final"]["objectives"]["cost"]["speeds"].values():
            del speed["every_second"]

    assert "<th>every second</th>" not in page(changed(tmp_path / "before", of_before))


def test_the_page_needs_nothing_from_outside(run):
    sources = re.findall(r'(?:src|href)="([^"]*)"', page(run))
    assert sources and all(source.startswith("data:image/svg+xml;base64,") for source in sources)


def test_the_tags_of_the_page_are_balanced(run):
    class Balance(HTMLParser):
        void = ("meta", "img", "br", "link")

        def __init__(self):
            super().__init__()
            self.open = []

        def handle_starttag(self, tag, attrs):
            if tag not in self.void:
                self.open.append(tag)

        def handle_endtag(self, tag):
            assert self.open.pop() == tag

    parser = Balance()
    parser.feed(page(run))
    assert parser.open == []


def test_every_figure_is_there_as_svg_and_pdf(run):
    names = {"improvement", "distribution", "iterations", "sweep", "measurement"}
    assert {path.stem for path in (run / "figures").glob("*.svg")} == names
    assert {path.stem for path in (run / "figures").glob("*.pdf")} == names
    for name in names:
        assert ET.parse(run / "figures" / f"{name}.svg").getroot().tag.endswith("svg")
        assert (run / "figures" / f"{name}.pdf").read_bytes().startswith(b"%PDF")


def test_over_the_iterations_there_is_a_line_for_each_speed(tmp_path):
    summary = write_example_run(tmp_path, **SMALL | {"iterations": 2})
    for number, iteration in enumerate(summary["iterations"]):
        for real in [one["real"]["cost"] for one in iteration["candidates"] if one["real"]]:
            row = {**real.popitem()[1], "improvement_ci95": None}
            real.clear()
            real.update({"0.5": {**row, "improvement": 0.1 + 0.1 * number}, "1.1": {**row, "improvement": 0.4}})
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    (panel,) = figures.iterations(read_run(tmp_path), "cost").axes
    lines = [line.get_ydata() for line in panel.lines if line.get_linestyle() == "-" and any(line.get_ydata())]
    assert sorted(np.round(line, 6).tolist() for line in lines if len(line) > 1) == [[10.0, 20.0], [40.0, 40.0]]


def test_elites_of_the_same_settings_are_told_apart_by_their_ids(tmp_path):
    summary = write_example_run(tmp_path, **SMALL)

    def names() -> set[str]:
        (tmp_path / "summary.json").write_text(json.dumps(summary))
        right = figures.sweep(read_run(tmp_path), "cost").axes[1]
        return {label.get_text().split(" · ")[0] for label in right.get_yticklabels()}

    assert names() == {"λ 1"}
    for candidate in summary["iterations"][0]["candidates"]:
        candidate["kl_bound"] = 0.5
    assert names() == {"1-00", "1-01"}


@pytest.mark.parametrize(
    ("weights", "named"),
    [
        ([[3.19], [3.15]], ["λ 3.15 to 3.19"]),  # each follows its iteration's model
        ([[1.0, 5.0], [1.1, 5.2]], ["λ 1 to 1.1", "λ 5 to 5.2"]),
        ([[1.0, 5.0], [1.0, 5.0]], ["λ 1", "λ 5"]),
        ([[1.0], [0.5, 5.0]], ["λ 0.5", "λ 1", "λ 5"]),
        ([[1.0, 5.0], [5.0, 9.0]], ["λ 1", "λ 5", "λ 9"]),
    ],
)
def test_weights_that_follow_the_models_have_one_colour(tmp_path, weights, named):
    summary = write_example_run(tmp_path, **SMALL | {"iterations": 2})
    for row, iteration in zip(weights, summary["iterations"], strict=True):
        for number, candidate in enumerate(iteration["candidates"]):
            candidate["weights"]["cost"] = row[number % len(row)]
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    (legend,) = figures.sweep(read_run(tmp_path), "cost").legends
    assert [words for label in legend.get_texts() if "λ" in (words := label.get_text())] == named


def test_the_same_run_gives_the_same_files(run):
    before = {path.name: path.read_bytes() for path in (run / "figures").iterdir()} | {"page": page(run).encode()}
    write_report(run)
    after = {path.name: path.read_bytes() for path in (run / "figures").iterdir()} | {"page": page(run).encode()}
    assert [name for name in before if before[name] != after[name]] == []


def test_every_figure_and_column_is_explained(run):
    glossary = text(run).split("What the figures and numbers mean")[1]
    for term in ("Improvement", "95 % interval", "Mean speed", "Falls", "Segment", "KL, c", "λ", "Score in simulation"):
        assert term in glossary
    for term in ("Held-out R²", "Rank correlation", "Segment by segment", "Candidate, elite"):
        assert term in glossary


def test_a_twin_is_called_simulated_and_a_robot_real(run, tmp_path, words_only):
    assert "Simulated reality. No robot was involved" in text(run).replace("  ", " ")
    write_example_run(tmp_path, world="field", **SMALL)
    write_report(tmp_path)
    assert "A real robot." in text(tmp_path) and "Simulated reality" not in text(tmp_path)


@pytest.mark.parametrize(
    ("simulated", "words"),
    [(True, "Simulated reality. No robot was involved"), (False, "A real robot."), (None, "World: lab.")],
)
def test_another_world_is_called_what_it_says_it_is(tmp_path, words_only, simulated, words):
    write_example_run(tmp_path, world="lab", **SMALL)
    summary = json.loads((tmp_path / "summary.json").read_text())
    (tmp_path / "summary.json").write_text(json.dumps({**summary, "world_simulated": simulated}))
    write_report(tmp_path)
    shown = " ".join(text(tmp_path).split())
    assert words in shown
    assert ("Simulated reality" in shown) == (simulated is True)


def test_the_report_says_on_which_reality(tmp_path, words_only):
    write_example_run(tmp_path, world="twin", **SMALL)
    summary = json.loads((tmp_path / "summary.json").read_text())
    identity = {"reality": "dev-03", "reality_sha256": "ab" * 32}
    (tmp_path / "summary.json").write_text(json.dumps({**summary, "world_identity": identity}))
    write_report(tmp_path)
    assert "(Reality dev-03, Reality sha256 abababababab)" in " ".join(text(tmp_path).split())


def test_provenance_is_shown_and_a_long_diff_only_mentioned(run):
    shown = text(run)
    assert "versions / torch 2.13.0" in shown
    assert "commit 4b1c0de" in shown
    assert "diff 5 lines, in provenance.json" in shown


def test_every_candidate_is_listed_with_its_bound(tmp_path, words_only):
    write_example_run(tmp_path, **SMALL)
    write_report(tmp_path)
    assert "1-00 pretrained 1 0.5" in text(tmp_path)
    assert "1-01 pretrained 1 ∞" in text(tmp_path)


def test_a_candidate_that_was_refused_says_why(tmp_path, words_only):
    def refuse(summary):
        summary["iterations"][0]["candidates"][0].update(real=None, refused="1-00: 2 of 36 segments are valid")

    shown = text(changed(tmp_path, refuse))
    assert "refused" in shown and "1-00: 2 of 36 segments are valid" in shown


def test_an_interval_around_zero_is_not_called_an_improvement(tmp_path, words_only):
    def blur(summary):
        for result in summary["final"]["objectives"]["cost"]["speeds"].values():
            result["improvement_ci95"] = [-0.1, 0.4]

    shown = text(changed(tmp_path, blur))
    assert "improves cost" not in shown
    assert "is, for cost, neither clearly better nor clearly worse at 0.5 and 0.8 and 1.1 m/s." in shown


def test_falls_are_told_in_the_first_sentence(tmp_path, words_only):
    def fall(summary):
        summary["final"]["objectives"]["cost"]["speeds"]["0.8"]["falls"] = 2

    assert "It fell 2 times." in text(changed(tmp_path, fall))


@pytest.mark.parametrize(
    ("held", "beside", "said"),
    [
        ({}, {}, "It did not fall."),
        ({"0.5": 2}, {}, "It fell 2 times."),
        ({}, {"0.5": 3}, "It fell 3 times, all at equal commands."),
        ({"0.5": 1}, {"1.1": 3}, "It fell 4 times, 3 of them at equal commands."),
    ],
)
def test_falls_at_speeds_that_are_refused_are_falls(tmp_path, words_only, held, beside, said):
    def fall(summary):
        result = summary["final"]["objectives"]["cost"]
        result["refused_falls"] = held
        result["open_loop"] = {"speeds": {}, "refused_falls": beside}

    assert said in text(changed(tmp_path, fall))


def test_a_run_in_which_nothing_improved_still_has_a_page(tmp_path):
    def nothing(summary):
        summary["final"] = None
        summary["iterations"][0]["best"] = None
        for candidate in summary["iterations"][0]["candidates"]:
            candidate.update(real=None, elite=False)

    folder = changed(tmp_path, nothing)
    assert "ended without a final head-to-head" in text(folder)


def test_the_summary_alone_is_enough(tmp_path):
    summary = write_example_run(tmp_path / "whole", **SMALL)
    alone = tmp_path / "alone"
    alone.mkdir()
    (alone / "summary.json").write_text(json.dumps(summary))
    write_report(alone)
    assert "provenance.json not there" in text(alone)
    assert not (alone / "figures" / "distribution.svg").exists()


def test_an_objective_in_decibels_is_shown_in_decibels(tmp_path):
    class Level(CostObjective):
        name, unit = "level", "dB"

        def compare(self, policy, reference):
            return Comparison(3.0, 3.0, {"peak": 4.0})

    write_example_run(tmp_path, objective=Level(), **SMALL)
    write_report(tmp_path)
    assert "3.00 dB" in text(tmp_path) and "3.00 to 3.00 dB" in text(tmp_path)


def test_a_later_evaluation_is_shown_beside_the_run_s_own(tmp_path, words_only):
    summary = write_example_run(tmp_path, **SMALL)
    result = {"policy": "best", "world": "other", "seed": 3, "objectives": summary["final"]["objectives"]}
    (tmp_path / "evaluation.json").write_text(json.dumps(result))
    write_report(tmp_path)
    assert "policy best against pretrained in world other, seed 3" in text(tmp_path)
    assert "confirms nothing" not in text(tmp_path)


def test_names_from_a_run_cannot_become_markup(tmp_path, words_only):
    def rename(summary):
        summary["robot"] = "<script>alert(1)</script>"

    assert "<script>" not in page(changed(tmp_path, rename))


def test_the_terminal_table_has_one_row_per_speed(run):
    summary = json.loads((run / "summary.json").read_text())
    console = Console(record=True, width=140, file=io.StringIO())
    print_table(summary, console)
    shown = console.export_text()
    for speed, result in summary["final"]["objectives"]["cost"]["speeds"].items():
        row = next(line for line in shown.splitlines() if f"{speed} m/s" in line)
        assert f"{100 * result['improvement']:.1f} %" in row and "56" in row


def test_the_terminal_table_says_that_the_pretrained_policy_stays_the_best():
    console = Console(record=True, width=100, file=io.StringIO())
    print_table({"final": {"policy": "pretrained", "objectives": {}}}, console)
    assert "no candidate measured better than the pretrained policy" in console.export_text()


def test_the_terminal_table_says_when_there_is_nothing():
    console = Console(record=True, width=100, file=io.StringIO())
    print_table({"final": None}, console)
    print_evaluation({"policy": "best", "world": "twin", "objectives": {}}, console)
    assert console.export_text().count("nothing was compared") == 2


def test_a_policy_stands_on_the_front_where_it_counts_with_the_interval_of_what_counts():
    from hts.report.front_figure import counts

    result = {
        "improvement": 0.18,
        "improvement_ci95": [0.17, 0.19],
        "metrics": {"net": 0.18, "per_metre": 0.14},
        "metrics_ci95": {"net": [0.17, 0.19], "per_metre": [0.13, 0.15]},
    }
    assert counts({"selection_scores": {"a": 0.14}}, "a", result) == (0.14, [0.13, 0.15])
    assert counts({"selection_scores": {"a": 0.18}}, "a", result) == (0.18, [0.17, 0.19])
    assert counts({"selection_scores": {"a": 0.11}}, "a", result) == (0.11, None)  # neither: nothing is made up
    assert counts({}, "a", result) == (0.18, [0.17, 0.19])  # a summary of before there were scores
