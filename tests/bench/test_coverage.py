"""Coverage: lines that were made up say what is known, and the runner makes each line once."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

import numpy as np
import pytest
from batch.coverage import Work, policies_of, run_coverage, works_of
from batch.coverage_command import add_to
from batch.coverage_lines import (
    Counted,
    CoverageLine,
    Found,
    Lengths,
    Occasion,
    coverage,
    coverage_table,
    pairs_table,
    read_coverage,
    share,
)
from batch.coverage_sessions import own_of_sessions, student_of_sessions
from batch.queue import STOPPED

from hts.errors import EvaluationError, PolicyError, RunError, WorldError

LENGTHS = Lengths(sessions=2, warmup=1.0, trimming=4.0, block=5.0)


def made_up(reality="dev-00", repetition: int | None = 0, saved=0.2, half=0.01, as_one=0.002, policy="a", **changes):
    """An evaluation that found `saved` at 0.8 m/s to within `half`, or the truth."""
    truth = repetition is None
    found = Found(
        improvement=saved,
        improvement_ci95=(saved - half, saved + half),
        as_one=None if truth else (saved - as_one, saved + as_one),
        occasions=[] if truth else [Occasion(improvement=saved, improvement_ci95=None)],
        mean_speed=0.8,
        reference_speed=0.8,
    )
    given = {
        "kind": "truth" if truth else "evaluation",
        "key": f"{policy}{reality}{repetition}",
        "objective": "power",
        "unit": "1",
        "policy": policy,
        "policy_hash": policy,
        "reference_hash": "r",
        "reality": reality,
        "reality_hash": reality,
        "repetition": repetition,
        "lengths": LENGTHS,
        "commit": "c",
        "speeds": {"0.8": found},
        "seconds": 1.0,
        **changes,
    }
    return CoverageLine(**given)


def batch():
    """Two realities with a truth of 20 %; three of four evaluations hold it, and one of four as one session."""
    truths = [made_up(reality, None) for reality in ("dev-00", "dev-01")]
    return [
        *truths,
        made_up("dev-00", 0, 0.201),
        made_up("dev-00", 1, 0.205),
        made_up("dev-01", 0, 0.195),
        made_up("dev-01", 1, 0.23),
    ]


def row_of(text: str, kind: str) -> list[str]:
    (found,) = [row for row in text.splitlines() if row.startswith(f"| {kind} | all |")]
    return [cell.strip() for cell in found.strip("|").split("|")]


def test_pooled_coverage_is_the_share_that_holds_the_truth_with_realities_as_clusters():
    row = row_of(coverage_table(batch()), "sessions as units")
    assert row[2:4] == ["2", "4"] and row[4].startswith("75.0 % (")
    assert row[5] == "1.0 points"
    assert row[6] == "1.5 points" and row[7] == "+0.8 points"  # +0.1, +0.5, −0.5, +3
    assert row_of(coverage_table(batch()), "blocks as units, sessions pooled")[4].startswith("25.0 % (")


def test_the_pieces_that_an_evaluation_counts_have_a_truth_of_their_own():
    lines = batch()
    assert "against the pieces" not in coverage_table(lines) and "near the asked speed" not in coverage_table(lines)
    counted = Counted(improvement=0.225, improvement_ci95=(0.224, 0.226), valid=0.9, reference_valid=1.0)
    for line in lines[:2]:
        line.speeds["0.8"] = line.speeds["0.8"].model_copy(update={"counted": counted})
    text = coverage_table(lines)
    (row,) = [line for line in text.splitlines() if "against the pieces that it counts" in line]
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[3] == "4" and cells[4].startswith("25.0 % (")  # 0.22 to 0.24 alone holds it
    assert cells[7] == "−1.7 points"
    assert "Of 2 truths the pieces near the asked speed say +2.5 points in the mean" in text
    assert row_of(text, "sessions as units") == row_of(coverage_table(batch()), "sessions as units")
    assert "of the pairs in the next row" not in text


def test_two_truths_are_compared_on_the_same_pairs():
    lines = batch()
    counted = Counted(improvement=0.2, improvement_ci95=(0.19, 0.21), valid=0.9, reference_valid=1.0)
    lines[0].speeds["0.8"] = lines[0].speeds["0.8"].model_copy(update={"counted": counted})  # dev-00 alone
    rows = [line.split("|")[2:5] for line in coverage_table(lines).splitlines() if line.startswith("| sessions as")]
    found = {of.strip(): evaluations.strip() for (of, realities, evaluations) in rows}
    assert found["all"] == "4"
    assert found["all, of the pairs in the next row"] == found["all, against the pieces that it counts"] == "2"


def test_every_second_is_held_against_the_truth_of_all_pieces():
    lines = batch()
    assert "every second" not in coverage_table(lines)
    for line in lines[2:]:
        every = Occasion(improvement=0.2, improvement_ci95=(0.19, 0.21))
        line.speeds["0.8"] = line.speeds["0.8"].model_copy(update={"every_second": every})
    row = row_of(coverage_table(lines), "sessions as units, every second")
    assert row[3] == "4" and row[4].startswith("100.0 % (") and row[7] == "+0.0 points"


def test_a_truth_is_held_against_intervals_as_uncertain_as_it_is():
    lines = batch()
    for line in lines[:2]:  # ±4 points: the evaluation that says 23 ± 1 % is 3 away, and √17 would be still inside
        wide = line.speeds["0.8"].model_copy(update={"improvement_ci95": (0.16, 0.24)})
        line.speeds["0.8"] = wide
    (row,) = [line for line in coverage_table(lines).splitlines() if "as uncertain as they are" in line]
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[4].startswith("100.0 % (") and cells[5] == "4.1 points" and cells[7] == "+0.8 points"
    found = coverage(lines, "sessions as units", against="uncertain")["dev-01"][1]
    assert found[1] == pytest.approx((0.23 - 17**0.5 / 100, 0.23 + 17**0.5 / 100))
    assert "1 lie above the truth and 0 below it" in coverage_table(lines)


def with_sessions(values: list[float]) -> list[CoverageLine]:
    """A truth and one evaluation of four sessions each, out of these in turn."""
    lines = [made_up(repetition=None, saved=float(np.mean(values)))]
    for number in range(0, len(values), 4):
        line = made_up(repetition=number, lengths=LENGTHS.model_copy(update={"sessions": 4}))
        occasions = [Occasion(improvement=value, improvement_ci95=None) for value in values[number : number + 4]]
        line.speeds["0.8"] = line.speeds["0.8"].model_copy(update={"occasions": occasions})
        lines.append(line)
    return lines


def test_what_students_interval_loses_is_drawn_from_the_sessions_alone():
    random = np.random.default_rng(1)
    normal = student_of_sessions(with_sessions(list(random.normal(0.2, 0.01, 4000)))[1:])
    assert normal.above + normal.below == pytest.approx(0.05, abs=0.01)
    rare = np.where(random.random(4000) < 0.1, 0.0, random.normal(0.2, 0.01, 4000))  # one in ten saves nothing
    found = student_of_sessions(with_sessions(list(rare))[1:])
    assert 0.4 < found.above < 0.9**4 + 0.02  # none of the four is one of them: 20 % and a narrow interval, truly 18 %
    assert found.above > 10 * found.below and found.pairs == 1
    assert student_of_sessions(with_sessions([0.2] * 36)[1:]) is None
    assert "Of as many sessions as an evaluation has" in coverage_table(with_sessions(list(rare)))
    assert "Of as many sessions as an evaluation has" not in coverage_table(batch())


def test_what_sessions_have_of_their_own_is_what_their_blocks_do_not_show():
    """Sessions scatter by 5 points, their blocks show 3: 4 are their own, and a half, of which they have two, 3 √2."""
    random, half = np.random.default_rng(0), 0.03 * 2.306
    values = 0.2 + 0.05 * random.standard_normal(4000)
    sessions = [Occasion(improvement=one, improvement_ci95=(one - half, one + half)) for one in values]
    line = made_up()
    line.speeds["0.8"] = line.speeds["0.8"].model_copy(update={"occasions": sessions})
    found = own_of_sessions([line])
    assert (found.pairs, found.sessions) == (1, 4000)
    assert found.own[1] == pytest.approx(0.04, abs=0.002) and found.half[1] == pytest.approx(0.0424, abs=0.0005)
    assert found.ratio[1] == pytest.approx(0.94, abs=0.05)
    assert own_of_sessions(batch()) is None  # too few of them


def test_realities_that_agree_leave_the_doubt_of_so_many_intervals():
    lines = [made_up(name, None, saved=0.2) for name in ("dev-00", "dev-01")]
    lines += [made_up(name, number, saved=0.2) for name in ("dev-00", "dev-01") for number in range(4)]
    cell = row_of(coverage_table(lines), "sessions as units")[4]
    assert cell == "100.0 % (63.1 to 100.0)"  # 0.025 ** (1 / 8)


def test_a_session_without_an_interval_says_nothing_of_coverage():
    assert "one session alone" not in coverage_table(batch())


def test_coverage_can_be_cut_by_speed_and_policy():
    lines = [*batch(), made_up("dev-00", None, policy="b", saved=0.1), made_up("dev-00", 0, policy="b", saved=0.2)]
    found = coverage(lines, "sessions as units", policy="b")
    assert share(found).estimate == 0.0 and list(found) == ["dev-00"]
    assert coverage(lines, "sessions as units", speed="1.1") == {}
    assert "| sessions as units | b |" in coverage_table(lines)


def at_speeds(line: CoverageLine, *speeds: str) -> CoverageLine:
    return line.model_copy(update={"speeds": dict.fromkeys(speeds, line.speeds["0.8"])})


def test_a_second_truth_with_fewer_speeds_takes_no_interval_away():
    """Truth and three evaluations at two speeds; another truth of the pair at one of them, before or after."""
    whole, part = at_speeds(made_up(repetition=None), "0.5", "0.8"), made_up(repetition=None, key="t2", saved=0.9)
    evaluations = [at_speeds(made_up(repetition=number), "0.5", "0.8") for number in range(3)]
    for lines in ([whole, *evaluations], [whole, *evaluations, part], [part, whole, *evaluations]):
        assert len(coverage(lines, "sessions as units")["dev-00"]) == 6
        text = coverage_table(lines)
        assert ("; truths left out, as another of their pair has more speeds: 1;" in text) == (part in lines)
        assert row_of(text, "sessions as units") == row_of(coverage_table([whole, *evaluations]), "sessions as units")
        assert len(pairs_table(lines).splitlines()) == 2 + 2


def test_of_two_truths_at_the_same_speeds_the_last_counts():
    lines = [made_up(repetition=None, saved=0.1), made_up(repetition=None, key="t2"), made_up(saved=0.2)]
    ((_, _, truth),) = coverage(lines, "sessions as units")["dev-00"]
    assert truth == 0.2 and "truths left out" not in coverage_table(lines)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (
            [at_speeds(made_up(repetition=None), "0.5"), made_up(repetition=None, key="t2"), made_up()],
            "Two truths of a on dev-00 are at 0.5 and at 0.8 m/s: neither is the whole. Make one at all",
        ),
        ([made_up(repetition=None)], "No line is an evaluation"),
        ([made_up()], "no truth. Run `coverage run` to its end"),
        ([*batch(), made_up(objective="noise", unit="dB(A)")], r"several objectives \(noise, power\)"),
    ],
)
def test_what_cannot_be_pooled_is_one_line(lines, said):
    with pytest.raises(EvaluationError, match=said):
        coverage_table(lines)


def test_lines_are_checked_and_a_later_one_of_a_key_counts(tmp_path):
    path = tmp_path / "lines.jsonl"
    path.write_text("".join(made_up(saved=saved).model_dump_json() + "\n" for saved in (0.1, 0.3)))
    (one,) = read_coverage([path])
    assert one.speeds["0.8"].improvement == 0.3
    path.write_text(json.dumps({"kind": "truth"}) + "\n")
    with pytest.raises(RunError, match=r"line 1: key: Field required. Expected a line of version 1"):
        read_coverage([path])


# -------------------------------------------------------------------------------------------------- the runner


def pretend(work: Work) -> CoverageLine:
    """A line at once; on the default twin nothing can be evaluated while there is a file FAIL."""
    if work.reality == "default" and work.repetition is not None and Path(os.environ["FAIL"]).exists():
        raise WorldError("it broke")
    return made_up(Path(work.reality).stem, work.repetition, policy=work.name, key=work.key)


@pytest.fixture
def policies(tmp_path):
    """Two files of the policy that the robot ships, as ONNX."""
    pytest.importorskip("hts_go1", reason="its policy is not installed")
    pytest.importorskip("hts_power", reason="its objective is not installed")
    from hts.worlds.realities.batch import exported_policy

    folder = tmp_path / "runs" / "first" / "policies"
    folder.mkdir(parents=True)
    first = exported_policy("go1", folder).rename(folder / "best.onnx")
    (tmp_path / "again.onnx").write_bytes(first.read_bytes())
    return {"first": first, "again": tmp_path / "again.onnx"}


def works(policies, names=("first",), repetitions=2, evaluated=LENGTHS, commit="c", settings=()):
    return works_of(
        {name: policies[name] for name in names},
        policies["first"],
        ["dev-00", "default"],
        repetitions,
        objective="power",
        robot="go1",
        preset="quick",
        settings=["evaluation.speeds=[0.8]", *settings],
        evaluated=evaluated,
        true=LENGTHS,
        commit=commit,
    )


def test_policies_are_files_runs_and_folders_of_runs(policies, tmp_path):
    assert policies_of([tmp_path / "runs"]) == {"first": policies["first"]}
    assert policies_of([tmp_path / "runs" / "first", policies["again"]]) == policies
    assert policies_of([tmp_path]) == {"again": policies["again"]}  # a folder of files
    with pytest.raises(PolicyError, match=r"expected an .onnx file, a finished run's folder"):
        policies_of([tmp_path / "nowhere"])


def test_policies_of_one_name_are_told_apart_by_their_folders(tmp_path):
    for batch_of_runs in "ABC":
        for run in ("dev-00", "dev-01"):
            folder = tmp_path / batch_of_runs / run / "policies"
            folder.mkdir(parents=True)
            (folder / "best.onnx").touch()
    (tmp_path / "other.onnx").touch()
    best = {f"{a}/{b}": tmp_path / a / b / "policies/best.onnx" for a in "ABC" for b in ("dev-00", "dev-01")}
    assert policies_of([tmp_path / name for name in "ABC"]) == best
    files = policies_of([*best.values(), tmp_path / "other.onnx", best["A/dev-00"]])  # one of them twice
    assert files == {**{f"{key}/policies/best": file for key, file in best.items()}, "other": tmp_path / "other.onnx"}
    assert list(policies_of([tmp_path / "A"])) == ["dev-00", "dev-01"]


def test_truths_come_first_and_repetitions_in_turn(policies):
    made = works(policies)
    assert [(work.repetition, work.reality) for work in made] == [
        (repetition, reality) for repetition in (None, 0, 1) for reality in ("dev-00", "default")
    ]
    assert len({work.key for work in made}) == len(made)
    longer = works(policies, evaluated=LENGTHS.model_copy(update={"block": 80.0, "trimming": 20.0}))
    same = [one.key == other.key for one, other in zip(made, longer, strict=True)]
    assert same == [True, True, False, False, False, False]  # a truth does not hang on how long evaluations are
    assert works(policies, commit="d")[0].key != made[0].key
    narrower = works(policies, settings=["finetune.env.commands.vx=[0.3, 1.2]"])  # commands are trimmed within it
    assert not {one.key for one in made} & {one.key for one in narrower}


def test_truths_and_evaluations_can_be_asked_for_apart(policies, tmp_path, capsys):
    policy, listed = str(policies["first"]), {}
    for only in ([], ["--only", "truths"], ["--only", "evaluations"]):
        parser = argparse.ArgumentParser()
        add_to(parser.add_subparsers(), lambda commit: "c")
        call = ["coverage", "run", "--policies", policy, "--reference", policy, "--realities", "dev-00,default"]
        call += ["--repetitions", "2", "--lines", str(tmp_path / "lines.jsonl"), "--dry-run"]
        given = parser.parse_args([*call, *only])
        assert given.do(given) == 0
        listed[only[-1] if only else "both"] = capsys.readouterr().out.splitlines()
    assert len(listed["truths"]) == 2 and len(listed["evaluations"]) == 4
    assert listed["truths"] + listed["evaluations"] == listed["both"]


def test_one_policy_in_two_files_is_one(policies):
    assert {work.name for work in works(policies, ("again", "first"))} == {"again"}


def test_every_line_is_made_once_and_a_failure_is_tried_again(policies, tmp_path, monkeypatch):
    path, said, fail = tmp_path / "lines.jsonl", [], tmp_path / "fail"
    monkeypatch.setenv("FAIL", str(fail))
    fail.touch()
    given = works(policies, repetitions=1)
    assert run_coverage(given, path, 1, say=said.append, make=pretend) == 1
    assert sum("it broke" in text for text in said) == 1
    assert len(read_coverage([path])) == 3  # two truths, one evaluation
    path.write_text(path.read_text()[:-20])  # killed in the midst of the last
    fail.unlink()
    assert run_coverage(given, path, 1, say=said.append, make=pretend) == 0
    assert "4 lines: 2 are there, 2 to make, 1 at once" in said
    assert {line.key for line in read_coverage([path])} == {work.key for work in given}


def test_when_the_time_is_up_nothing_more_is_begun(policies, tmp_path):
    status = run_coverage(works(policies), tmp_path / "l.jsonl", 1, stop_after=-1, say=str, make=pretend)
    assert status == STOPPED and not (tmp_path / "l.jsonl").exists()
