"""What a reader who has the page alone must not take for something else."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path

import pytest
from example_run import write_example_run
from read_page import SMALL, changed, page, text
from rich.console import Console

from hts.report import figures, write_report
from hts.report.data import RunData, read_run
from hts.report.measurement_figure import measurement
from hts.report.page import _flat, figure_note
from hts.report.style import embedded
from hts.report.table import print_table


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    write_example_run(folder, **SMALL)
    return folder


def test_no_figure_or_heading_of_a_twin_reads_like_a_robots(run, tmp_path, words_only):
    write_report(run)
    assert "<h1>Cost on example in simulated reality</h1>" in page(run)
    assert "tried in simulated reality" in page(run) and "samples from simulated reality" in text(run)
    twin, field = read_run(run), tmp_path / "field"
    write_example_run(field, world="field", **SMALL)
    assert figure_note(twin) == "simulated reality (twin): no robot" and figure_note(read_run(field)) == ""
    titles = [axes.get_title() or axes.title.get_text() for axes in figures.sweep(twin, "cost").axes]
    assert not any("in reality" in one for one in titles)
    drawing = figures.sweep(twin, "cost")
    shown = embedded(drawing, tmp_path, "sweep", "Sweep", "Left and right.", figure_note(twin))
    assert drawing.get_suptitle() == figure_note(twin)
    assert shown["alt"] == "Sweep, simulated reality (twin): no robot; described below"


def test_a_speed_that_could_not_be_compared_at_equal_commands_says_why(tmp_path, words_only):
    def beside(summary):
        result = summary["final"]["objectives"]["cost"]
        result["open_loop"] = {"speeds": {}, "refused": {"0.5": "Head-to-head at 0.5 m/s: nobody walked."}}

    assert "Head-to-head at 0.5 m/s: nobody walked." in text(changed(tmp_path, beside))


def test_a_final_at_one_speed_is_not_said_of_every_speed(tmp_path, words_only):
    def one(summary):
        result = summary["final"]["objectives"]["cost"]
        result["speeds"] = {"0.8": result["speeds"]["0.8"]}

    shown = text(changed(tmp_path, one))
    assert "% at 0.8 m/s. It did not fall" in shown and "at every speed tested" not in shown


def test_seconds_that_counted_stand_beside_their_speed_where_they_differ(tmp_path, words_only):
    def several(summary):
        for row in summary["iterations"][0]["candidates"]:
            for speeds in (row["real"] or {}).values():
                (first,) = speeds.values()
                speeds |= {"0.5": {**first, "segments": 11}, "1.1": {**first, "segments": 11}}

    assert re.search(r"<td>\d+<br>11<br>11</td>", page(changed(tmp_path, several)))


def test_versions_of_many_packages_are_one_line():
    many = {f"package-{number}": "1.0" for number in range(9)}
    ((key, shown),) = _flat({"packages": many})
    assert key == "packages" and shown.startswith("package-0 1.0, package-1 1.0, ")
    assert len(list(_flat({"hardware": {"cores": 2, "system": "Linux"}}))) == 2


def test_a_few_seconds_are_drawn_large_and_dark_enough_to_be_seen(tmp_path):
    few = {"0.8": {"policy": {"cost": [2.0, 3.0]}, "reference": {"cost": [4.0, 5.0]}}}
    data = RunData(tmp_path, {}, {}, {}, {}, {"cost": few}, {})
    assert {marks.get_alpha() for marks in figures.distribution(data, "cost").axes[0].collections} == {0.9}


def test_of_a_model_of_which_nothing_is_known_there_is_no_empty_figure(tmp_path):
    models = {"cost": {"dataset": "ab", "held_out_r2": None, "rank_correlation": None}}
    summary = {"objectives": ["cost"], "iterations": [{"index": 0, "measurement_models": models}]}
    assert measurement(RunData(tmp_path, summary, {}, {}, {}, {}, {}), "cost") is None


def test_the_legend_of_the_measurement_model_lies_beside_its_lines(run):
    drawing = measurement(read_run(run), "cost")
    assert drawing.legends and all(axes.get_legend() is None for axes in drawing.axes)
    sizes = [line.get_markersize() for line in drawing.axes[0].get_lines() if line.get_label()[0] != "_"]
    assert sizes == sorted(set(sizes), reverse=True)  # the same number twice shows both


def test_a_metric_has_the_unit_that_its_objective_says(tmp_path, words_only):
    def in_watts(summary):
        result = summary["final"]["objectives"]["cost"]
        result["metric_units"] = {"watts": "W"}
        for speed in result["speeds"].values():
            speed["metrics"] |= {"watts": 80.0, "steps": 7.0}

    folder = changed(tmp_path, in_watts)
    assert "<th>Watts, W</th>" in page(folder) and "<th>Steps</th>" in page(folder)
    console = Console(width=200, file=io.StringIO())
    print_table(json.loads((folder / "summary.json").read_text()), console)
    assert "watts, W" in console.file.getvalue()


@pytest.mark.parametrize(
    ("units", "named"),
    [
        ({"cost": "1"}, "Cost / pretrained mean"),
        ({"cost": "J"}, "Cost − pretrained mean, J"),
        ({}, "Cost − pretrained mean"),
    ],
)
def test_seconds_are_drawn_in_the_unit_of_what_is_scored(tmp_path, units, named):
    speeds = {"0.8": {"policy": {"cost": [2.0, 3.0]}, "reference": {"cost": [4.0, 5.0]}}}
    final = {"policy": "00-00", "objectives": {"level": {"unit": "dB(A)", "metric_units": units, "speeds": {}}}}
    data = RunData(tmp_path, {"final": final}, {}, {}, {}, {"level": speeds}, {})
    assert figures.distribution(data, "level").axes[0].get_ylabel() == named


def test_a_later_evaluation_that_walked_the_final_again_says_so(tmp_path, words_only):
    summary = write_example_run(tmp_path, **SMALL)
    result = {"policy": "best", "world": "twin", "seed": summary["seed"], "objectives": summary["final"]["objectives"]}
    (tmp_path / "evaluation.json").write_text(json.dumps(result))
    write_report(tmp_path)
    assert "so it is the same walk again and confirms nothing" in text(tmp_path)


def test_a_figure_that_is_longer_than_a_sheet_is_printed_smaller_not_cut(run, words_only):
    write_report(run)
    print_rules = page(run).split("@media print", 1)[1].split("</style>", 1)[0]
    assert re.search(r"figure img \{ max-height: \d+mm; object-fit: contain;", print_rules)


def test_what_was_promised_of_a_candidate_stands_beside_what_was_measured(tmp_path, words_only):
    def promised(summary):
        for row in summary["iterations"][0]["candidates"][:1]:
            row["predicted"] = {"cost": {"0.8": {"improvement": 0.123}}}

    folder = changed(tmp_path, promised)
    assert "<th>predicted improvement</th>" in page(folder) and "<td>12.3 %</td>" in page(folder)


def test_without_promises_there_is_no_column_of_them(run, words_only):
    write_report(run)
    assert "<th>predicted improvement</th>" not in page(run)
