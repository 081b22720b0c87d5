"""What the report says of a front, from summaries written by hand."""

from __future__ import annotations

import pytest

from hts.report import figures, front_figure
from hts.report.data import RunData
from hts.report.front import front_part, front_rows, front_text


def gains(**improvements) -> dict:
    return {
        name: {"improvement": value, "improvement_ci95": [value - 0.01, value + 0.01], "selection_score": value}
        for name, value in improvements.items()
    }


def candidate(name: str, weights: dict, fell: bool = False, **improvements) -> dict:
    real = {
        objective: {"0.8": {"improvement": value, "improvement_ci95": None}}
        for objective, value in improvements.items()
    }
    return {
        "id": name,
        "anchor": "pretrained",
        "weights": weights,
        "kl_bound": None,
        "kl": 0.4,
        "elite": True,
        "falls": 0,
        "tracked": True,
        "fell": fell,
        "sim_score": 0.1,
        "sim_scores": dict.fromkeys(improvements, 0.05),
        "real": real,
    }


def run_of(tmp_path, front: dict[str, dict], candidates: list[dict], final: str | None = None) -> RunData:
    objectives = list(candidates[0]["weights"])
    summary = {
        "objectives": objectives,
        "iterations": [
            {"index": 0, "candidates": candidates, "pretrained_sim_scores": dict.fromkeys(objectives, 0.0)},
        ],
        "front": {
            "units": {objectives[0]: "1", **dict.fromkeys(objectives[1:], "dB")},
            "simulation": [{"iteration": 0, "ids": ["pretrained"]}],
            "real": [{"id": name, "iteration": 0, "improvements": gains(**found)} for name, found in front.items()],
        },
        "final": {"policy": final, "objectives": {}},
    }
    return RunData(tmp_path, summary, {}, {}, {}, {}, {})


A = candidate("00-00", {"cost": 1.0, "level": 0.0}, cost=0.2, level=-1.0)
B = candidate("00-01", {"cost": 1.0, "level": 1.0}, cost=0.1, level=2.0)


def test_the_table_is_ordered_by_the_first_objective_and_written_in_each_ones_unit(tmp_path):
    run = run_of(
        tmp_path, {"00-01": {"cost": 0.1, "level": 2.0}, "00-00": {"cost": 0.2, "level": -1.0}}, [A, B], "00-01"
    )
    first, second = front_rows(run)
    assert (first["id"], first["weights"], first["bound"], first["best"]) == ("00-00", "1 cost", "∞", False)
    assert first["gains"] == [("20.0 %", "19.0 to 21.0 %", "20.0 %"), ("−1.00 dB", "−1.01 to −0.99 dB", "−1.00 dB")]
    assert (second["weights"], second["best"]) == ("1 cost + 1 level", True)
    assert front_text(run, 2).startswith("2 of 2 policies tried in world 'unknown' are beaten by no other")


def test_a_front_with_the_pretrained_policy_says_that_nobody_gains_in_everything(tmp_path):
    zero = {"cost": 0.0, "level": 0.0}
    run = run_of(tmp_path, {"pretrained": zero, "00-00": {"cost": 0.2, "level": -1.0}}, [A])
    assert front_text(run, 1).startswith("1 of 1 policies tried in world 'unknown' is beaten by no other")
    assert "None of them gains in everything" in front_text(run, 1)
    assert [row["weights"] for row in front_rows(run)] == ["1 cost", "–"]
    alone = run_of(tmp_path, {"pretrained": zero}, [A])
    assert "the pretrained policy is the front" in front_text(alone, 1)


def test_one_objective_has_no_part_about_a_front(tmp_path):
    single = candidate("00-00", {"cost": 1.0}, cost=0.2)
    assert front_part(run_of(tmp_path, {"00-00": {"cost": 0.2}}, [single])) is None


def test_nothing_tested_has_no_figure(tmp_path):
    untested = {**A, "real": None}
    run = run_of(tmp_path, {"pretrained": {"cost": 0.0, "level": 0.0}}, [untested])
    assert front_figure.front(run, ("cost", "level")) is None


@pytest.mark.parametrize("objectives", [("cost", "level"), ("cost", "level", "heat")])
def test_the_figure_shows_each_policy_in_both_units_and_a_line_only_where_all_objectives_are_in_it(
    tmp_path, objectives
):
    values = {"00-00": (0.2, -1.0, 0.5), "00-01": (0.1, 2.0, 0.1)}
    front = {name: dict(zip(objectives, row, strict=False)) for name, row in values.items()}
    weights = dict.fromkeys(objectives, 1.0)
    run = run_of(tmp_path, front, [candidate(name, weights, **found) for name, found in front.items()], "00-01")
    panel = front_figure.front(run, ("cost", "level")).axes[0]
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("cost: counts as, %", "level: counts as, dB")
    drawn = [[tuple(point) for point in line.get_xydata()] for line in panel.lines]
    assert [(20.0, -1.0)] in drawn and [(10.0, 2.0)] in drawn and [(0.0, 0.0)] in drawn
    assert ([(10.0, 2.0), (20.0, -1.0)] in drawn) == (len(objectives) == 2)
    assert {text.get_text() for text in panel.texts} == {"00-00", "00-01", "pretrained"}


@pytest.mark.parametrize("fell", [True, False])
def test_a_gain_of_a_policy_that_fell_is_not_denied(tmp_path, fell):
    run = run_of(tmp_path, {"pretrained": {"cost": 0.0, "level": 0.0}}, [{**A, "fell": fell}])
    assert ("in any of cost and level without falling:" in front_text(run, 1)) == fell


@pytest.mark.parametrize(
    ("factor", "label"),
    [
        (1.0, "Energy − pretrained mean"),
        (3e8, "Energy − pretrained mean, 1e8"),
        (1e-6, "Energy − pretrained mean, 1e-6"),
    ],
)
def test_seconds_of_a_quantity_of_any_size_have_short_numbers_at_their_axis(tmp_path, factor, label):
    run = run_of(tmp_path, {"pretrained": {"cost": 0.0, "level": 0.0}}, [A])
    seconds = {"reference": {"energy": [4 * factor, 6 * factor]}, "policy": {"energy": [5 * factor, 5 * factor]}}
    run.segments["level"] = {"0.5": seconds, "0.8": seconds}
    first = figures.distribution(run, "level").axes[0]
    assert first.get_ylabel() == label
    assert max(first.get_ylim()) < 10.0


@pytest.mark.parametrize("speeds", [{}, {"0.8": {"improvement": 0.2}}])
def test_a_front_without_a_final_promises_none_below(tmp_path, speeds):
    run = run_of(tmp_path, {"00-00": {"cost": 0.2, "level": 1.0}}, [A], "00-00")
    run.summary["final"]["objectives"] = {"cost": {"unit": "1", "speeds": speeds}} if speeds else {}
    assert front_part(run)["measured"] == bool(speeds)
    drawn = {path.name: path.read_bytes() for path in (tmp_path / "figures").iterdir()}
    assert set(drawn) == {"front.svg", "front.pdf"} and drawn["front.pdf"].startswith(b"%PDF")
