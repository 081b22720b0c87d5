"""What the page says below held-out R², of a run folder with known contents."""

from __future__ import annotations

import json

import pytest
from example_run import write_example_run

from hts.report import write_report

SMALL = {"iterations": 1, "bounds": (0.5, float("inf")), "weights": (1.0,), "elites": 2, "block_seconds": 20}


@pytest.fixture
def said(tmp_path, monkeypatch):
    """The page after every model's part of fit.json and of summary.json was changed; figures take long."""
    monkeypatch.setattr("hts.report.page._figures", lambda run, objective: [])
    write_example_run(tmp_path, **SMALL)

    def page(of_fit=(), of_summary=()):
        place, summary = tmp_path / "iterations" / "01" / "fit.json", tmp_path / "summary.json"
        fits, whole = json.loads(place.read_text()), json.loads(summary.read_text())
        for one in fits.values():
            one.update(of_fit)
        for one in whole["iterations"]:
            for model in one["measurement_models"].values():
                model.update(of_summary)
        place.write_text(json.dumps(fits))
        summary.write_text(json.dumps(whole))
        write_report(tmp_path)
        return " ".join((tmp_path / "report.html").read_text(encoding="utf-8").split())

    return page


def test_a_session_on_both_sides_is_said_below_held_out_r2(said):
    assert "fitted to as well" not in said()
    shown = said({"same_session": {"held_out": 2, "of": 5}})
    assert "Iteration 1: 2 of 5 held-out recordings are of a session that was fitted to as well" in shown


def test_a_target_that_drifts_is_said_below_held_out_r2(said):
    assert "steady drift" not in said()
    shown = said({"target": "heat", "held_out_r2": 0.986, "drift": {"within": 0.96, "of_all": 0.1}})
    assert "Iteration 1: while the command stays the same, 96% of what" in shown
    assert "held-out R² 0.986 tells mostly whether recordings began as warm" in shown


def test_a_model_that_was_wrong_about_the_policies_it_made_is_said_below_held_out_r2(said):
    assert "worse than by their mean" not in said(of_summary={"elites_r2": 0.4})
    assert "Iteration 1: the policies that were tried are predicted worse than by their mean (R² -706)" in said(
        of_summary={"elites_r2": -706.2}
    )


def test_what_a_fit_says_of_its_model_on_the_terminal_stands_on_the_page_too(said):
    held = {"r2": 0.3, "recordings": ["a"], "linear": {"r2": 0.55}}
    about = {"objective": "power", "target": "current", "model": {"name": "lstm"}, "held_out": held}
    assert "Iteration 1: target current: held-out R² 0.300 is 0.250 below that of `linear`, 0.550." in said(about)
