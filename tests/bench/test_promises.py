"""Promises, doubts, curves and ablations from lines of runs that never were: every number can be checked on paper."""

from __future__ import annotations

import numpy as np
import pytest
from batch.ablation import ablation, difference
from batch.curve import curve, median_curve, saved_at, staircase, staircases
from batch.groups import groups_of
from batch.lines import Doubt, Line, Model, Pair, Point
from batch.predictions import calibration, doubt, failures, improvements, prediction
from fake_lines import figures, line

from hts.errors import EvaluationError


def changed(given: Line, **result) -> Line:
    return given.model_copy(update={"result": given.result.model_copy(update=result)})


def promised(reality: str, pairs, doubts=(), method="ours") -> Line:
    """A run whose candidates were promised and saved so much at 0.8 m/s. doubts: error and spread; the level is 10."""
    given = line(method, reality)
    (one,) = given.result.tried
    tried = [
        one.model_copy(
            update={
                "id": f"00-{n:02d}",
                "predicted": {"power": {"0.8": told}},
                "measured": {"power": {"0.8": got}},
            }
        )
        for n, (told, got) in enumerate(pairs)
    ]
    model = Model(
        iteration=0,
        objective="power",
        held_out_r2=0.9,
        elites_r2=0.5,
        pairs=[Pair(policy="a", measured=10.0, predicted=11.0)],
        doubts=[Doubt(policy="a", error=error, spread=spread) for error, spread in doubts],
    )
    return changed(given, tried=tried, models=[model])


def row_of(text: str, *first: str) -> list[str]:
    (found,) = [row for row in text.splitlines() if row.startswith("| " + " | ".join(first) + " |")]
    return [cell.strip() for cell in found.strip("|").split("|")]


# ------------------------------------------------------------------------------------------------------- promises

KEPT = promised("dev-00", [(0.2, 0.1), (0.4, 0.3)], [(0.5, 1.0), (-1.5, 1.0)])
BROKEN = promised("dev-01", [(0.4, 0.0), (0.2, 0.1)], [(3.0, 4.0), (-8.0, 4.0)])


def test_how_much_of_what_was_promised_came():
    row = row_of(calibration(groups_of([KEPT, BROKEN])), "ours")
    assert row[1:3] == ["2", "4"]
    assert row[3].startswith("0.42 (")  # 0.4 / 0.6 and 0.1 / 0.6: their median
    assert row[4] == "1 of 2"
    assert row[5].startswith("−17.5 points (")  # −10 and −25 on average
    assert row[6] == "21.8 points"  # sqrt((1 + 1 + 16 + 1) / 4) * 10
    assert row[7] == "0.00"  # +1 on one, −1 on the other


def test_the_order_of_candidates_is_that_at_one_speed():
    """Promised most at the speed where least is saved, and yet everybody's turn is right at each speed."""
    told = [{"0.5": 0.1, "1.1": 0.5}, {"0.5": 0.2, "1.1": 0.6}, {"0.5": 0.3, "1.1": 0.7}]
    came = [{"0.5": 0.7, "1.1": 0.1}, {"0.5": 0.8, "1.1": 0.2}, {"0.5": 0.9, "1.1": 0.3}]
    (one,) = line("ours").result.tried
    tried = [
        one.model_copy(update={"id": f"00-{n:02d}", "predicted": {"power": said}, "measured": {"power": got}})
        for n, (said, got) in enumerate(zip(told, came, strict=True))
    ]
    groups = groups_of([changed(line("ours"), tried=tried)])
    assert row_of(calibration(groups), "ours")[7:] == ["1.00", "1.00"]
    assert row_of(failures(groups), "ours", "dev-00")[5] == "1.00"
    assert row_of(prediction(groups), "ours")[3] == "1.00"


def test_where_the_model_fails_comes_first():
    text = failures(groups_of([KEPT, BROKEN]))
    rows = [row for row in text.splitlines() if row.startswith("| ours |")]
    assert [row.split("|")[2].strip() for row in rows] == ["dev-01", "dev-00"]
    row = row_of(text, "ours", "dev-01")
    assert row[2:6] == ["30.0 %", "5.0 %", "0.17", "−1.00"]
    assert row[6:8] == ["0.90", "0.50"]
    # off by 30 and 80 % of the level, by 40 % as it said
    assert row[8:] == ["60.4 %", "40.0 %", "1.51"]


def test_whether_the_doubt_knew():
    row = row_of(doubt(groups_of([KEPT, BROKEN])), "ours")
    assert row[1:3] == ["2", "4"]
    assert row[3].startswith("0.50 (") and row[4].startswith("1.00 (")  # one of two within one, all within two
    assert float(row[5]) == pytest.approx(np.sqrt((0.5**2 + 1.5**2 + 9 + 64) / (2 * 1 + 2 * 16)), abs=0.005)
    assert row[6] == "0.89"  # larger doubts came with larger errors
    assert row[7:] == ["10.0 %", "55.0 %"]


def test_a_method_without_promises_has_a_row_of_dashes():
    bare = changed(line("baseline"), tried=[], models=[])
    assert set(row_of(calibration(groups_of([KEPT, bare])), "baseline")[1:]) == {"–"}
    assert set(row_of(doubt(groups_of([KEPT, bare])), "baseline")[1:]) == {"–"}


def test_the_fit_of_another_objective_says_nothing_of_this_one():
    (model,) = KEPT.result.models
    other = changed(KEPT, models=[model.model_copy(update={"objective": "noise"})])
    assert set(row_of(doubt(groups_of([other])), "ours")[1:]) == {"–"}
    assert improvements(groups_of([KEPT])[0]) == {"dev-00": [(0.2, 0.1), (0.4, 0.3)]}


# --------------------------------------------------------------------------------------------------------- curves


def climbing(reality: str, *steps, final=True, method="ours") -> Line:
    """A run whose best saved so much at each of three speeds from so many samples on."""
    points = [
        Point(
            iteration=n,
            samples=samples,
            best="00-01",
            improvement={"power": {"0.8": height + 0.1}},  # as it was tried: flattering, at one speed
            final={"power": dict.fromkeys(("0.5", "0.8", "1.1"), height)} if final else None,
        )
        for n, (samples, height) in enumerate(steps)
    ]
    return changed(line(method, reality), curve=points)


def test_a_curve_is_a_staircase_that_begins_at_nothing():
    found = staircase(climbing("dev-00", (40_000, 0.1), (60_000, 0.2)).result, "power")
    assert [found.at(n) for n in (0, 39_999, 40_000, 59_999, 60_000, 1e9)] == [0.0, 0.0, 0.1, 0.1, 0.2, 0.2]


def test_a_speed_that_was_refused_counts_as_nothing_in_a_curve():
    given = climbing("dev-00", (40_000, 0.3))
    (point,) = given.result.curve
    refused = changed(
        given, curve=[point.model_copy(update={"final": {"power": {"0.5": 0.3, "0.8": 0.3, "1.1": 0.0}}})]
    )
    assert staircase(refused.result, "power").at(1e9) == pytest.approx(0.2)
    nobody = changed(given, curve=[point.model_copy(update={"final": {}, "best": "pretrained"})])
    assert staircase(nobody.result, "power").at(1e9) == 0.0


def test_medians_are_taken_at_equal_samples_and_over_realities():
    lines = [climbing(f"dev-{n:02d}", (20_000 * n, 0.1 * n)) for n in (1, 2, 3)]
    found = staircases(groups_of(lines)[0])
    assert saved_at(found, 50_000) == {"dev-01": [0.1], "dev-02": [0.2], "dev-03": [0.0]}
    samples, heights = median_curve(found)
    assert samples.tolist() == [0, 20_000, 40_000, 60_000]
    assert heights == pytest.approx([0.0, 0.0, 0.1, 0.2])  # of 0.1, 0, 0; of 0.1, 0.2, 0; of all three
    row = row_of(curve(groups_of(lines)), "ours")
    assert row[1:5] == ["like the final", "0.0 %", "10.0 %", "20.0 %"]  # at 24,000, 48,000 and 72,000


def test_what_flatters_says_so_and_is_not_mixed_with_what_does_not():
    tried = climbing("dev-00", (40_000, 0.1), final=False)
    assert row_of(curve(groups_of([tried])), "ours")[1] == "when it was tried"
    with pytest.raises(EvaluationError, match="one flatters"):
        curve(groups_of([tried, climbing("dev-01", (40_000, 0.1))]))


# ------------------------------------------------------------------------------------------------------- ablation


def final(reality, saved, method, half=0.03, seed=0, held=True) -> Line:
    given = line(method, reality, seed, (saved,) * 3)
    outcome = given.result.objectives["power"]
    own = figures(saved).model_copy(update={"improvement_ci95": (saved - half, saved + half)})
    speeds = dict.fromkeys(("0.5", "0.8", "1.1"), own)
    opened = {key: one.model_copy(update={"improvement": saved + 0.05}) for key, one in speeds.items()}
    update = {"held": speeds if held else None, "open_loop": opened}
    return changed(given, objectives={"power": outcome.model_copy(update=update)})


def test_an_ablation_is_a_difference_on_each_reality_with_its_interval():
    ours = [final(f"dev-{n:02d}", 0.2, "ours") for n in (0, 1)]
    without = [final("dev-00", 0.1, "no-doubt"), final("dev-01", 0.14, "no-doubt")]
    text = ablation(groups_of([*ours, *without]))
    assert text.splitlines()[0].endswith("| dev-00 | dev-01 |")
    row = row_of(text, "no-doubt")
    assert row[1].startswith("−8.0 points (") and row[2] == "2 of 2"
    # each final is known to ±3 points at each of three speeds: sqrt(2) * 3 / sqrt(3)
    assert row[4:] == ["−10.0 ± 2.4 points", "−6.0 ± 2.4 points"]


def test_with_several_seeds_the_interval_is_over_seeds():
    lines = [[final("dev-00", saved, method, seed=n) for n, saved in enumerate(values)]
             for method, values in (("ours", (0.2, 0.22)), ("late", (0.1, 0.14)))]  # fmt: skip
    gap, half = difference(*([row.result for row in lines[at]] for at in (1, 0)), "power")
    assert gap == pytest.approx(-0.09)
    # variances of the means 1e-4 and 4e-4; 5e-4² / (1e-8 + 16e-8) = 1.47 degrees of freedom
    from scipy import stats

    assert half == pytest.approx(stats.t.ppf(0.975, 25 / 17) * np.sqrt(5e-4))


def test_speed_that_was_not_held_is_compared_at_equal_commands():
    ours = [final(f"dev-{n:02d}", 0.2, "ours") for n in (0, 1)]
    without = [final(f"dev-{n:02d}", 0.2, "no-held-speed", held=False) for n in (0, 1)]
    row = row_of(ablation(groups_of([*ours, *without])), "no-held-speed (at equal commands)")
    assert row[1].startswith("+0.0 points (")  # both saved 25 % at equal commands


def test_an_ablation_needs_the_whole():
    with pytest.raises(EvaluationError, match="No line is of 'ours'"):
        ablation(groups_of([line("no-doubt")]))
