"""Where nobody of an iteration may be tried, its candidates are judged once more, closer to their anchors."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from pathlib import Path

import pytest
import torch

from hts.config import GateConfig
from hts.contracts import SimulatedCandidate
from hts.errors import HtsError
from hts.policies.files import load_policy
from hts.run import gate, judging, nearer, resume_run
from hts.selection.hierarchical import Hierarchical
from hts.testing.packages import kit_installed
from hts.training.sweep import is_nearer, nearer_id

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from batch.harvest import result_of


def refused_if(monkeypatch, fails):
    """The gate refuses those of whom `fails` says so, and nobody else."""
    of = gate.Trials.of

    def pretend(self, names):
        rows = of(self, names)
        for name in names:
            failed = ["tilt"] if fails(name) else []
            refused = f"{name} is refused by the gate: made up" if failed else None
            rows[name] |= {"passed": not failed, "failed": failed, "refused": refused}
        return rows

    monkeypatch.setattr(gate.Trials, "of", pretend)


@pytest.fixture
def run(run_on):
    """run(path, stage, **settings): what comes before the stage, where a test begins to change things, is shared."""

    def run(path, stage="gate", **settings):
        asked = {"sweep.kl_bounds": [0.5, 2.0], "gate.strict": True, "gate.nearer": [0.25, 0.5], **settings}
        return run_on(f"iterations/00/{stage}", path, asked)

    return run


def stage(path, name):
    return json.loads((path / f"iterations/00/{name}.json").read_text())


def test_who_passes_nearer_to_the_anchor_is_tried(run, tmp_path, monkeypatch, capsys):
    refused_if(monkeypatch, lambda name: not name.endswith("-w50"))
    path = tmp_path / "run"
    found = run(path)
    added = stage(path, "nearer")
    ids = [row["id"] for row in added["candidates"]]
    assert ids == ["00-00-w50", "00-01-w50"]  # the larger share first, and no other where somebody passes
    (elite,) = added["gate"]["elites"]
    assert elite.endswith("-w50") and stage(path, "gate")["elites"] == []
    assert stage(path, "test")["elites"] == [elite] and elite in stage(path, "test")["results"]

    iteration = found.summary["iterations"][0]
    rows = {row["id"]: row for row in iteration["candidates"]}
    assert list(rows) == ["00-00", "00-01", *ids]
    assert [name for name, row in rows.items() if row["elite"]] == [elite]
    assert rows[elite]["way"] == 0.5 and "way" not in rows["00-00"]
    assert rows[elite]["gate"]["passed"] and rows[elite]["real"] and rows[elite]["predicted"]
    assert iteration["gate"]["elites"] == [elite] and {"00-00", "00-01"} <= set(iteration["gate"]["refused"])
    steps = [stage(path, name)["steps"] for name in ("finetune", "simulate", "gate")]
    assert found.summary["sim_steps"] == sum(steps) + added["simulate"]["steps"] + added["gate"]["steps"]
    said = " ".join(capsys.readouterr().out.split())
    assert "nobody of this iteration may be tried, so candidates are judged at 50 %, then 25 % of the way" in said
    assert f"{elite} passed the gate, at 50 % of the way" in said and "so nobody is" not in said
    warnings = " ".join(iteration["warnings"])
    assert f"{elite} passed the gate" in warnings and "so nobody is" not in warnings

    line = result_of(path)
    assert {one.id: one.gate for one in line.tried} == {elite: True}


def test_it_lies_on_the_way_and_its_distance_is_measured(run, tmp_path, monkeypatch):
    refused_if(monkeypatch, lambda name: True)
    path = tmp_path / "run"
    run(path)
    start = load_policy(path / "policies/pretrained")
    rows = {row["id"]: row for row in (*stage(path, "finetune")["candidates"], *stage(path, "nearer")["candidates"])}
    for end in ("00-00", "00-01"):
        whole = load_policy(path / f"iterations/00/candidates/{end}")
        moved = vector(whole) - vector(start)
        for share in (0.5, 0.25):
            name = nearer_id(end, share)
            part = load_policy(path / f"iterations/00/candidates/{name}")
            off = vector(part) - vector(start) - share * moved
            assert off.norm() < 0.05 * moved.norm() and moved.norm() > 0
            assert part.card.policy_hash == rows[name]["policy_hash"] and part.card.made["kl"] == rows[name]["kl"]
            assert (path / f"iterations/00/candidates/{name}.onnx").is_file()
        # A Gaussian's KL grows with the square of a small step, so it falls by nearly four with each half.
        half, quarter = (rows[nearer_id(end, share)]["kl"] for share in (0.5, 0.25))
        assert 0 < quarter < half and 2.5 < half / quarter < 6.0


def vector(policy):
    """All numbers of it, as float64: a tiny training moves them by little."""
    return torch.cat([policy.tensors[name].double().flatten() for name in sorted(policy.tensors)])


def test_who_fell_while_being_judged_is_asked_again_nearer(run, tmp_path, monkeypatch):
    judge = judging._judge

    def far_ones_fall(row, *rest):
        return dataclasses.replace(judge(row, *rest), falls=int(not row["id"].endswith("-w25")))

    monkeypatch.setattr(judging, "_judge", far_ones_fall)
    refused_if(monkeypatch, lambda name: False)
    path = tmp_path / "run"
    found = run(path, "simulate")
    assert stage(path, "gate")["policies"] == {}
    (elite,) = stage(path, "nearer")["gate"]["elites"]
    assert elite.endswith("-w25")
    assert set(found.summary["iterations"][0]["gate"]["kept_out"]) == {"00-00", "00-01", "00-00-w50", "00-01-w50"}


@pytest.mark.slow
def test_where_they_fail_as_well_nobody_is_tried(run, tmp_path, monkeypatch, capsys):
    refused_if(monkeypatch, lambda name: True)
    found = run(tmp_path / "run")
    assert found.summary["final"]["policy"] == "pretrained"
    assert stage(tmp_path / "run", "test")["elites"] == []
    said = " ".join(capsys.readouterr().out.split())
    assert "nobody was tested: the gate before reality refused 6" in said
    assert sum("so nobody is" in line for line in found.summary["iterations"][0]["warnings"]) == 1
    steps = [stage(tmp_path / "run", "nearer")[name]["steps"] for name in ("simulate", "gate")]
    once = [stage(tmp_path / "run", name)["steps"] for name in ("simulate", "gate")]
    assert steps[0] == 2 * once[0] and 0 < steps[1] < 2 * once[1]  # the pretrained policy is tried once


@pytest.mark.parametrize("damaged", ["nearer.json", "candidates/{elite}.safetensors"], ids=["result", "policy"])
def test_what_is_damaged_is_made_again_as_the_line_says(run, tmp_path, monkeypatch, damaged):
    refused_if(monkeypatch, lambda name: not is_nearer(name))
    path = tmp_path / "run"
    found = run(path)
    (elite,) = stage(path, "test")["elites"]
    for name in ("final", "summary"):
        (path / f"{name}.json").unlink()
    broken = path / "iterations/00" / damaged.format(elite=elite)
    broken.write_bytes(broken.read_bytes()[:20])
    with kit_installed():
        with pytest.raises(HtsError, match=r"nearer\.json") as told:
            resume_run(path)
        assert "elete " in str(told.value)
        (path / "iterations/00/nearer.json").unlink()
        resume_run(path)
    again = json.loads((path / "summary.json").read_text())
    assert again["final"] == found.summary["final"]
    assert again["iterations"][0]["candidates"] == found.summary["iterations"][0]["candidates"]


def test_what_was_there_before_the_training_is_not_brought_nearer(monkeypatch):
    class FewestOfAJob:
        def untrained(self, iteration):
            return [{"id": "00-start"}]

        def read(self, stage, iteration):
            assert (stage, iteration) == ("finetune", 0)
            return {"candidates": [{"id": name, "stopped": why} for name, why in rows.items()]}

    rows = {"00-00": None, "00-01": "NaN at step 3", "00-start": None}
    assert [row["id"] for row in nearer._trained(FewestOfAJob(), 0)] == ["00-00"]


def test_a_selector_that_names_nobody_is_taken_at_its_word(run, tmp_path, monkeypatch):
    monkeypatch.setattr(Hierarchical, "elites", lambda self, candidates, count: [])
    run(tmp_path / "run", "simulate")
    assert not (tmp_path / "run/iterations/00/nearer.json").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings", [{"gate.strict": False}, {"gate.nearer": []}, {"gate.enabled": False}], ids=["lenient", "none", "off"]
)
def test_it_is_not_done_where_nobody_asks_for_it(run, tmp_path, monkeypatch, settings):
    refused_if(monkeypatch, lambda name: True)
    run(tmp_path / "run", "simulate", **settings)
    assert not (tmp_path / "run/iterations/00/nearer.json").exists()


def test_nor_where_somebody_passes(run, tmp_path, monkeypatch):
    refused_if(monkeypatch, lambda name: name == "00-00")
    run(tmp_path / "run")
    assert not (tmp_path / "run/iterations/00/nearer.json").exists()
    assert stage(tmp_path / "run", "test")["elites"] == ["00-01"]


@pytest.mark.parametrize(
    ("shares", "said"),
    [((0.0,), "share"), ((1.0,), "share"), ((-0.5,), "share"), ((math.nan,), "finite"), ((0.5, 0.501), "share")],
)
def test_shares_that_make_no_sense_are_refused(shares, said):
    with pytest.raises(ValueError, match=said):
        GateConfig(nearer=shares)


def first_of(path, name):
    """Whether that is the candidate whom the selector named first."""
    return name == stage(path, "simulate")["elites"][0]


FIRST = {"gate.nearer_for": "first", "selection.elites": 2}


def test_where_the_first_may_not_be_tried_it_is_judged_nearer_beside_who_passed(run, tmp_path, monkeypatch, capsys):
    path = tmp_path / "run"
    refused_if(monkeypatch, lambda name: first_of(path, name))
    found = run(path, **FIRST)
    first, other = stage(path, "simulate")["elites"]
    added = stage(path, "nearer")
    closer = nearer_id(first, 0.5)
    assert [row["id"] for row in added["candidates"]] == [closer]  # of who passed nothing is looked at once more
    assert stage(path, "gate")["elites"] == [other] and added["gate"]["elites"] == [closer]
    assert set(added["elites"]) == {closer, other} == set(stage(path, "test")["elites"])
    iteration = found.summary["iterations"][0]
    assert {row["id"] for row in iteration["candidates"] if row["elite"]} == {closer, other}
    assert set(iteration["gate"]["elites"]) == {closer, other} and iteration["gate"]["refused"] == [first]
    said = " ".join(capsys.readouterr().out.split())
    assert f"{first} may not be tried, so it is judged at 50 %, then 25 % of the way from its anchor" in said
    assert f"{closer} passed the gate, at 50 % of the way" in said

    for name in ("final", "summary"):
        (path / f"{name}.json").unlink()
    with kit_installed():
        resume_run(path)
    assert json.loads((path / "summary.json").read_text())["iterations"][0]["candidates"] == iteration["candidates"]


def test_the_selector_chooses_of_both_as_many_as_are_tried(run, tmp_path, monkeypatch):
    path = tmp_path / "run"
    refused_if(monkeypatch, lambda name: first_of(path, name))
    asked = []

    def last_named(self, candidates, count):
        asked.append(([one.id for one in candidates], count))
        return sorted((one.id for one in candidates), reverse=True)[:count]

    monkeypatch.setattr(Hierarchical, "elites", last_named)
    run(path, "simulate", **{**FIRST, "selection.elites": 1})
    first, other, closer = "00-01", "00-00", nearer_id("00-01", 0.5)
    assert stage(path, "simulate")["elites"] == [first] and stage(path, "gate")["elites"] == [other]
    assert asked[-1] == ([other, closer], 1)
    assert stage(path, "nearer")["elites"] == [closer] == stage(path, "test")["elites"]


def test_where_it_fails_nearer_as_well_those_that_passed_are_tried(run, tmp_path, monkeypatch, capsys):
    path = tmp_path / "run"
    refused_if(monkeypatch, lambda name: first_of(path, name) or is_nearer(name))
    found = run(path, **FIRST)
    first, other = stage(path, "simulate")["elites"]
    assert [row["id"] for row in stage(path, "nearer")["candidates"]] == [nearer_id(first, s) for s in (0.5, 0.25)]
    assert stage(path, "nearer")["elites"] == [other] == stage(path, "test")["elites"]
    gate_seen = found.summary["iterations"][0]["gate"]
    assert gate_seen["proposed"][:2] == [first, other]
    assert "so nobody is" not in capsys.readouterr().out and not any("so nobody" in one for one in gate_seen["lines"])


def test_who_comes_behind_those_that_passed_is_not_asked_again(run, tmp_path, monkeypatch):
    path = tmp_path / "run"
    refused_if(monkeypatch, lambda name: not first_of(path, name))
    run(path, **FIRST)
    assert not (path / "iterations/00/nearer.json").exists()
    assert stage(path, "test")["elites"] == stage(path, "simulate")["elites"][:1]


def test_who_fell_while_being_judged_may_be_the_first(run, tmp_path, monkeypatch):
    judge, path = judging._judge, tmp_path / "run"

    def ends_fall(row, *rest):
        return dataclasses.replace(judge(row, *rest), falls=int(row["id"] == "00-01"))

    monkeypatch.setattr(judging, "_judge", ends_fall)
    monkeypatch.setattr(
        Hierarchical, "elites", lambda self, candidates, count: [c.id for c in candidates][::-1][:count]
    )
    refused_if(monkeypatch, lambda name: False)
    run(path, "simulate", **FIRST)
    assert stage(path, "gate")["kept_out"].keys() == {"00-01"} and stage(path, "gate")["elites"] == ["00-00"]
    assert stage(path, "nearer")["elites"] == [nearer_id("00-01", 0.5), "00-00"]


def test_a_result_that_lets_a_stranger_pass_is_told(run, tmp_path, monkeypatch):
    path = tmp_path / "run"
    refused_if(monkeypatch, lambda name: first_of(path, name))
    run(path, **FIRST)
    damaged = stage(path, "nearer")
    (path / "iterations/00/nearer.json").write_text(json.dumps({**damaged, "elites": [damaged["elites"][0], "00-07"]}))
    (path / "summary.json").unlink()
    with kit_installed(), pytest.raises(HtsError, match=r"nearer\.json: .*lets pass 00-07"):
        resume_run(path)


def test_who_comes_back_is_held_to_the_steadiness_of_those_beside_whom_it_is_put():
    """Alone, the one that comes back is the steadiest of its own; where others do their task in enough, it does not."""
    rows = [{"id": name, "stopped": None} for name in ("00-00", "00-00-50", "00-00-w50")]
    trials = {"00-00": [{"valid": 0.95}], "00-00-50": [{"valid": 0.9}], "00-00-w50": [{"valid": 0.95}, {"valid": 0.6}]}
    able = [SimulatedCandidate(name, 1.0, 0, True, {"calm": 1.0}) for name in ("00-00-50", "00-00-w50")]
    assert [one.tracked for one in nearer.by_one_measure(able, 0.7, rows, trials)] == [True, False]
    assert [one.tracked for one in nearer.by_one_measure(able[1:], 0.7, rows[2:], trials)] == [True]
    assert not nearer.by_one_measure([dataclasses.replace(able[0], tracked=False)], 0.7, rows, trials)[
        0
    ].tracked  # what was not, is not
