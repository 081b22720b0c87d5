"""Candidates of whole runs, judged afterwards by the reality's instruments, and where promises are lost."""

from __future__ import annotations

import json

import pytest
from batch.exact_gap import gap_table
from batch.exact_kept import judge_kept, works_of
from batch.exact_lines import Exact, Judged, read_exact
from batch.groups import groups_of
from fake_lines import line

from hts.errors import ConfigError, EvaluationError, RunError


def exact(saved: float, iteration: int = 0) -> Exact:
    """What the instruments say of the candidate that `fake_lines.line` tried."""
    one = Judged(
        id="00-01",
        weights={"power": 9.0},
        kl_bound=None,
        kl=3.0,
        falls=0,
        saved={"power": {"0.5": 0.9, "0.8": saved}},
        valid={"0.5": 1.0, "0.8": 1.0},
    )
    return Exact(iteration=iteration, units={"power": "1"}, speeds=[0.5, 0.8], needed=0.5, candidates=[one])


@pytest.fixture
def runs(tmp_path):
    """Two finished runs and their folders."""
    lines = [line(reality=f"dev-{index:02d}") for index in range(2)]
    for one in lines:
        folder = tmp_path / f"runs/{one.method}-{one.reality}-quick-0-{one.key}"
        folder.mkdir(parents=True)
        (folder / "config.yaml").write_text(one.reality)
        (folder / "iterations/00").mkdir(parents=True)
        walks = [{"speed": 0.5, "valid": 1.0}, {"speed": 0.8, "valid": 1.0}]
        judged = {"falls": {"00-01": 0}, "trials": {"00-01": walks}}
        (folder / "iterations/00/simulate.json").write_text(json.dumps(judged))
        (folder.parent / f"{folder.name}.log").write_text("as `run` leaves it beside")
    return lines


def test_each_iteration_of_each_run_is_judged_once_on_a_copy(runs, tmp_path):
    seen, path = [], tmp_path / "exact.jsonl"

    def judge(folder, iteration):
        seen.append((folder.read_text() if folder.is_file() else (folder / "config.yaml").read_text(), iteration))
        (folder / "config.yaml").write_text("spoilt")
        return exact(0.3)

    works = works_of(runs, tmp_path / "runs")
    assert judge_kept(works, path, lambda text: None, judge) == 0
    assert seen == [("dev-00", 0), ("dev-01", 0)]
    assert {work.folder.joinpath("config.yaml").read_text() for work in works} == {"dev-00", "dev-01"}
    lines = read_exact([path])
    assert [(one.reality, one.seed, one.commit) for one in lines] == [
        (one.reality, one.seed, one.commit) for one in runs
    ]
    assert all(one.result.same_walks for one in lines)
    assert not {one.key for one in lines} & {one.key for one in runs}
    assert judge_kept(works, path, lambda text: None, judge) == 0 and len(seen) == 2


def test_one_that_cannot_be_judged_is_said_and_the_others_go_on(runs, tmp_path):
    path = tmp_path / "exact.jsonl"

    def judge(folder, iteration):
        if "dev-00" in folder.name:
            raise RunError(f"{folder}/data.zarr: not there")
        return exact(0.3)

    works = works_of(runs, tmp_path / "runs")
    assert judge_kept(works, path, lambda text: None, judge) == 1
    first, second = read_exact([path])
    assert first.status == "failed" and first.error == f"RunError: {works[0].folder.name}/data.zarr: not there"
    assert second.status == "done" and second.result.candidates == exact(0.3).candidates
    assert judge_kept(works, path, lambda text: None, lambda folder, iteration: exact(0.1)) == 0  # the failed one anew
    assert all(one.status == "done" for one in read_exact([path]))


def test_a_folder_that_was_touched_since_makes_a_failed_line_without_a_result(runs, tmp_path):
    path = tmp_path / "exact.jsonl"
    works = works_of(runs, tmp_path / "runs")
    (works[0].folder / "iterations/00/simulate.json").write_text('{"falls": {}, "trials": {}}')
    assert judge_kept(works, path, lambda text: None, lambda folder, iteration: exact(0.3)) == 1
    first, second = read_exact([path])
    assert first.status == "failed" and first.result is None and "00-01" in (first.error or "")
    assert second.status == "done"


def test_a_run_whose_folder_was_not_kept_is_named(runs, tmp_path):
    with pytest.raises(ConfigError, match=r"no folder of ours on dev-09, seed 0 .*run --keep"):
        works_of([line(reality="dev-09")], tmp_path / "runs")
    assert works_of([line(result=None, status="failed", error="it fell over")], tmp_path / "runs") == []


def lines_of(runs, tmp_path, saved):
    path = tmp_path / "exact.jsonl"
    values = iter(saved)
    judge_kept(works_of(runs, tmp_path / "runs"), path, lambda text: None, lambda folder, i: exact(next(values), i))
    return read_exact([path])


def cells(text: str) -> list[list[str]]:
    rows = [row for row in text.split("\n") if row.startswith("|")]
    return [[cell.strip() for cell in row.split("|")[1:-1]] for row in rows[2:]]


def test_the_gap_is_told_at_speeds_that_were_promised_judged_and_measured(runs, tmp_path):
    found = lines_of(runs, tmp_path, [0.22, 0.24])  # promised 25 %, measured 20 %, at 0.8 m/s
    first, every = cells(gap_table(groups_of(runs), found))
    assert first[:6] == ["ours", "0", "2 on 2", "25.0 %", "23.0 %", "20.0 %"]
    assert first[6].startswith("+2.0 points (") and first[7] == "2.2 points"
    assert first[8].startswith("−3.0 points (") and first[9] == "3.2 points"
    assert every == ["ours", "all", *first[2:]]


def test_a_refused_trial_and_a_run_of_another_version_are_left_out(runs, tmp_path):
    found = lines_of(runs, tmp_path, [0.22, 0.24])
    tried = runs[0].result.tried[0].model_copy(update={"refused": True})
    refused = runs[0].model_copy(update={"result": runs[0].result.model_copy(update={"tried": [tried]})})
    assert cells(gap_table(groups_of([refused, runs[1]]), found))[0][2] == "1 on 1"
    later = [one.model_copy(update={"commit": "d" * 40}) for one in runs]
    with pytest.raises(EvaluationError, match="exact kept"):
        gap_table(groups_of(later), found)
    with pytest.raises(EvaluationError, match="exact kept"):
        gap_table(groups_of(runs), [])


def test_versions_have_rows_of_their_own_and_presets_do_not_mix(runs, tmp_path):
    found = lines_of(runs, tmp_path, [0.22, 0.24])
    later, judged = runs[1].model_copy(update={"commit": "d" * 40}), found[1].model_copy(update={"commit": "d" * 40})
    rows = cells(gap_table(groups_of([runs[0], later]), [found[0], judged]))
    assert [row[:3] for row in rows if row[1] == "all"] == [
        ["ours@ccccccc", "all", "1 on 1"],
        ["ours@ddddddd", "all", "1 on 1"],
    ]
    with pytest.raises(EvaluationError, match="presets"):
        groups_of([runs[0], later.model_copy(update={"preset": "paper"})])


def test_what_is_not_in_the_table_and_other_walks_are_said_below_it(runs, tmp_path):
    (simulated,) = (tmp_path / "runs").glob("*dev-00*/iterations/00/simulate.json")
    simulated.write_text(simulated.read_text().replace('"00-01": 0', '"00-01": 3'))
    found = lines_of(runs, tmp_path, [0.22, 0.24])
    assert [one.result.same_walks for one in found] == [False, True]
    nearer = runs[1].result.tried[0].model_copy(update={"id": "00-01-w50"})
    result = runs[1].result.model_copy(update={"tried": [*runs[1].result.tried, nearer]})
    text = gap_table(groups_of([runs[0], runs[1].model_copy(update={"result": result})]), found)
    assert "1 more that were tried are no candidates as training left them" in text
    assert "In 1 of 2 iterations the walks were others than those that the run had judged." in text
    of_before = [one.model_copy(update={"result": one.result.model_copy(update={"same_walks": None})}) for one in found]
    assert "Of 2 of 2 iterations it is not known" in gap_table(groups_of(runs), of_before)
