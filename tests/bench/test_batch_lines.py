"""Lines of a batch, their tables and figures, and the numbers in pages that are made of them."""

from __future__ import annotations

import json

import pytest
from batch import blocks, tables
from batch.ablation import ablation
from batch.all_tables import ALL
from batch.groups import groups_of, saving
from batch.harvest import _outcome, result_of
from batch.lines import CONFIRM, GivenUp, append, read_lines
from fake_lines import line

from hts.errors import EvaluationError, RunError

# -------------------------------------------------------------------------------------------------- files of lines


def test_a_line_that_was_torn_is_no_line_and_spoils_no_other(tmp_path):
    path = tmp_path / "lines.jsonl"
    append(path, line(seed=0))
    whole = path.read_bytes()
    path.write_bytes(whole + whole[:40])  # killed in the midst of the second
    assert [row.seed for row in read_lines([path])] == [0]
    append(path, line(seed=1))
    assert [row.seed for row in read_lines([path])] == [0, 1]
    assert path.read_bytes().startswith(whole)


@pytest.mark.parametrize(
    ("change", "said"),
    [({"version": 2}, "version: Input should be 1"), ({"seed": None}, "seed"), ({"stranger": 1}, "stranger: Extra")],
)
def test_a_line_of_another_shape_is_refused_with_its_place(tmp_path, change, said):
    path = tmp_path / "lines.jsonl"
    good = line().model_dump_json()
    path.write_text(good + "\n" + json.dumps({**json.loads(good), **change}) + "\n")
    with pytest.raises(RunError, match=rf"lines.jsonl, line 2: {said}"):
        read_lines([path])


def test_a_number_that_is_not_finite_cannot_become_a_line():
    with pytest.raises(ValueError, match="finite"):
        line(saved=(0.1, float("nan"), 0.1))


def test_a_failure_never_takes_the_place_of_a_finished_run(tmp_path):
    path = tmp_path / "lines.jsonl"
    for row in (line(), line(status="failed", error="boom", result=None)):
        append(path, row)
    assert [row.status for row in read_lines([path])] == ["done"]


# ---------------------------------------------------------------------------------------------------------- tables


def two_methods():
    ours = [line("ours", f"dev-{n:02d}", seed, (0.1 * n,) * 3) for n in (1, 2, 3) for seed in (0, 1)]
    other = [
        line("baseline", f"dev-{n:02d}", 0, (0.1 * n - gap,) * 3) for n, gap in ((1, 0.02), (2, -0.02), (3, -0.005))
    ]
    return groups_of([*ours, *other])


def row_of(text, method):
    (found,) = [row for row in text.splitlines() if row.startswith(f"| {method} |")]
    return [cell.strip() for cell in found.strip("|").split("|")]


def test_a_table_over_realities_can_be_checked_on_paper():
    row = row_of(tables.methods(two_methods()), "ours")
    assert row[1:7] == ["3 × 2", "0", "20.0 %", "20.0 %", "20.0 %", "20.0 %"]
    assert row[7].startswith("20.0 % (")
    assert row[8:10] == ["11.0 %", "10.0 %"]  # 5th percentile between 10 and 20: 10 + 0.1 * 10
    assert row[-2] == "2 of 3"  # behind by 2 points, ahead by 2, behind by half a point: the first is 2 ahead
    assert row[-1].startswith("−0.2 points (")


def test_the_short_table_compares_with_its_first_row():
    text = tables.short(two_methods())
    ours, other = row_of(text, "ours"), row_of(text, "baseline")
    assert ours[1:3] == ["3", "20.0 %"] and ours[4:] == ["10.0 %", "0", "0, 0", "–"]
    assert other[2] == "22.0 %" and other[4] == "8.0 %" and other[-1].startswith("+0.2 points (")


def test_the_short_table_says_how_many_runs_failed():
    lines = [line("ours", "dev-01"), line("ours", "dev-02", key="other", status="failed", error="boom", result=None)]
    assert row_of(tables.short(groups_of(lines)), "ours")[1] == "1 (1 run failed)"


def test_what_was_refused_counts_as_nothing_saved_and_is_counted():
    groups = groups_of([line(saved=(None, 0.3, 0.3)), line(reality="dev-01", saved=(None, None, None))])
    assert [saving(result, "power") for _, result in groups[0].results] == pytest.approx([0.2, 0.0])
    row = row_of(tables.methods(groups), "ours")
    assert row[11] == "1 of 6"  # the second one stayed with the pretrained policy: nothing was refused


@pytest.mark.parametrize("named", [True, False], ids=["named", "in the total alone"])
def test_samples_that_confirm_the_best_are_part_of_selection(named):
    one = line()
    by_stage = {"collect": 20_000, "iterations/00/test": 10_000, "final": 20_000, "total": 57_000}
    by_stage |= {CONFIRM: 7_000} if named else {}
    changed = one.model_copy(update={"result": one.result.model_copy(update={"real_samples": by_stage})})
    row = row_of(tables.samples(groups_of([changed])), "ours")
    assert row[1:5] == ["20,000", "17,000", "20,000", "57,000"]


def test_who_fails_the_gate_is_counted_where_it_was_asked():
    def with_gate(reality, *passed):
        one = line(reality=reality)
        tried = [one.result.tried[0].model_copy(update={"gate": found}) for found in passed]
        return one.model_copy(update={"result": one.result.model_copy(update={"tried": tried, "best": tried[0]})})

    groups = groups_of([with_gate("dev-00", True, False), with_gate("dev-01", False, None)])
    assert row_of(tables.gate(groups), "ours")[1:] == ["2", "1 of 2", "2 of 3"]
    assert row_of(tables.gate(groups_of([line()])), "ours")[1:] == ["1", "–", "–"]


def test_a_failed_run_has_no_saving_and_is_counted():
    groups = groups_of([line(), line(seed=1, status="failed", error="boom", result=None)])
    assert row_of(tables.methods(groups), "ours")[1:4] == ["1 × 1", "1", "10.0 %"]


def test_a_failed_run_of_another_objective_is_not_in_the_table():
    """It would be a version of its own, and the good runs' method would go by another name."""
    failed = {"status": "failed", "error": "boom", "result": None, "arguments": ["run", "--objective", "noise"]}
    lines = [line(), line(reality="dev-01", method_hash="n" * 64, **failed)]
    assert [group.name for group in groups_of(lines, objective="power")] == ["ours"]
    with pytest.raises(EvaluationError, match="noise"):
        groups_of(lines)


def test_a_speed_that_was_not_asked_for_is_no_saving_of_nothing():
    (group,) = groups_of([line(saved=(None, 0.2, 0.3))])
    assert group.values("0.5") == {"dev-00": [0.0]} and group.values("0.80") == {"dev-00": [0.2]}
    with pytest.raises(EvaluationError, match=r"0\.9"):
        group.values("0.9")
    whole = line(method="baseline").result
    slower = whole.model_copy(update={"asked_speeds": [0.5, 0.8]})
    groups = groups_of([line(), line(method="baseline", result=slower)])
    assert row_of(tables.methods(groups), "baseline")[3:7] == ["10.0 %", "20.0 %", "–", "15.0 %"]
    assert row_of(tables.seeds(groups), "baseline")[3:6] == ["10.0 %", "20.0 %", "–"]


def test_a_changed_method_is_another_row():
    groups = groups_of([line(), line(commit="d" * 40)])
    assert [group.name for group in groups] == ["ours@ccccccc", "ours@ddddddd"]


def test_an_ablation_is_paired_by_reality():
    row = row_of(tables.pairs(two_methods(), "ours"), "baseline")
    assert row[1] == "3" and row[2].startswith("+0.2 points (") and row[4] == "2 of 3"


def test_refusals_are_compared_where_both_ran():
    ours = [line("ours", f"dev-{n:02d}", saved=(None, 0.1, 0.1)) for n in (1, 2, 3)]
    part = [line("part", "dev-01", saved=(None, None, 0.1))]
    groups = groups_of([*ours, *part])
    assert row_of(tables.pairs(groups, "ours"), "part")[-1] == "+1"
    assert row_of(ablation(groups), "part")[3] == "+1"


def test_at_equal_commands_it_is_refusals_at_equal_commands_that_are_compared():
    def refused_open_loop(one, speeds, held=True):
        outcome = one.result.objectives["power"]
        why = {speed: "too slow" for speed in speeds}
        changed = {"refused_open_loop": why} if held else {"held": None, "refused": why}
        outcome = outcome.model_copy(update=changed)
        return one.model_copy(update={"result": one.result.model_copy(update={"objectives": {"power": outcome}})})

    ours = refused_open_loop(line("ours"), ["0.5", "0.8"])
    other = refused_open_loop(line("no-held-speed"), ["0.5"], held=False)
    row = row_of(ablation(groups_of([ours, other])), "no-held-speed (at equal commands)")
    assert row[3] == "−1"


def told(falls, of="policy"):
    return f"0 of 40 segments of the {of} are valid (within ±10% of the commanded speed, with {falls} falls)"


def test_falls_are_counted_where_a_speed_or_a_candidate_was_refused_too():
    one = line()
    tried = one.result.tried[0]
    spoken = tried.model_copy(update={"refused": True, "why": f"00-01: {told(2)}"})
    counted = tried.model_copy(update={"refused": True, "why": f"00-02: {told(2)}", "falls": 3})
    outcome = one.result.objectives["power"].model_copy(
        update={"refused_falls": {"0.5": 1}, "refused_falls_open_loop": {"0.8": 1, "1.1": 2}}
    )
    result = one.result.model_copy(update={"tried": [spoken, counted], "objectives": {"power": outcome}})
    assert row_of(tables.methods(groups_of([one.model_copy(update={"result": result})])), "ours")[10] == "4, 5"


def test_falls_that_only_a_refusal_speaks_of_are_counted_once_and_the_reference_s_never():
    one = line()
    outcome = one.result.objectives["power"].model_copy(
        update={
            "refused": {"0.5": told(2), "0.8": told(4, of="reference")},
            "refused_falls": {"0.5": 2},
            "refused_open_loop": {"0.5": told(3), "1.1": "too slow"},
        }
    )
    result = one.result.model_copy(update={"tried": [], "objectives": {"power": outcome}})
    assert row_of(tables.methods(groups_of([one.model_copy(update={"result": result})])), "ours")[10] == "5, 0"


def test_falls_of_second_trials_and_of_finals_that_were_given_up_are_counted_and_lost_finals_lose_every_speed():
    one = line()
    twice = one.result.tried[0].model_copy(update={"falls": 1, "falls_again": 2})
    given_up = GivenUp(policy="00-01", refused={"power": {"0.5": told(2)}}, falls=1, error=told(2))
    kept = one.result.model_copy(update={"tried": [twice], "given_up": [given_up]})
    lost = kept.model_copy(update={"tried": [], "objectives": {}, "final_policy": "pretrained"})
    two = [one.model_copy(update={"result": kept}), line("ours", "dev-01", key="other", result=lost.model_dump())]
    row = row_of(tables.methods(groups_of(two)), "ours")
    assert row[10] == "4, 3" and row[11] == "3 of 6 (2 finals given up)"


def test_the_best_other_is_another_one_on_each_reality():
    a = [line("a", f"dev-{n:02d}", saved=(saved,) * 3) for n, saved in ((1, 0.20), (2, 0.10), (3, 0.30))]
    b = [line("b", f"dev-{n:02d}", saved=(saved,) * 3) for n, saved in ((1, 0.10), (2, 0.20), (3, 0.00))]
    ours = [line("ours", f"dev-{n:02d}", saved=(saved,) * 3) for n, saved in ((1, 0.22), (2, 0.16), (3, 0.33))]
    row = row_of(tables.best_other(groups_of([*ours, *a, *b])), "ours")
    assert row[1] == "3" and row[2].startswith("+0.3 points") and row[3].startswith("+2.0 points")
    assert row[4].startswith("1.10 (") and row[4].endswith(" on 3") and row[5] == "2 of 3"


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([], "No line has"),
        ([line(), line(preset="paper", key="other")], "presets paper, quick"),
        ([line(), line(reality_hash="other", key="other")], "two realities named 'dev-00'"),
        ([line(), line(key="other", arguments=["run", "--objective", "noise"])], "objectives power and noise"),
    ],
)
def test_what_does_not_belong_together_is_not_averaged(lines, said):
    with pytest.raises(EvaluationError, match=said):
        groups_of(lines)


@pytest.mark.parametrize("name", list(ALL))
def test_every_table_has_a_row_for_each_method(name):
    text = ALL[name](two_methods()).split("\n\n")[0]  # without what is said below it
    if name == "realities":
        assert text.splitlines()[0] == "| reality | ours | baseline |"
    else:
        assert {"ours", "baseline"} <= {row.split("|")[1].strip() for row in text.splitlines()[2:]}
    assert len({row.count("|") for row in text.splitlines()}) == 1


@pytest.mark.slow
def test_figures_are_drawn_and_the_same_lines_give_the_same_bytes(tmp_path):
    from batch.figures import draw

    made = draw(two_methods(), tmp_path / "a", "x")
    assert {path.name for path in made} == {
        f"x-{name}.{kind}"
        for name in ("savings", "prediction", "doubt", "robot-time", "open-loop")
        for kind in ("svg", "png")
    }
    again = draw(two_methods(), tmp_path / "b", "x")
    assert [path.read_bytes() for path in made] == [path.read_bytes() for path in again]


def test_methods_that_fit_nothing_are_named_in_the_figure_of_predictions_too():
    from batch.figures import prediction

    one = line("ours-proxy")
    assert one.result is not None
    fitted = line()
    no_models = line("ours-proxy", result=one.result.model_copy(update={"models": []}))
    drawing = prediction(groups_of([fitted, no_models]))
    assert drawing is not None
    assert [text.get_text() for legend in drawing.legends for text in legend.get_texts()] == ["ours", "ours-proxy"]


def test_runs_stand_one_by_one_with_their_mean():
    rows = [line(reality="default", seed=seed, saved=(0.1 * (seed + 1),) * 3) for seed in (1, 0)]
    shown = tables.TABLES["seeds"](groups_of(rows)).splitlines()
    assert shown[0].startswith("| method | reality | seed | 0.5 m/s | 0.8 m/s | 1.1 m/s | refused | minutes |")
    assert [row.split(" | ")[2:4] for row in shown[2:4]] == [["0", "10.0 %"], ["1", "20.0 %"]]
    assert "| **mean** |" in shown[4] and "**15.0 %**" in shown[4]


# ------------------------------------------------------------------------------------------------ numbers in pages


def test_blocks_are_filled_from_lines_and_filling_twice_changes_nothing(lines):
    text = (
        "Saves <!-- results: value lines=a.jsonl method=ours -->9.9 %<!-- end --> in the median, "
        "falls <!-- results: value lines=a.jsonl statistic=falls --><!-- end -->.\n"
        "<!-- results: methods lines=a.jsonl -->\nold\n<!-- end -->\nafter"
    )
    made = blocks.written(text, lines)
    assert "-->20.0 %<!-- end --> in the median" in made and "-->0<!-- end -->." in made
    assert "| ours | 3 × 1 |" in made and "old" not in made and made.endswith("after")
    assert blocks.written(made, lines) == made


@pytest.mark.parametrize(
    ("block", "said"),
    [
        ("<!-- results: methods -->x<!-- end -->", "expected lines=FILE"),
        ("<!-- results: dance lines=a.jsonl --><!-- end -->", "No table named 'dance'"),
        ("<!-- results: value lines=a.jsonl method=x --><!-- end -->", "No method in these lines named 'x'"),
        ("<!-- results: value lines=a.jsonl statistic=x --><!-- end -->", "No statistic named 'x'"),
        ("<!-- results: methods lines=a.jsonl -->", "begins and does not end"),
    ],
)
def test_a_block_that_cannot_be_made_is_one_line(lines, block, said):
    with pytest.raises(EvaluationError, match=said):
        blocks.written(block, lines)


def test_a_sentence_may_tell_a_metric_instead_of_the_improvement(tmp_path):
    saved = line(saved=(0.3, 0.3, 0.3))
    for figures in saved.result.objectives["power"].held.values():
        figures.metrics["gross_reduction"] = 0.2
    (tmp_path / "a.jsonl").write_text(saved.model_dump_json() + "\n")
    made = blocks.written("<!-- results: value lines=a.jsonl metric=gross_reduction --><!-- end -->", tmp_path)
    assert "-->20.0 %<!--" in made
    with pytest.raises(EvaluationError, match="No metric in these lines named 'gross'. Did you mean"):
        blocks.written("<!-- results: value lines=a.jsonl metric=gross --><!-- end -->", tmp_path)


def test_a_block_may_keep_to_some_realities(tmp_path):
    lines = [line(reality="a", key="1", saved=(0.1, 0.1, 0.1)), line(reality="b", key="2", saved=(0.3, 0.3, 0.3))]
    (tmp_path / "a.jsonl").write_text("".join(one.model_dump_json() + "\n" for one in lines))
    made = blocks.written("<!-- results: value lines=a.jsonl statistic=mean realities=b --><!-- end -->", tmp_path)
    assert "-->30.0 %<!--" in made
    with pytest.raises(EvaluationError, match="No reality in these lines named 'c'"):
        blocks.written("<!-- results: methods lines=a.jsonl realities=a,c --><!-- end -->", tmp_path)


def test_versions_that_do_the_same_may_count_as_one(tmp_path):
    older = line(reality="a", key="1", seed=0, saved=(0.1, 0.1, 0.1))
    newer = line(reality="a", key="2", seed=1, saved=(0.3, 0.3, 0.3), commit="d" * 40)
    (tmp_path / "a.jsonl").write_text("".join(one.model_dump_json() + "\n" for one in (older, newer)))
    asked = "<!-- results: value lines=a.jsonl statistic=mean{} --><!-- end -->"
    with pytest.raises(EvaluationError, match="No method in these lines named 'ours'"):
        blocks.written(asked.format(""), tmp_path)
    assert "-->20.0 %<!--" in blocks.written(asked.format(" as-one=ours"), tmp_path)
    with pytest.raises(EvaluationError, match="No method in these lines named 'our'. Did you mean"):
        blocks.written(asked.format(" as-one=our"), tmp_path)
    again = newer.model_copy(update={"seed": 0})
    (tmp_path / "a.jsonl").write_text("".join(one.model_dump_json() + "\n" for one in (older, again)))
    with pytest.raises(EvaluationError, match="ours has two runs on a at seed 0, of different versions"):
        blocks.written(asked.format(" as-one=ours"), tmp_path)


def test_a_failed_run_that_another_version_made_again_is_counted_beside_it(tmp_path):
    failed = line(reality="a", key="1", seed=0).model_copy(update={"status": "failed", "error": "no", "result": None})
    again = line(reality="a", key="2", seed=0, saved=(0.3, 0.3, 0.3), commit="d" * 40)
    (tmp_path / "a.jsonl").write_text("".join(one.model_dump_json() + "\n" for one in (failed, again)))
    made = blocks.written("<!-- results: methods lines=a.jsonl as-one=ours --><!-- end -->", tmp_path)
    assert "| ours | 1 × 1 | 1 | 30.0 % |" in made


def test_versions_as_one_may_have_been_asked_other_speeds():
    older, newer = line(reality="a"), line(reality="b", commit="d" * 40, saved=(0.3, 0.4, None))
    result = newer.result.model_copy(update={"asked_speeds": [0.8, 1.1]})
    groups = groups_of([older, newer.model_copy(update={"result": result})], as_one=["ours"])
    assert row_of(tables.realities(groups), "a")[1] == "20.0 % (lowest speed 10.0 %)"
    assert row_of(tables.realities(groups), "b")[1] == "20.0 % (lowest speed 0.0 %)"  # 40 % and a refused one


def test_a_number_outside_of_blocks_is_seen_unless_it_stood_there_before():
    text = "Saves 15.6 % and 3 dB(A). <!-- results: value lines=a.jsonl -->20.0 %<!-- end --> | 7.25 |"
    assert blocks.strangers("README.md", text, {}) == ["15.6", "3"]
    assert blocks.strangers("docs/results.md", text, {"15.6": 1}) == ["3", "7.25"]
    assert blocks.remaining("README.md", text, {"15.6": 2, "8.8": 1}) == {"15.6": 1}


# ------------------------------------------------------------------------------------------------- real run folders


@pytest.mark.slow
def test_a_real_run_folder_becomes_a_result(small_run):
    found, summary = result_of(small_run.folder), small_run.summary_of()
    assert found.real_samples["total"] == summary["real_samples"]
    assert sum(value for stage, value in found.real_samples.items() if stage != "total") == summary["real_samples"]
    assert found.candidates == 2 and len(found.tried) == 1
    assert found.models[0].objective == "power" and found.models[0].pairs


def test_a_final_whose_speed_was_not_held_keeps_its_falls_at_refused_speeds():
    found = _outcome({"unit": "1", "speeds": {}, "refused": {"0.5": told(2)}, "refused_falls": {"0.5": 2}})
    assert found.held is None and found.refused_falls == {"0.5": 2}


def test_an_elite_whose_training_was_stopped_has_no_score_and_its_run_a_line_all_the_same(tmp_path):
    tried = line().result.tried[0].model_dump() | {"sim_score": None}
    row = line(result=line().result.model_dump() | {"tried": [tried]})
    append(tmp_path / "lines.jsonl", row)
    (read,) = read_lines([tmp_path / "lines.jsonl"])
    assert read.result.tried[0].sim_score is None
