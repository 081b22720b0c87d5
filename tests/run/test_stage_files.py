"""Files of finished stages that are JSON and yet not what the stage wrote: one line that names them, nothing spent."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from hts import api
from hts.cli.main import main
from hts.config_loading import read_config
from hts.errors import RunError
from hts.report.data import read_run, without_segments
from hts.run import simulates_yet, testing_elites
from hts.run.belonging import check_results
from hts.run.stage_files import FILES, Collect, Test, read_stage

FIRST = "iterations/00"
STAGES = [
    "collect",
    *(f"{FIRST}/{stage}" for stage in ("fit", "finetune", "simulate", "gate", "test")),
    "final",
    "summary",
]


def changed(folder: Path, stage: str, change) -> Path:
    """The stage's file with what change(its content) gives."""
    path = folder / f"{stage}.json"
    path.write_text(json.dumps(change(json.loads(path.read_text()))))
    return path


def without(folder: Path, *stages: str) -> None:
    for stage in stages:
        (folder / f"{stage}.json").unlink()


def refused(folder: Path, path: Path, said: str) -> None:
    with pytest.raises(RunError, match=rf"^{path}: damaged \(.*{said}.*\)\. .* Delete it and resume: ") as caught:
        api.resume(folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("content", [{}, [], 3, None])
def test_a_file_that_holds_something_else_is_refused(broken_kit_run, stage, content):
    refused(broken_kit_run, changed(broken_kit_run, stage, lambda _: content), "")


@pytest.mark.parametrize(
    ("stage", "key"), [(FIRST + "/test", "best"), (FIRST + "/gate", "elites"), ("collect", "recordings")]
)
def test_a_key_that_is_missing_is_named(broken_kit_run, stage, key):
    path = changed(broken_kit_run, stage, lambda found: {name: one for name, one in found.items() if name != key})
    refused(broken_kit_run, path, f"{key}: this key is needed and missing")


def test_a_key_of_another_type_is_named(broken_kit_run):
    path = changed(broken_kit_run, "collect", lambda found: {**found, "samples": "many"})
    refused(broken_kit_run, path, "samples: expected a whole number, found 'many'")


@pytest.mark.parametrize("last", ["simulate", "gate", "test", "all"])
def test_a_changed_candidate_is_laid_to_the_file_that_is_at_fault(broken_kit_run, last):
    after = STAGES[STAGES.index(f"{FIRST}/{last}") + 1 :] if last != "all" else []
    without(broken_kit_run, *after)

    def renamed(found):
        found["candidates"][1]["id"] = "00-07"
        return found

    path = changed(broken_kit_run, f"{FIRST}/finetune", renamed)
    refused(broken_kit_run, path, "its candidates are 00-07, expected those of simulate.json: 00-00, 00-01")


def test_candidates_that_were_not_judged_are_laid_to_the_file_that_judged_them(broken_kit_run):
    def forgotten(found):
        for key in ("scores", "falls", "tracked"):
            del found[key]["00-01"]
        return found

    refused(broken_kit_run, changed(broken_kit_run, f"{FIRST}/simulate", forgotten), "nothing about 00-01")


@pytest.mark.parametrize(
    ("stage", "change", "said"),
    [
        ("gate", {"elites": ["00-09"]}, "the gate let pass 00-09"),
        ("gate", {"kept_out": {"00-09": "fell"}}, "the gate saw 00-09"),
        ("test", {"elites": ["00-09"]}, "nothing about 00-09"),
        ("test", {"results": {}}, "nothing about 00-0"),
        ("test", {"best_so_far": "00-09"}, "the best so far is 00-09"),
        ("simulate", {"elites": ["00-09"]}, "its elites are 00-09"),
    ],
)
def test_a_candidate_that_nobody_knows_is_named(broken_kit_run, stage, change, said):
    refused(broken_kit_run, changed(broken_kit_run, f"{FIRST}/{stage}", lambda found: {**found, **change}), said)


def test_a_gate_that_saw_another_policy_of_that_name_is_named(broken_kit_run):
    def another(found):
        first = next(iter(found["policies"]))
        return {
            **found,
            "policies": {**found["policies"], first: {**found["policies"][first], "policy_hash": "0" * 64}},
        }

    refused(
        broken_kit_run,
        changed(broken_kit_run, f"{FIRST}/gate", another),
        "the gate saw another 00-0., 000000000000, expected",
    )


def test_judged_candidates_of_another_run_are_laid_to_the_file_that_is_at_fault(broken_kit_run):
    def another(found):
        return {**found, "policy_hashes": {name: "0" * 64 for name in found["policy_hashes"]}}

    without(broken_kit_run, f"{FIRST}/gate", f"{FIRST}/test", "final", "summary")
    path = broken_kit_run / f"{FIRST}/simulate.json"
    whole = path.read_text()
    refused(
        broken_kit_run,
        changed(broken_kit_run, f"{FIRST}/simulate", another),
        "of another 00-00, policy 000000000000, expec",
    )
    path.write_text(whole)

    def tuned(found):
        return {**found, "candidates": [{**row, "policy_hash": "1" * 64} for row in found["candidates"]]}

    refused(
        broken_kit_run,
        changed(broken_kit_run, f"{FIRST}/finetune", tuned),
        "of another 00-00, policy 111111111111, expec",
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda found: {**found, "seed": 77}, "of another run: seed is 77, expected"),
        (lambda found: {**found, "final": {**found["final"], "policy": "05-01"}}, "final.policy is 05-01, expected"),
        (
            lambda found: {
                **found,
                "iterations": [
                    {**one, "candidates": [{**row, "kl": 9.0} for row in one["candidates"]]}
                    for one in found["iterations"]
                ],
            },
            "its 00-00 is none of the candidates of iteration 00",
        ),
    ],
)
def test_a_summary_of_another_run_is_named(broken_kit_run, change, said):
    refused(broken_kit_run, changed(broken_kit_run, "summary", change), said)


def test_what_an_earlier_version_did_not_write_is_missed_only_where_it_is_needed(kit_run, broken_kit_run):
    added = ("predicted", "task_rewards", "trials", "policy_hashes")

    def earlier(found):
        return {key: one for key, one in found.items() if key not in added}

    path = changed(broken_kit_run, f"{FIRST}/simulate", earlier)
    assert api.resume(broken_kit_run) == broken_kit_run
    without(broken_kit_run, f"{FIRST}/gate", f"{FIRST}/test", "final", "summary")
    refused(broken_kit_run, path, "nothing about predicted, task_rewards, trials")


def test_a_gate_that_was_deleted_after_its_elites_were_tested_is_asked_again(kit_run, broken_kit_run):
    path = broken_kit_run / f"{FIRST}/gate.json"
    whole = path.read_bytes()
    without(broken_kit_run, f"{FIRST}/gate", "final", "summary")
    config = read_config(broken_kit_run / "config.yaml")
    assert simulates_yet(config, broken_kit_run)
    api.resume(broken_kit_run)
    assert path.read_bytes() == whole and not simulates_yet(config, broken_kit_run)
    assert kit_run.summary_of(broken_kit_run) == kit_run.summary_of()


def test_a_run_that_a_version_without_a_gate_tested_has_none(broken_kit_run):
    config = yaml.safe_load((broken_kit_run / "config.yaml").read_text())
    del config["gate"]
    (broken_kit_run / "config.yaml").write_text(yaml.safe_dump(config))
    changed(broken_kit_run, "provenance", lambda kept: {name: kept[name] for name in kept if name != "config_sha256"})
    without(broken_kit_run, f"{FIRST}/gate", "final", "summary")
    assert not simulates_yet(read_config(broken_kit_run / "config.yaml"), broken_kit_run)
    api.resume(broken_kit_run)
    assert not (broken_kit_run / f"{FIRST}/gate.json").exists()


def test_a_report_is_not_made_of_a_summary_that_says_nothing(broken_kit_run):
    from hts.report import write_report

    path = changed(broken_kit_run, "summary", lambda _: {})
    before = (broken_kit_run / "report.html").read_bytes()
    with pytest.raises(
        RunError, match=rf"^{path}: damaged \(objectives: .* `hts resume {broken_kit_run}`: it is written"
    ):
        write_report(broken_kit_run)
    assert (broken_kit_run / "report.html").read_bytes() == before
    without(broken_kit_run, "summary")
    api.resume(broken_kit_run)
    write_report(broken_kit_run)


@pytest.mark.parametrize("content", ["", '{"power": ', "[]", '{"power": 3}', '{"power": {"0.8": {"policy": {}}}}'])
def test_damaged_segments_say_how_they_come_back(kit_run, broken_kit_run, content):
    path = broken_kit_run / "segments.json"
    whole = path.read_bytes()
    path.write_text(content)
    with pytest.raises(
        RunError, match=rf"^{path}: .*\. Delete it, final.json, summary.json and report.html, and `hts resume"
    ) as caught:
        read_run(broken_kit_run)
    assert "\n" not in str(caught.value)
    if not content:  # once is enough
        path.unlink()
        without(broken_kit_run, "final", "summary")
        api.resume(broken_kit_run)
        assert path.read_bytes() == whole and kit_run.summary_of(broken_kit_run) == kit_run.summary_of()


def test_a_report_without_segments_says_so(broken_kit_run, capsys):
    assert without_segments(read_run(broken_kit_run)) is None
    (broken_kit_run / "segments.json").unlink()
    assert main(["report", str(broken_kit_run)]) == 0
    said = capsys.readouterr().err
    assert said.startswith(f"{broken_kit_run}/segments.json: is missing, so the report lacks the figure")
    assert "Delete final.json, summary.json and report.html, and `hts resume" in said


AT = {"improvement": 0.2, "metrics": {"gross": 0.1}}
TRIED = {
    "elites": ["00-00"],
    "results": {
        "00-00": {
            "real": {"fake": {"0.8": AT}},
            "refused": None,
            "tested": {"fell": False, "selection_score": {"fake": 0.2}},
        }
    },
    "recordings": [],
    "best": "00-00",
    "best_so_far": "00-00",
    "samples": 1,
    "model_checks": {"fake": {"policies": [{"speed": 0.8, "measured": 1.0, "predicted": 2.0}]}},
    "trust_region": {"scale": 1.0},
}
JUDGED = {
    "scores": {},
    "falls": {},
    "tracked": {},
    "elites": [],
    "steps": 1,
    "predicted": {"00-00": {"fake": {"0.8": {"improvement": 0.1, "selection_score": 0.1}}}},
    "gave_up": {"elites": [], "line": None},
}
ENDED = {
    "policy": "00-00",
    "objectives": {"fake": {"unit": "1", "speeds": {"0.8": {"improvement": 0.2, "falls": 0}}, "open_loop": {}}},
    "recordings": [],
    "samples": 1,
}
FITTED = {
    "fake": {
        "dataset": "0",
        "held_out_r2": 0.5,
        "rank_correlation": None,
        "held_out": {"recordings": [], "spread": None, "proxy": {"smoothed": {"r2": 0.1}}},
        "weights": [0.1],
    }
}
TUNED = {"candidates": [], "steps": 1, "reward_scale": {}, "pull": {"pull": [0.1], "steps": 1}}


@pytest.mark.parametrize(
    ("stage", "whole", "key", "value"),
    [
        ("test", TRIED, "results.00-00.real.fake", {}),
        ("test", TRIED, "results.00-00.real.fake.0|8.improvement", None),
        ("test", TRIED, "results.00-00.real.fake.0|8.metrics", "odd"),
        ("test", TRIED, "results.00-00.real.fake.0|8.metrics.gross", None),
        ("test", TRIED, "results.00-00.tested.selection_score.fake", None),
        ("test", TRIED, "model_checks.fake", {}),
        ("test", TRIED, "model_checks.fake.policies", [{"measured": 1.0, "predicted": 2.0}]),
        ("test", TRIED, "model_checks.fake.policies", [{"speed": 0.8, "measured": 1.0, "predicted": None}]),
        ("test", TRIED, "model_checks.fake.proxy", {"smoothed": {}}),
        ("test", TRIED, "trust_region.scale", -3.0),
        ("simulate", JUDGED, "predicted.00-00.fake.0|8", {}),
        ("simulate", JUDGED, "predicted.00-00.fake.0|8.selection_score", "odd"),
        ("simulate", JUDGED, "gave_up", 3),
        ("fit", FITTED, "fake.held_out", {}),
        ("fit", FITTED, "fake.held_out.spread", 3),
        ("fit", FITTED, "fake.held_out.proxy.smoothed", 3),
        ("fit", FITTED, "fake.same_session", 3),
        ("fit", FITTED, "fake.weights", "odd"),
        ("finetune", TUNED, "pull", {"pull": "odd"}),
        ("finetune", TUNED, "reward_scale", 3),
        ("final", ENDED, "objectives.fake.speeds.0|8", {"improvement": 0.2}),
        ("final", ENDED, "objectives.fake.open_loop", 3),
    ],
)
def test_all_that_a_later_stage_reads_is_looked_at(tmp_path, stage, whole, key, value):
    path = tmp_path / f"{stage}.json"
    path.write_text(json.dumps(whole))
    assert read_stage(path) == whole
    odd = json.loads(path.read_text())
    *above, last = (part.replace("|", ".") for part in key.split("."))
    inside = odd
    for part in above:
        inside = inside[part]
    inside[last] = value
    path.write_text(json.dumps(odd))
    with pytest.raises(
        RunError, match=rf"^{path}: damaged \({key.replace('|', '.')}.*Delete it and resume: "
    ) as caught:
        read_stage(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("missing", ["real", "tested"])
def test_a_best_policy_that_was_not_measured_is_named(tmp_path, missing):
    row = {**TRIED["results"]["00-00"], missing: None}
    path = tmp_path / "iterations/00/test.json"
    found = {**TRIED, "results": {"00-00": row}}
    job = SimpleNamespace(
        path=lambda stage, iteration: path, read=lambda stage, iteration: found, objectives={"fake": None}
    )
    with pytest.raises(RunError, match=rf"^{path}: damaged \(nothing about what was measured of 00-00\)"):
        testing_elites.tested_before(job, "00-00")


def test_a_trial_that_counts_and_measured_nothing_is_named(tmp_path):
    path = tmp_path / "test.json"
    rows = {"00-00": {**TRIED["results"]["00-00"], "real": None}}
    with pytest.raises(RunError, match=rf"^{path}: damaged \(nothing about what was measured of 00-00\)"):
        check_results(path, rows, ["fake"])


def test_every_file_of_a_finished_run_passes(kit_run):
    read = [path for path in kit_run.folder.rglob("*.json") if path.stem in FILES and "policies" not in path.parts]
    assert len(read) >= 8
    for path in read:
        assert read_stage(path) == json.loads(path.read_text())


def test_a_key_that_a_later_version_adds_is_let_alone():
    Collect.model_validate({"recordings": [], "samples": 0, "later": 1})
    assert "later" not in Test.model_fields
