"""Candidates of one iteration, judged by the reality's own instruments."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from batch import exact
from batch.exact_lines import Exact, ExactLine, Judged, exact_table, read_exact
from batch.lines import append
from batch.methods import METHODS, jobs_of
from fake_lines import line as whole_line

from hts.errors import EvaluationError, RunError

FAKE = (sys.executable, str(Path(__file__).parent / "fake_hts.py"))
TINY = [
    *("run", "--objective", "power", "--robot", "go1", "--preset", "smoke", "--set", "world.reality=dev-03"),
    *("--set", "finetune.steps=48", "--set", "finetune.num_envs=4", "--set", "finetune.ppo.horizon=12"),
    *("--set", "simulation_test.num_envs=2", "--set", "simulation_test.seconds=3", "--set", "world.block_seconds=3"),
    *("--set", "sweep.kl_bounds=[1.0]"),
]


def found(iteration: int = 0, **saved: float) -> Exact:
    last = Judged(
        id="00-00", weights={"power": 9.0}, kl_bound=None, kl=3.0, falls=1, saved={"power": {"0.5": 0.1, **saved}}
    )
    half = last.model_copy(update={"id": "00-00-50", "share": 0.5, "saved": {"power": {"0.5": -9.0}}})
    return Exact(iteration=iteration, units={"power": "1"}, speeds=[0.5, 0.8], candidates=[half, last])


def line(method: str, reality: str, seed: int, result: Exact | None, **changes) -> ExactLine:
    given = whole_line(method=method, reality=reality, seed=seed).model_dump(exclude={"result"})
    key = f"{method}-{reality}-{seed}-{result.iteration if result else ''}"
    return ExactLine(**{**given, "key": key, "result": result, **changes})


def test_lines_and_folders_are_others_than_those_of_whole_runs_and_of_other_iterations():
    (job,) = jobs_of(
        {"ours": METHODS["ours"]}, ["default"], [0], objectives=["power"], robot="go1", preset="smoke", commit="c"
    )
    ((first,), (second,)) = (exact.jobs_until([job], iteration) for iteration in (0, 1))
    assert len({one.key for one in (job, first, second)}) == len({one.folder for one in (job, first, second)}) == 3
    assert first.arguments == job.arguments


def test_a_run_that_ends_before_its_iteration_is_said_in_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("FAKE_HTS", str(tmp_path))
    folder = tmp_path / "run"
    assert exact.make(5, ["run", "--seed", "0", "--out", str(folder)], FAKE) == 1
    assert capsys.readouterr().out == "error: run ended before iteration 5. Ask for an earlier one.\n"
    assert not (folder / exact.RESULT).exists()
    assert exact.make(0, ["run", "--seed", "13", "--out", str(tmp_path / "bad")], FAKE) == 2


def test_a_result_of_another_iteration_is_not_taken(tmp_path):
    (tmp_path / exact.RESULT).write_text(found(1).model_dump_json())
    assert exact.kind(1).finished(tmp_path) and exact.kind(1).result(tmp_path) == found(1)
    with pytest.raises(RunError, match="is of iteration 1, expected 0"):
        exact.kind(0).result(tmp_path)


def test_the_table_pairs_by_reality_and_seed_and_takes_the_last_candidate(tmp_path):
    path = tmp_path / "lines.jsonl"
    for reality, gain in (("dev-00", 0.1), ("dev-01", 0.3)):
        append(path, line("ours", reality, 0, found(**{"0.8": gain})))
        append(path, line("other", reality, 0, found(**{"0.8": gain + 0.1})))
    append(path, line("other", "dev-01", 1, found(**{"0.8": 0.9})))  # a seed that nothing is compared with
    append(path, line("other", "dev-02", 0, None, status="failed", error="exit status 2: it said so"))
    append(path, line("other", "dev-00", 0, found(1, **{"0.8": 0.2})))
    rows = [
        [cell.strip() for cell in row.split("|")[1:-1]] for row in exact_table(read_exact([path]), "ours").split("\n")
    ]
    ours, other, later = rows[2:]
    assert ours[:6] == ["ours", "0", "2 × 1", "10.0 %", "20.0 %", "15.0 %"] and ours[-3:] == ["3.0", "2", "–"]
    assert other[:3] == ["other", "0", "2 × 2"] and other[-1].startswith("+5.0 points (+5.0 to +5.0)")
    assert later[1] == "1" and later[-1] == "–"
    with pytest.raises(EvaluationError, match="Did you mean 'ours'"):
        exact_table(read_exact([path]), "our")
    with pytest.raises(EvaluationError, match="no candidates that were judged"):
        exact_table([])


@pytest.mark.slow
def test_the_instruments_of_the_reality_judge_whatever_paid(tmp_path):
    pytest.importorskip("hts_power", reason="its gauge knows the exact current")
    pytest.importorskip("hts_go1", reason="a robot with legs")
    folder = tmp_path / "run"
    arguments = [
        *TINY,
        "--set",
        "reward_source=proxy",
        "--out",
        str(folder),
    ]  # a formula: it records and fits nothing itself
    assert exact.make(0, arguments) == 0
    trained = folder / "iterations/00/finetune.json"
    assert trained.exists() and not (folder / "summary.json").exists()
    first, made = exact.kind(0).result(folder), trained.stat().st_mtime_ns
    assert isinstance(first, Exact) and first.last.id == "00-00" and set(first.last.saved["power"]) == {"0.8"}
    assert first.last.kl == json.loads(trained.read_text())["candidates"][0]["kl"]

    config = folder / "config.yaml"
    config.write_text(config.read_text().replace("dev-03", "dev-05"))  # another machine's instruments say otherwise
    assert exact.make(0, ["resume", str(folder)]) == 0
    other = exact.kind(0).result(folder)
    assert isinstance(other, Exact) and other.last.saved != first.last.saved
    assert trained.stat().st_mtime_ns == made
