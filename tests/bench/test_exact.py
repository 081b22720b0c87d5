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

from hts.errors import ConfigError, EvaluationError, RunError, UnfitWorldError

FAKE = (sys.executable, str(Path(__file__).parent / "fake_hts.py"))
TINY = [
    *("run", "--objective", "power", "--robot", "go1", "--preset", "smoke", "--set", "world.reality=dev-03"),
    *("--set", "finetune.steps=48", "--set", "finetune.num_envs=4", "--set", "finetune.ppo.horizon=12"),
    *("--set", "simulation_test.num_envs=2", "--set", "simulation_test.seconds=3", "--set", "world.block_seconds=3"),
    *("--set", "sweep.kl_bounds=[1.0]"),
]


def candidate(**changes) -> Judged:
    return Judged(
        **{
            "id": "00-00",
            "weights": {"power": 9.0},
            "kl_bound": None,
            "kl": 3.0,
            "falls": 1,
            "saved": {"power": {"0.5": 0.1, "1.0": 0.2}},
            "valid": {"0.5": 1.0, "1.0": 0.9},
            **changes,
        }
    )


def found(fast: float = 0.2, iteration: int = 0, *more: Judged, **changes) -> Exact:
    """One candidate and what it was half-way; fast: what it saves at 1 m/s, at 0.5 it is 10 %."""
    end = candidate(saved={"power": {"0.5": 0.1, "1.0": fast}}, **changes)
    half = candidate(id="00-00-50", share=0.5, saved={"power": {"0.5": -9.0}})
    return Exact(iteration=iteration, units={"power": "1"}, speeds=[0.5, 1], needed=0.5, candidates=[half, end, *more])


def line(method: str, reality: str, seed: int, result: Exact | None, **changes) -> ExactLine:
    given = whole_line(method=method, reality=reality, seed=seed).model_dump(exclude={"result"})
    told = {"commit": "c", "method_hash": f"{method}-{result.iteration if result else ''}", "reality_hash": reality}
    given |= {**told, "result": result, **changes}
    return ExactLine(**{**given, "key": f"{given['method_hash']}-{reality}-{seed}-{given['commit']}"})


def cells(lines, *arguments) -> list[list[str]]:
    """Rows of the table, without its head."""
    rows = [row for row in exact_table(lines, *arguments).split("\n") if row.startswith("|")]
    return [[cell.strip() for cell in row.split("|")[1:-1]] for row in rows[2:]]


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
    (tmp_path / exact.RESULT).write_text(found(iteration=1).model_dump_json())
    assert exact.kind(1).finished(tmp_path) and exact.kind(1).result(tmp_path) == found(iteration=1)
    with pytest.raises(RunError, match="is of iteration 1, expected 0"):
        exact.kind(0).result(tmp_path)


def test_the_table_pairs_by_reality_and_seed_and_takes_candidates_as_their_training_ended(tmp_path):
    path = tmp_path / "lines.jsonl"
    for reality, gain in (("dev-00", 0.1), ("dev-01", 0.3)):
        append(path, line("ours", reality, 0, found(gain)))
        append(path, line("other", reality, 0, found(gain + 0.1)))
    append(path, line("other", "dev-01", 1, found(0.9)))  # a seed that nothing is compared with
    append(path, line("other", "dev-02", 0, None, status="failed", error="exit status 2: it said so"))
    append(path, line("other", "dev-00", 0, found(0.2, 1)))
    lines = read_exact([path])
    ours, other, later = cells(lines, "ours")
    assert ours == ["ours", "0", "2 on 2", "10.0 %", "20.0 %", "15.0 %", "0 of 4", "0", "3.0", "1.0", "–"]
    assert other[2] == "3 on 2" and other[-1] == "+5.0 points (+5.0 to +5.0), 2 pairs on 2"
    assert later[1] == "1" and later[-1] == "–"
    assert exact_table(lines).endswith("failed: other, dev-02, seed 0: exit status 2: it said so")
    with pytest.raises(EvaluationError, match="Did you mean 'ours'"):
        exact_table(lines, "our")
    with pytest.raises(EvaluationError, match="no candidates that were judged"):
        exact_table([])


def test_a_speed_that_is_missed_counts_nothing_and_a_stopped_candidate_is_left_out():
    slow = line("a", "dev-00", 0, found(valid={"0.5": 0.4, "1.0": 1.0}))  # good in less than the final asks for
    lost = line("b", "dev-00", 0, found().model_copy(update={"candidates": [candidate(saved={"power": {"0.5": 0.3}})]}))
    ended = line("c", "dev-00", 0, found(stopped="it ran into a NaN"))
    a, b, c = cells([slow, lost, ended], "a")
    assert a[3:7] == ["0.0 %", "20.0 %", "10.0 %", "1 of 2"]
    assert b[3:7] == ["30.0 %", "0.0 %", "15.0 %", "1 of 2"] and b[-1].startswith("+5.0 points")
    assert c[3:] == ["–", "–", "–", "0 of 0", "1", "–", "–", "–"]


def test_each_candidate_of_a_sweep_has_its_row():
    second = candidate(id="00-01", saved={"power": {"0.5": 0.5, "1.0": 0.5}})
    rows = cells([line("ours", f"dev-{index:02d}", 0, found(0.2, 0, second)) for index in range(2)])
    assert [(row[0], row[5]) for row in rows] == [("ours, 00-00", "15.0 %"), ("ours, 00-01", "50.0 %")]


def test_what_cannot_stand_in_one_table_is_told_apart_or_refused():
    before, after = (line("ours", "dev-00", 0, found(gain), commit=f"{n}" * 40) for n, gain in ((1, 0.1), (2, 0.5)))
    rows = cells([before, after], "ours@1111111")
    assert [(row[0], row[5]) for row in rows] == [("ours@1111111", "10.0 %"), ("ours@2222222", "30.0 %")]
    assert rows[1][-1].startswith("+20.0 points")
    for changes, said in (
        ({"preset": "paper"}, "of the presets"),
        ({"reality_hash": "another"}, "Two realities are named 'dev-00'"),
        ({"method_hash": "another"}, "Two sets of options are named 'ours'"),
    ):
        with pytest.raises(EvaluationError, match=said):
            exact_table([line("ours", "dev-00", 0, found()), line("ours", "dev-00", 1, found(), **changes)])
    with pytest.raises(EvaluationError, match="noise"):
        exact_table([before], None, "noise")


def asked(**changes):
    given = {"objectives": ["power"], "robot": "go1", "preset": "quick", "commit": "c", **changes}
    return jobs_of({"ours": METHODS["ours"]}, ["dev-03"], [0], **given)


@pytest.mark.parametrize("iteration", [-1, 3])
def test_an_iteration_that_no_run_has_is_refused_before_anything_is_spent(iteration):
    pytest.importorskip("hts_power")
    pytest.importorskip("hts_go1")
    exact.check(asked(), 2)
    with pytest.raises(ConfigError, match="'ours' has 3 of them, 0 to 2"):
        exact.check(asked(), iteration)


def test_an_objective_that_no_instrument_measures_from_what_simulation_tells_is_refused():
    pytest.importorskip("hts_noise")
    pytest.importorskip("hts_go1")
    with pytest.raises(UnfitWorldError, match="'sound_level' depends on how fast"):
        exact.check(asked(objectives=["noise"]), 0)


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
    assert isinstance(first, Exact) and first.needed == 0.0  # of smoke
    end = first.ends[0]
    assert len(first.ends) == 3  # one for each λ of the formula
    assert end.id == "00-00" and set(end.saved["power"]) == set(end.valid) == {"0.8"}
    assert end.kl == json.loads(trained.read_text())["candidates"][0]["kl"]

    config = folder / "config.yaml"
    config.write_text(config.read_text().replace("dev-03", "dev-05"))  # another machine's instruments say otherwise
    assert exact.make(0, ["resume", str(folder)]) == 0
    other = exact.kind(0).result(folder)
    assert isinstance(other, Exact) and other.ends[0].saved != end.saved
    assert trained.stat().st_mtime_ns == made
