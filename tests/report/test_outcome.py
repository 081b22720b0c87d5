"""The words at the end of a run in which nobody was chosen."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from hts.report.outcome import closing, nobody_chosen
from hts.report.table import print_table


def refused(walked: float, falls: int = 0) -> dict:
    numbers = {"speed": 0.8, "walked": walked, "valid": 0.02, "falls": falls}
    return {"elite": True, "refused": "00-00: Head-to-head at 0.8 m/s: 3 of 160 segments …", "refusal": numbers}


WORSE = {"elite": True, "real": {"power": {}}, "fell": False}
FELL = {"elite": True, "real": {"power": {}}, "fell": True}
NEVER_TESTED = {"elite": False}


def run(*iterations: list[dict], best: list[str | None] | None = None, final: str = "pretrained") -> dict:
    chosen = best or [None] * len(iterations)
    rows = [{"index": i, "best": chosen[i], "candidates": rows} for i, rows in enumerate(iterations)]
    return {"objectives": ["power"], "iterations": rows, "final": {"policy": final, "objectives": {}}}


def test_where_the_pretrained_policy_did_no_better_smaller_weights_are_not_advised():
    rows = [refused(0.2), refused(0.1), refused(0.1)]
    for row, walked in zip(rows, (0.2, 0.22, None), strict=True):
        row["refusal"]["reference_walked"] = walked
    (line,) = closing(run(rows))
    assert (
        "The pretrained policy did no better (0.21 m/s at 0.8 m/s), so λ need not be why: ask for speeds that it"
        in line
    )
    assert "sweep.weights" not in line
    (line,) = closing(run([rows[0], refused(0.1)]))  # of one of them it was the candidate's fault
    assert "try smaller λ (sweep.weights)" in line


def test_a_run_whose_elites_were_all_refused_says_how_many_why_and_how_fast_they_went():
    (line,) = closing(run([refused(0.55), refused(0.61, falls=2), NEVER_TESTED]))
    assert line.startswith("No final head-to-head: every elite was refused, so nothing could be compared")
    assert "2 of 2 refused (they went 0.55 and 0.61 m/s on average, 0.8 m/s was commanded; 2 falls)" in line
    assert "sweep.weights" in line and "measured better" not in line


def test_some_refused_some_fallen_and_some_no_better_are_counted_apart():
    (line,) = closing(run([refused(0.5), FELL, WORSE, WORSE]))
    assert "no candidate measured better than the pretrained policy" in line
    assert "1 of 4 refused (it went 0.50 m/s on average, 0.8 m/s was commanded), 1 fell, 2 measured no better" in line


def test_a_run_from_before_speeds_were_written_down_still_ends_in_words():
    (line,) = closing(run([{"elite": True, "refused": "some text"}]))
    assert "1 of 1 refused." in line


def test_three_iterations_in_a_row_that_choose_nobody_are_said():
    lines = closing(
        run([WORSE], [refused(0.5)], [refused(0.6)], [WORSE], best=["00-00", None, None, None], final="00-00")
    )
    assert len(lines) == 1
    assert lines[0].startswith(
        "Iterations 01 to 03 chose nobody: 2 of 3 refused (they went 0.50 and 0.60 m/s on average"
    )


def test_two_iterations_in_a_row_are_nothing_to_say():
    assert closing(run([WORSE], [WORSE], [WORSE], best=["00-00", None, None], final="00-00")) == []


def test_a_run_that_tested_nobody_says_so():
    (line,) = closing(run([NEVER_TESTED, NEVER_TESTED]))
    assert "no candidate was tested, since all fell or were stopped in simulation" in line


def test_an_iteration_that_chose_nobody_says_so_as_it_ends():
    result = {"refused": "…", "refusal": {"speed": 0.8, "walked": 0.52, "falls": 0}}
    assert nobody_chosen([result, {"refused": None, "tested": {"fell": True}}]) == (
        "nobody was chosen: 1 of 2 refused (it went 0.52 m/s on average, 0.8 m/s was commanded), 1 fell"
    )
    assert nobody_chosen([]) == "nobody was tested: every candidate fell or was stopped in simulation"


@pytest.mark.parametrize(
    ("candidates", "refused", "why"),
    [
        (4, 0, "selector 'odd' chose nobody of 4 candidates that could be tested"),
        (1, 0, "selector 'odd' chose nobody of 1 candidate that could be tested"),
        (2, 3, "the gate before reality refused 3, and selector 'odd' chose nobody of 2 others that could be tested"),
        (1, 3, "the gate before reality refused 3, and selector 'odd' chose nobody of 1 other that could be tested"),
    ],
)
def test_a_selector_that_chose_nobody_is_why_and_not_simulation(candidates, refused, why):
    over = {"selector": "odd", "candidates": candidates}
    assert nobody_chosen([], refused=refused, over=over) == f"nobody was tested: {why}"
    summary = run([NEVER_TESTED])
    summary["iterations"][0] |= {"passed_over": over, "gate": {"refused": ["00-00"] * refused}}
    (line,) = closing(summary)
    assert line == (
        f"No final head-to-head: no candidate was tested, since {why}; the pretrained policy stays the best."
    )


def test_the_terminal_says_it_in_place_of_a_table():
    console = Console(record=True, width=300, file=io.StringIO())
    print_table(run([refused(0.55)]), console)
    assert "every elite was refused" in console.export_text()


def test_with_several_objectives_none_is_said_to_be_no_better_in_one_of_them():
    both = {"elite": True, "real": {"level": {}, "cost": {}}, "fell": False}
    (line,) = closing(run([both, FELL]))
    assert "no candidate measured better than the pretrained policy in all objectives together; the pretrained" in line
    assert line.endswith("1 fell, 1 measured no better in all objectives together.")
