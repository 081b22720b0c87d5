"""Folders that no report can be made of: files that are missing, cut off, or not what a run writes."""

from __future__ import annotations

import json

import pytest
from example_run import write_example_run
from read_page import SMALL

from hts.errors import RunError
from hts.report import write_report
from hts.report.data import read_run


def test_an_unfinished_run_says_how_to_go_on(tmp_path):
    (tmp_path / "config.yaml").write_text("preset: quick\n")
    with pytest.raises(RunError, match="not finished .* `hts resume"):
        write_report(tmp_path)


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(RunError, match="holds no run"):
        write_report(tmp_path)


def test_a_summary_that_was_cut_off_is_named(tmp_path):
    (tmp_path / "summary.json").write_text('{"objectives": [')
    with pytest.raises(RunError, match=r"summary.json: cannot be read as JSON .* delete it and `hts resume"):
        read_run(tmp_path)


RESULT = {"unit": "1", "speeds": {"0.8": {"improvement": 0.1}}}


@pytest.mark.parametrize(
    ("said", "changes"),
    [
        ("objectives: expected at least 1", {"objectives": []}),
        ("robot: expected text, found nothing", {"robot": None}),
        ("sim_steps: expected a whole number, found '1e6'", {"sim_steps": "1e6"}),
        ("iterations.0.index: this key is needed", {"iterations": [{}]}),
        ("iterations.0.candidates.0.anchor: this key", {"iterations": [{"index": 0, "candidates": [{"id": "00-00"}]}]}),
        ("final.objectives.cost.speeds: this key", {"final": {"policy": "00-00", "objectives": {"cost": {}}}}),
        (
            "final.objectives.cost.open_loop.speeds: this key",
            {"final": {"policy": "00-00", "objectives": {"cost": {**RESULT, "open_loop": {}}}}},
        ),
    ],
)
def test_a_summary_that_no_page_can_be_made_of_is_refused_with_what_is_missing(tmp_path, said, changes):
    summary = {"objectives": ["cost"], "iterations": [], "final": None}
    summary |= {"robot": "example", "preset": "quick", "engine": "mujoco", "seed": 0}
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    read_run(tmp_path)
    (tmp_path / "summary.json").write_text(json.dumps(summary | changes))
    with pytest.raises(RunError, match=rf"summary.json: damaged \({said}") as caught:
        write_report(tmp_path)
    assert "give the folder that `hts run` named" in str(caught.value) and not (tmp_path / "report.html").exists()


def test_so_is_an_evaluation(tmp_path):
    write_example_run(tmp_path, **SMALL)
    (tmp_path / "evaluation.json").write_text(json.dumps({"objectives": {"cost": {"unit": "1"}}}))
    with pytest.raises(RunError, match=r"evaluation.json: damaged \(objectives.cost.speeds: this key is needed"):
        read_run(tmp_path)


@pytest.mark.parametrize(
    ("file", "mend"),
    [
        ("evaluation.json", "Delete it; `hts evaluate"),
        ("provenance.json", "Restore it from a backup"),
        ("iterations/01/fit.json", "or delete it: the report then lacks"),
    ],
)
def test_a_file_of_a_run_that_was_cut_off_says_how_to_mend_it_and_the_report_goes_without(tmp_path, file, mend):
    write_example_run(tmp_path, **SMALL)
    (tmp_path / file).write_text('{"a')
    with pytest.raises(RunError, match=rf"{file}: cannot be read as JSON .* {mend}"):
        read_run(tmp_path)
    (tmp_path / file).unlink()
    write_report(tmp_path)
