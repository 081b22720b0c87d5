"""What a fit is doubted for, in lines for a person, and when a run says them."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import ClassVar

import pytest

from hts.measurement import fit_command, fit_report
from hts.testing.known_signals import KnownHeat


def a_report(r2, linear, spread=None):
    held = {"r2": r2, "linear": {"r2": linear}, "spread": spread}
    return {"objective": "warm", "target": "heat", "held_out": held}


@pytest.mark.parametrize(
    ("found", "linear", "expected"),
    [
        (
            -0.5,
            0.02,
            "target heat: held-out R² -0.500 is below 0",
        ),  # linear explains nothing either, so is nothing to choose
        (
            -0.5,
            -0.2,
            "target heat: held-out R² -0.500 is below 0.*more than about a second.*the loss that heats instead",
        ),
        (
            0.5,
            0.75,
            "target heat: held-out R² 0.500 is 0.250 below that of `linear`, 0.750.*--set objectives.warm.model=linear",
        ),
        (-0.5, 0.7, "target heat: held-out R² -0.500 is 1.200 below that of `linear`, 0.700"),
    ],
)
def test_a_model_that_is_worse_than_nothing_or_than_linear_is_told_with_its_cure(found, linear, expected):
    (line,) = fit_report.doubts(a_report(found, linear))
    assert re.match(expected, line) and "\n" not in line


@pytest.mark.parametrize(
    ("model", "fit", "advice"),
    [
        ({"name": "lstm"}, {"stopped": "patience"}, "Choose it, --set objectives.warm.model=linear, or record more."),
        (
            {"name": "lstm"},
            {"stopped": "epochs", "epochs": 2},
            (
                "Its fit was ended after 2 epochs: fit it longer, --set measurement.epochs=NUMBER, choose `linear`, "
                "--set objectives.warm.model=linear, or record more."
            ),
        ),
        (
            {"name": "lstm"},
            {"stopped": "time", "epochs": 1},
            (
                "Its fit was ended after 1 epoch: fit it longer, --set measurement.max_seconds=NUMBER, choose `linear`"
                ", --set objectives.warm.model=linear, or record more."
            ),
        ),
        (
            {"name": "ensemble", "member": "linear"},
            {"stopped": "solved"},
            (
                "Its members see parts of the recordings: choose `linear` alone, --set objectives.warm.model=linear, "
                "or record more."
            ),
        ),
        ({"name": "ensemble", "member": {"name": "linear", "lags": 3}}, {}, "Its members see parts of the recordings"),
    ],
)
def test_what_is_advised_fits_the_model_that_was_chosen(model, fit, advice):
    (line,) = fit_report.doubts(a_report(0.5, 0.75) | {"model": model, "fit": fit})
    assert f"below that of `linear`, 0.750. {advice}" in line


def test_who_chose_linear_is_not_told_to_choose_it():
    report = a_report(0.5, 0.75) | {"model": {"name": "linear", "lags": 3}, "fit": {"stopped": "solved"}}
    assert fit_report.doubts(report) == []
    (line,) = fit_report.doubts(report | {"held_out": {"r2": -0.5, "linear": {"r2": 0.7}}})
    assert "is below 0" in line and "model=linear" not in line


@pytest.mark.parametrize(("found", "linear"), [(0.95, 0.99), (0.0, None), (None, None), (0.9, 0.2)])
def test_of_a_sound_model_or_one_without_held_out_data_nothing_is_said(found, linear):
    assert fit_report.doubts(a_report(found, linear)) == []


def test_a_stand_in_with_a_negative_scale_is_told_with_its_likely_causes():
    report = a_report(0.9, 0.9)
    report["held_out"]["proxy"] = {"smoothed": {"scale": -0.5, "r2": 0.8}}
    (line,) = fit_report.doubts(report)
    assert "negative scale, -0.5" in line and "sign: -1" in line
    report["held_out"]["proxy"]["smoothed"]["scale"] = 0.5
    assert fit_report.doubts(report) == []


def test_a_doubt_that_is_too_small_for_means_of_policies_is_told_and_one_for_single_samples_is_not():
    means = [{"policy": "a", "error": 0.3, "spread": 0.1}, {"policy": "b", "error": -0.4, "spread": 0.1}]
    (line,) = fit_report.doubts(a_report(0.9, 0.9, {"error_over_spread": 9.0, "policies": means}))
    assert "the means of 2 policies are off by 3.5 times" in line
    assert not fit_report.doubts(a_report(0.9, 0.9, {"policies": [one | {"spread": 0.2} for one in means]}))


def test_a_run_says_it_at_its_fit_stage_and_not_again_in_the_next_iteration(tmp_path, monkeypatch):
    from hts.run import learning

    results = {}

    class Job:
        """As much of a run as its fit stage asks for."""

        folder, objectives, registry = tmp_path, {"warm": KnownHeat()}, None
        robot = SimpleNamespace(keeps_physics_steps=False)
        named = SimpleNamespace(weights={"warm": (1.0,)})
        config = SimpleNamespace(measurement=None, objectives={"warm": {}}, fits_models=True, sweep=named)
        said: ClassVar[list[str]] = []
        say = staticmethod(said.append)

        known = staticmethod(lambda iteration: [])
        recordings = staticmethod(lambda ids: [])
        dataset = staticmethod(lambda ids: SimpleNamespace(sha256="", ids=()))
        model_path = staticmethod(lambda iteration, name: tmp_path / name)
        read = staticmethod(lambda stage, iteration: results[iteration])

    def fitted(r2):
        report = a_report(r2, 0.9)
        monkeypatch.setattr(learning, "fit_and_check", lambda *given, **more: fit_command.FitResult(None, report))

    monkeypatch.setattr(learning.files, "save", lambda *given: None)
    fitted(-0.5)
    results[0] = learning.fit(Job, 0, print)
    assert len(Job.said) == 1 and "is 1.400 below that of `linear`" in Job.said[0]
    results[1] = learning.fit(Job, 1, print)
    assert len(Job.said) == 1
    fitted(0.9)
    results[2] = learning.fit(Job, 2, print)
    fitted(0.7)
    results[3] = learning.fit(Job, 3, print)
    assert len(Job.said) == 2 and "below that of `linear`" in Job.said[1]
    spoilt = a_report(0.9, 0.9) | {"masked": {"samples": 1, "short": 0, "why": {"heat": (1, 1e6, "W")}}}
    monkeypatch.setattr(learning, "fit_and_check", lambda *given, **more: fit_command.FitResult(None, spoilt))
    for iteration in (4, 5):
        results[iteration] = learning.fit(Job, iteration, print)
    assert Job.said[2:] == ["target heat: 1 sample that no machine makes left out: 'heat' 1 (such as 1e+06 W)."]


def test_a_run_says_what_its_fit_left_out_and_again_where_new_recordings_have_more_of_it():
    def fitted(samples, short=0):
        why = {"heat": [samples, 1e6, "W"]} if samples else {}
        return a_report(0.9, 0.9) | {"masked": {"samples": samples, "short": short, "why": why}}

    (line,) = fit_report.masked_lines(fitted(3))
    assert line == "target heat: 3 samples that no machine makes left out: 'heat' 3 (such as 1e+06 W)."
    assert fit_report.masked_lines(fitted(0)) == fit_report.masked_lines(a_report(0.9, 0.9)) == []
    assert fit_report.masked_lines(fitted(3), fitted(3)) == []
    (line,) = fit_report.masked_lines(fitted(4, 20), fitted(3))
    assert line.startswith("target heat: 4 samples that no machine makes left out, and 20 in parts shorter than 1 s")
