"""Several batches on one machine: the file, who gets which cores and GPUs, and where lines go."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
import realities as command
from batch.lines import read_lines
from batch.methods import METHODS, Job, jobs_of
from batch.places import Machine, Need, Slot
from batch.queue import Target, run_batch
from batch.several import planned, read_several

from hts.errors import ConfigError

FAKE = (sys.executable, str(Path(__file__).parent / "fake_hts.py"))


def made(seeds=(0,), methods=("ours",)) -> list[Job]:
    given = {"objectives": ["power"], "robot": "go1", "preset": "smoke", "commit": "c"}
    return jobs_of({name: METHODS[name] for name in methods}, ["default"], seeds, **given)


def written(folder, text):
    path = folder / "several.yaml"
    path.write_text(text)
    return path


def test_a_file_says_what_run_would_be_told(tmp_path):
    path = written(
        tmp_path,
        "long:\n- {methods: ours, realities: default, seeds: 1, preset: smoke, cores: 2, gpu: true}\n"
        "- {methods: 'ours,baseline', realities: default, seeds: 0-1, preset: smoke, set: [finetune.steps=48]}\n"
        "short:\n- {methods: oracle, realities: default, preset: smoke, cores: 1, commit: d}\n",
    )

    def jobs(entry):
        return command.jobs_of(entry.model_copy(update={"commit": entry.commit or "c"}))

    found = planned(path, jobs, 4, ["0"])
    assert [(one.batch, one.job.method, one.job.seed, one.need) for one in found] == [
        ("long", "ours", 1, Need(2, True)),
        ("long", "ours", 0, Need(2)),
        ("long", "baseline", 0, Need(2)),
        ("long", "ours", 1, Need(2)),
        ("long", "baseline", 1, Need(2)),
        ("short", "oracle", 0, Need(1)),
    ]
    assert "finetune.steps=48" in found[1].job.arguments and "finetune.steps=48" not in found[0].job.arguments
    assert [one.job.commit for one in found] == ["c"] * 5 + ["d"]


GOOD = "a:\n- {methods: ours, realities: default, preset: smoke, cores: 2}\n"


def but(old: str, new: str) -> str:
    assert old in GOOD
    return GOOD.replace(old, new)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", r"several.yaml: asks for no batch. Expected the name of one"),
        ("- {methods: ours}\n", r"several.yaml: expected keys and values"),
        (but("a:", "a/b:"), r"several.yaml: 'a/b' is no name of a batch.*use letters"),
        (but("a:", "'..':"), r"several.yaml: '..' is no name of a batch"),
        ("a: 3\n", r"several.yaml: a: expected a list of entries \(- methods: …\), found 3"),
        ("a: []\n", r"several.yaml: a: expected a list of entries .*, found \[\]"),
        ("a: [ours]\n", r"several.yaml: a.0: expected keys and values .*, found 'ours'"),
        ("a:\n- {methods: ours}\n", r"several.yaml: a.0.realities"),
        (but("cores", "core"), r"several.yaml: a.0.*'core'.*Did you mean.*cores"),
        (but("cores: 2", "cores: 0"), r"a.0.cores.*more than 0"),
        (but("cores: 2", "cores: true"), r"a.0.cores.*expected a whole number"),
        (but("cores: 2", "gpu: 0"), r"a.0.gpu.*expected true or false"),
        (but("methods: ours", "methods: ','"), r"several.yaml: a.0 asks for no run: methods is ','. Name one"),
        (but("methods: ours", "methods: odds"), "several.yaml: a.0: No method named 'odds'"),
        (but("realities: default", "realities: dev-99"), "several.yaml: a.0: No reality named 'dev-99'"),
        (but("cores: 2", "engine: wrap"), "several.yaml: a.0: Method 'ours': No engine named 'wrap'"),
        (but("cores: 2", "robot: go2"), "several.yaml: a.0: Method 'ours': No robot named 'go2'"),
        (but("cores: 2", "objective: [powr]"), "several.yaml: a.0: Method 'ours': No objective named 'powr'"),
        (but("cores: 2", "cores: 5"), r"a.0 asks for 5 cores a run; this machine has 4. Lower `cores`"),
        (but("cores: 2", "gpu: true"), r"a.0 asks for a GPU, and --gpus gives none. Name some"),
        (GOOD + but("a:", "b:"), "ours on default, seed 0, is asked for twice, by a.0 and by b.0. Leave one out"),
    ],
)
def test_a_mistake_is_one_line_before_anything_is_spent(tmp_path, text, said):
    path = written(tmp_path, text)
    with pytest.raises(ConfigError, match=said) as wrong:
        planned(path, lambda entry: command.jobs_of(entry.model_copy(update={"commit": "c"})), 4, [])
    assert "\n" not in str(wrong.value)


@pytest.mark.parametrize("option", ["--lines", "--out"])
def test_a_file_where_a_folder_is_meant_is_refused_before_a_run(tmp_path, option, capsys):
    path, file = written(tmp_path, GOOD.replace("cores: 2", "cores: 1")), tmp_path / "file"
    file.touch()
    given = {"--out": str(tmp_path / "runs"), "--lines": str(tmp_path / "lines"), option: str(file)}
    assert (
        command.main(["several", str(path), "--commit", "c", *(text for pair in given.items() for text in pair)]) == 2
    )
    said = capsys.readouterr().err
    assert said.startswith(f"{option} {file}: is a file") and said.count("\n") == 1


@pytest.mark.parametrize(("option", "value"), [("--cores", "0"), ("--cores", "-3"), ("--jobs", "-1"), ("--jobs", "x")])
def test_fewer_than_one_is_refused(tmp_path, option, value, capsys):
    asked = ["run", "--methods", "ours", "--realities", "default", "--out", str(tmp_path), option, value, "--dry-run"]
    with pytest.raises(SystemExit) as left:
        command.main(asked)
    assert left.value.code == 2
    assert f"{option}: expected a whole number of at least 1, found '{value}'" in capsys.readouterr().err


def test_cores_have_one_run_each_and_gpus_go_round():
    large, other, small, hidden = made(seeds=(0, 1, 2, 3))
    needs = {large.key: Need(2, True), other.key: Need(2, True), small.key: Need(1, True), hidden.key: Need(1)}
    machine = Machine(range(6), ["0", "1"], needs)
    assert str(machine) == "on 6 cores and 2 GPUs"
    assert [machine.take(job) for job in (large, small, hidden, other)] == [
        Slot((0, 1), "0"),
        Slot((2,), "1"),
        Slot((3,), ""),
        Slot((4, 5), "1"),  # where one core's run is, not where two cores' are
    ]
    assert machine.take(small) is None
    machine.give(Slot((4, 5), "1"))
    machine.give(Slot((0, 1), "0"))
    assert machine.take(large) == Slot((0, 1), "0")
    assert machine.take(other) == Slot((4, 5), "1")


def test_runs_begin_in_the_files_order_and_nobody_overtakes(tmp_path, monkeypatch):
    """The second wants the whole machine, so it waits for the first, and the third for it."""
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) < 2:
        pytest.skip("needs two cores")
    monkeypatch.setenv("FAKE_HTS", str(tmp_path))
    monkeypatch.setenv("FAKE_SECONDS", "0.2")
    jobs = made(seeds=(0, 1, 2))
    needs = dict(zip([job.key for job in jobs], (Need(1), Need(2), Need(1)), strict=True))
    targets = {job.key: Target(tmp_path / f"{job.seed % 2}.jsonl", f"b{job.seed % 2}") for job in jobs}
    known = [tmp_path / "0.jsonl", tmp_path / "1.jsonl"]
    status = run_batch(
        jobs,
        Machine(cores[:2], [], needs),
        folders=tmp_path / "runs",
        target=lambda job: targets[job.key],
        known=known,
        say=lambda text: None,
        program=FAKE,
    )
    assert status == 0
    typed = [row.split()[-3:] for row in (tmp_path / "typed.txt").read_text().splitlines()]
    assert [row[0] for row in typed] == ["0", "1", "2"]  # --seed N --out FOLDER
    found = {row.seed: (row.batch, row.hardware["cores_used"]) for row in read_lines(known)}
    assert found == {0: ("b0", 1), 1: ("b1", 2), 2: ("b0", 1)}
    assert {row.seed for row in read_lines([tmp_path / "1.jsonl"])} == {1}


def test_the_command_puts_each_batch_into_its_own_file(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("FAKE_HTS", str(tmp_path))
    monkeypatch.setattr(command, "HTS", FAKE)
    small = but("cores: 2", "cores: 1, seeds: 0")
    path = written(tmp_path, small + small.replace("a:", "b:").replace("seeds: 0", "seeds: 1"))
    asked = ["several", str(path), "--out", str(tmp_path / "runs"), "--lines", str(tmp_path / "lines"), "--commit", "c"]
    assert command.main([*asked, "--dry-run"]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert [row.split(maxsplit=1)[1].split(" hts ")[0] for row in shown] == [
        "a.0 (1 cores, to do)",
        "b.0 (1 cores, to do)",
    ]
    assert command.main(asked) == 0
    for name, seed in (("a", 0), ("b", 1)):
        (row,) = read_lines([tmp_path / "lines" / f"{name}.jsonl"])
        assert (row.batch, row.seed, row.status) == (name, seed, "done")
    assert command.main(asked) == 0
    assert "2 have a line already, 0 to do" in capsys.readouterr().err
    (of_b,) = read_lines([tmp_path / "lines/b.jsonl"])
    failed = of_b.model_copy(update={"status": "failed", "error": "boom", "result": None})
    (tmp_path / "lines/b.jsonl").write_text(failed.model_dump_json() + "\n")
    for more, states in (([], ["has a line", "has a line, failed"]), (["--retry-failed"], ["has a line", "to do"])):
        assert command.main([*asked, "--dry-run", *more]) == 0
        shown = [row.split(" (1 cores, ")[1].split(") hts ")[0] for row in capsys.readouterr().out.splitlines()]
        assert shown == states


def test_the_committed_files_can_be_read():
    folder = Path(__file__).parents[2] / "docs" / "results" / "several"
    files = sorted(folder.glob("*.yaml"))
    entries = [entry for path in files for rows in read_several(path).values() for entry in rows]
    assert entries and all(len(entry.commit or "") == 40 for entry in entries)  # what was registered has one
