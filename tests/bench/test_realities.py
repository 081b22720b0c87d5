"""Batches of runs: each gets one line, whatever happens, and the command that makes them."""

from __future__ import annotations

import functools
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest
from batch import predictions, queue, tables
from batch.groups import groups_of
from batch.lines import read_lines
from batch.methods import METHODS, Method, jobs_of, read_methods, realities_of, seeds_of
from batch.places import Slot, Slots, slots_of
from batch.queue import STOPPED, Target, run_batch
from fake_lines import line

from hts.config_loading import load_config
from hts.errors import ConfigError

FAKE = (sys.executable, str(Path(__file__).parent / "fake_hts.py"))
BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def reality(tmp_path):
    """The file of one."""
    path = tmp_path / "there.json"
    path.write_text("{}")
    return str(path)


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_HTS", str(tmp_path))
    return tmp_path


def jobs(methods=("ours",), realities=("default",), seeds=(0,), **changes):
    given = {"objectives": ["power"], "robot": "go1", "preset": "smoke", "commit": "c", **changes}
    return jobs_of({name: METHODS[name] for name in methods}, realities, seeds, **given)


def batch(place, made, **changes):
    """Run with the stand-in; what it said."""
    said = []
    options = {"folders": place / "runs", "known": [place / "lines.jsonl"], **changes}
    target = Target(options.pop("lines", place / "lines.jsonl"), "b")
    slots = Slots([Slot((core,), "") for core in sorted(os.sched_getaffinity(0))[:1]] * 2)
    return run_batch(made, slots, target=lambda _: target, say=said.append, program=FAKE, **options), said


# --------------------------------------------------------------------------------------------- what is to be run


def test_seeds_and_realities_are_written_short():
    assert seeds_of("0-2,7") == [0, 1, 2, 7]
    assert realities_of("default,dev-03") == ["default", "dev-03"]
    assert realities_of("dev")[-1] == "dev-15" and len(realities_of("dev")) == 16


def test_a_folder_of_realities_is_its_files(tmp_path):
    for name in ("b.json", "a.json"):
        (tmp_path / name).write_text("{}")
    assert realities_of(str(tmp_path)) == [str(tmp_path / "a.json"), str(tmp_path / "b.json")]


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: seeds_of("3-1"), "'3-1' is no seed"),
        (lambda: seeds_of("a"), "'a' is no seed"),
        (lambda: realities_of("gone.json"), "gone.json: there is no such file"),
        (lambda: realities_of(","), "names none"),
        (lambda: jobs(settings=["nonsense.key=1"]), "Method 'ours': .*nonsense"),
        (lambda: jobs_of({"x": Method("dance")}, ["default"], [0], objectives=["power"], robot="go1", preset="smoke",
                         commit="c"), "No command of runs named 'dance'"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_line_before_anything_is_spent(call, said):
    with pytest.raises(ConfigError, match=said):
        call()


def test_methods_come_from_a_file_too(tmp_path):
    path = tmp_path / "methods.yaml"
    path.write_text("mine: {command: baseline, preset: smoke, set: [finetune.steps=10]}\n")
    assert read_methods(path)["mine"] == Method("baseline", ("finetune.steps=10",), {"": "smoke"})
    path.write_text("mine: {sets: [a=1]}\n")
    with pytest.raises(ConfigError, match=r"methods.yaml: method 'mine' .* Expected a mapping"):
        read_methods(path)


def test_the_key_tells_runs_apart_and_nothing_else(tmp_path, reality):
    (one,) = jobs()
    others = [
        *jobs(methods=["baseline"]),
        *jobs(seeds=[1]),
        *jobs(realities=[reality]),
        *jobs(commit="d"),
        *jobs(settings=["finetune.steps=10"]),
    ]
    assert len({one.key, *(other.key for other in others)}) == 6
    path = tmp_path / "r.json"
    path.write_text("{}")
    (first,) = jobs(realities=[str(path)])
    assert first.reality == "r" and f"world.reality={path}" in first.arguments
    path.write_text("[]")
    assert jobs(realities=[str(path)])[0].key != first.key
    assert jobs()[0].key == one.key
    assert not any("world.reality" in text for text in one.arguments)  # the default twin needs no name


def test_an_oracle_is_made_like_a_method_and_is_nobodys_rival():
    (made,) = jobs(methods=["oracle"], settings=["finetune.steps=10"], engine="warp")
    assert made.arguments[0] == "oracle" and "--engine" not in made.arguments  # its physics is the twin's
    assert made.key != jobs(methods=["oracle"], engine="warp")[0].key
    seen = {"arguments": ["oracle", "--objective", "power"]}
    lines = [line("ours"), line("baseline", saved=(0.1, 0.1, 0.1)), line("oracle", saved=(0.5, 0.5, 0.5), **seen)]
    groups = groups_of(lines)
    for text in (tables.methods(groups), tables.best_other(groups)):
        rows = {row.split("|")[1].strip(): row for row in text.splitlines() if row.startswith("| ")}
        assert "1 of 1" in rows["ours"] and "0 of 1" in rows["baseline"]
        assert text.endswith("`oracle`: saw inside the reality; no method, and no rival here.")
    assert tables.methods(groups[:2]).endswith("|")


def test_an_oracle_of_the_reward_is_ours_but_for_what_pays():
    def settings(name: str, **kind: bool) -> dict[str, object]:
        given = {"preset": "quick", "objectives": ["power"], "robot": "go1", "world": "twin", "engine": "mujoco"}
        return load_config(**given, overrides=METHODS[name].settings, **kind).model_dump()

    ours, seeing = settings("ours"), settings("oracle-reward", oracle=True)
    assert {key for key in ours if ours[key] != seeing[key]} == {"reward_source", "oracle_trains_in"}


def test_the_papers_recipe_is_never_ours_by_another_name():
    ours, exact = jobs(methods=["ours", "paper-exact"], preset="quick")
    assert ours.method_hash != exact.method_hash
    assert "objectives.power.model={name: battery_current, products: false}" in exact.arguments
    assert (
        "objectives.power.criterion=net" in exact.arguments and "sweep.weights.power=[0.5, 1.0, 5.0]" in exact.arguments
    )
    assert "sweep.kl_bounds=[0.2, 0.5, 1.0]" in exact.arguments and "finetune.hold=false" in exact.arguments
    assert exact.arguments[exact.arguments.index("--preset") + 1] == "quick"


def test_what_is_compared_is_made_together(reality):
    made = jobs(methods=["ours", "baseline"], realities=["default", reality], seeds=[0, 1])
    assert [(job.reality, job.seed, job.method) for job in made[:3]] == [
        ("default", 0, "ours"),
        ("default", 0, "baseline"),
        ("default", 1, "ours"),
    ]


def test_slots_share_cores_and_gpus():
    (job,) = jobs()
    taken = functools.partial(map, lambda places: places.take(job))
    found = slots_of(2, ["0", "1"], None, range(7))
    assert list(taken([found] * 4)) == [Slot((0, 1), "0"), Slot((2, 3), "1"), Slot((4, 5), "0"), None]
    found.give(Slot((2, 3), "1"))
    assert found.take(job) == Slot((2, 3), "1")
    assert list(taken([slots_of(2, [], 1, range(7))] * 2)) == [Slot((0, 1), ""), None]
    assert list(taken([slots_of(4, None, None, [0, 1])] * 2)) == [Slot((0, 1), None), None]


# ------------------------------------------------------------------------------------------------------- the queue


def test_each_run_gets_one_line_and_is_not_made_again(place):
    made = jobs(methods=["ours", "baseline"], seeds=[0, 1])
    status, _ = batch(place, made)
    lines = read_lines([place / "lines.jsonl"])
    assert status == 0
    assert {(row.method, row.seed, row.status) for row in lines} == {
        (method, seed, "done") for method in ("ours", "baseline") for seed in (0, 1)
    }
    assert list((place / "runs").iterdir()) == []  # folders are deleted
    typed = (place / "typed.txt").read_text().splitlines()
    assert len(typed) == 4 and all(row.startswith("1  ") for row in typed)  # one core, GPUs hidden
    status, said = batch(place, made)
    assert status == 0 and "4 have a line already, 0 to do" in said[0]
    assert len((place / "typed.txt").read_text().splitlines()) == 4


def test_a_run_that_fails_is_a_line_and_is_tried_again_only_when_asked(place):
    made = jobs(seeds=[13, 1])
    assert batch(place, made)[0] == 1
    found = {row.seed: row for row in read_lines([place / "lines.jsonl"])}
    assert (found[13].status, found[13].error) == ("failed", "exit status 2: error: thirteen")
    assert found[13].result is None and found[1].status == "done"
    assert batch(place, made)[0] == 1
    assert len((place / "typed.txt").read_text().splitlines()) == 2
    batch(place, made, retry_failed=True)
    assert (place / "typed.txt").read_text().splitlines()[-1].split()[-2] == "resume"


TRACEBACK = "Traceback (most recent call last):\n  File x\n"


@pytest.mark.parametrize(
    ("log", "said"),
    [
        ("[1/10] begins\nerror: no such robot\n", "error: no such robot"),
        (f"{TRACEBACK}ValueError: it broke\n\nSet THIS=1 for more\n", "ValueError: it broke"),
        (f"{TRACEBACK}a.b.SomeError: one\n  ValueErrors are listed\n", "a.b.SomeError: one"),
        (f"Error: of before\n{TRACEBACK}stopped\n", "stopped"),
        ("\n", "it said nothing"),
    ],
)
def test_a_line_names_the_exception_and_not_the_advice_below_it(log, said, tmp_path):
    path = tmp_path / "run.log"
    path.write_text(log)
    assert queue._last_line(path) == said


def test_the_line_holds_what_tables_need(place):
    batch(place, jobs(), keep=True)
    (row,) = read_lines([place / "lines.jsonl"])
    outcome = row.result.objectives["power"]
    assert (outcome.held["0.8"].falls, outcome.open_loop["0.8"].falls) == (0, 2)
    assert (outcome.held["0.8"].reference_falls, outcome.held["0.8"].reference_speed) == (1, 0.8)
    assert row.result.real_samples == {
        "collect": 100,
        "iterations/00/test": 200,
        "iterations/00/test:trim": 50,
        "final": 300,
        "total": 600,
    }
    (tried,) = row.result.tried
    assert (tried.kl, tried.kl_bound, tried.std_ratio) == (3.0, None, 0.5)
    assert predictions.predicted(tried, "power") == [(0.25, 0.2)]
    assert tried.predicted_sd == {"power": {"0.8": 0.02}}
    assert row.result.curve[0].samples == 300
    assert row.result.curve[0].final == {"power": {"0.8": 0.2, "1.1": 0.0}}  # what was refused saves nothing
    assert row.result.max_real_samples == 900
    assert row.result.models[0].pairs[0].predicted == 5.1
    assert (row.result.models[0].doubts[0].error, row.result.models[0].doubts[0].spread) == (0.1, 0.2)
    assert row.commit == "c" and row.hardware["cores_used"] == 1


@pytest.mark.slow
def test_when_the_time_is_up_it_says_so_and_goes_on_when_called_again(place, monkeypatch):
    monkeypatch.setenv("FAKE_SECONDS", "0.5")
    made = jobs(seeds=[0, 1, 2])
    assert batch(place, made, stop_after=1.2)[0] == STOPPED
    monkeypatch.setenv("FAKE_SECONDS", "0")
    assert batch(place, made)[0] == 0
    assert Counter(row.seed for row in read_lines([place / "lines.jsonl"])) == {0: 1, 1: 1, 2: 1}


def done(place):
    """Lines so far."""
    path = place / "lines.jsonl"
    return path.read_bytes().count(b"\n") if path.exists() else 0


def command_lines():
    """Of all processes that have one; a zombie has none."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            yield path.read_text().replace("\0", " ")
        except OSError:
            continue


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="runs die with their batch on Linux only")
def test_killed_at_any_moment_nothing_is_lost_and_nothing_runs_on(place, monkeypatch):
    """SIGKILL of the whole batch, again and again; in the end every run has one line, made of resumed folders."""
    monkeypatch.setenv("FAKE_SECONDS", "0.15")
    program = (
        "import sys; sys.path[:0] = [sys.argv[1], sys.argv[2]]\n"
        "import test_realities as t; from pathlib import Path\n"
        "sys.exit(t.batch(Path(sys.argv[3]), t.jobs(seeds=[0, 1, 2, 3]))[0])"
    )
    command = [sys.executable, "-c", program, str(BENCHMARKS), str(Path(__file__).parent), str(place)]
    held = [place / f"hold-{seed}" for seed in range(4)]
    for path in held:
        path.touch()

    def wait(look) -> None:
        until = time.monotonic() + 200
        while not look():
            assert time.monotonic() < until
            time.sleep(0.02)

    for begun, free in ((1, 0), (3, 2)):  # as soon as so many runs are in their midst or done, of which some may end
        for path in held[:free]:
            path.unlink()
        process = subprocess.Popen(command)
        wait(lambda begun=begun: len(list((place / "runs").glob("*/collect.json"))) + done(place) >= begun)
        assert process.poll() is None, "it ended by itself, or never came so far"
        process.send_signal(signal.SIGKILL)
        process.wait()
        wait(lambda: not any(str(place) in text for text in command_lines()))
    for path in held[2:]:
        path.unlink()
    assert subprocess.run(command, check=False, timeout=500).returncode == 0
    assert " resume " in (place / "typed.txt").read_text()
    lines = (place / "lines.jsonl").read_text().splitlines()
    assert sorted(json.loads(text)["seed"] for text in lines) == [0, 1, 2, 3]
    assert list((place / "runs").iterdir()) == []


# ------------------------------------------------------------------------------------------------- the command line


@pytest.fixture
def command():
    """`main` of the script."""
    import importlib.util

    spec = importlib.util.spec_from_file_location("realities", BENCHMARKS / "realities.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_batch_can_be_looked_at_before_it_is_made(command, capsys, tmp_path, reality):
    options = ["run", "--methods", "ours,baseline", "--realities", f"default,{reality}", "--preset", "smoke"]
    assert command.main([*options, "--out", str(tmp_path / "out"), "--commit", "c", "--dry-run"]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert len(rows) == 4 and "(to do) hts baseline" in rows[1] and f"world.reality={reality}" in rows[2]
    assert not (tmp_path / "out").exists()
    (tmp_path / "lines.jsonl").write_text(line(key=rows[1].split()[0]).model_dump_json() + "\n")
    more = ["--lines", str(tmp_path / "lines.jsonl"), "--dry-run"]
    assert command.main([*options, "--out", str(tmp_path / "out"), "--commit", "c", *more]) == 0
    made = [row.split("(")[1].split(")")[0] for row in capsys.readouterr().out.splitlines()]
    assert made == ["to do", "has a line", "to do", "to do"]


def test_a_wrong_name_is_one_line(command, capsys, tmp_path):
    options = ["run", "--realities", "default", "--out", str(tmp_path), "--commit", "c"]
    assert command.main([*options, "--methods", "our"]) == 2
    assert "No method named 'our'. Did you mean 'ours'?" in capsys.readouterr().err


def test_tables_and_figures_are_one_command_each(command, capsys, lines):
    assert command.main(["table", "--lines", str(lines), "--against", "ours"]) == 0
    text = capsys.readouterr().out
    assert all(f"### {name}" in text for name in tables.TABLES) and "| ours | 3 × 1 |" in text
    assert command.main(["figures", "--lines", str(lines / "a.jsonl"), "--out", str(lines / "figures")]) == 0
    assert (lines / "figures/quick-savings.svg").stat().st_size > 1000


def test_the_commit_is_what_is_said_else_what_git_says(command, monkeypatch, tmp_path):
    monkeypatch.setenv("HTS_COMMIT", "abc")
    assert (command.commit_of("def"), command.commit_of(None)) == ("def", "abc")
    monkeypatch.delenv("HTS_COMMIT")
    monkeypatch.setattr(command, "REPOSITORY", tmp_path)  # no git there
    with pytest.raises(ConfigError, match="Say it: --commit"):
        command.commit_of(None)


def test_hts_takes_what_a_batch_types_for_an_oracle(tmp_path, hts_here):
    (made,) = jobs(methods=["oracle"], realities=["dev-03"])
    done = hts_here(*made.arguments, "--out", tmp_path / "run", "--dry-run")
    assert done.returncode == 0 and "oracle: saw inside the reality" in done.stdout, done.stderr + done.stdout


@pytest.mark.slow
def test_an_oracle_gets_a_line_that_says_what_it_is(tmp_path, oracle_run):
    copies = "import shutil, sys; shutil.copytree(sys.argv[1], sys.argv[-1])"
    made, lines = jobs(methods=["oracle"], realities=["dev-03"]), tmp_path / "lines.jsonl"
    to, program = Target(lines, "b"), (sys.executable, "-c", copies, str(oracle_run.folder))
    slots = Slots([Slot(tuple(sorted(os.sched_getaffinity(0))), "")])
    assert run_batch(made, slots, folders=tmp_path / "runs", target=lambda _: to, known=[], program=program) == 0
    (found,) = read_lines([lines])
    assert found.result.note == "oracle: saw inside the reality; no method"
    assert found.result.tried[0].kl_bound is None and found.result.candidates == 1
    assert groups_of([found])[0].saw_inside


def test_a_reader_that_has_gone_is_no_traceback(tmp_path):
    (tmp_path / "lines.jsonl").write_text(line().model_dump_json() + "\n")
    command = [sys.executable, str(BENCHMARKS / "realities.py"), "table", "--lines", str(tmp_path / "lines.jsonl")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert (process.stderr.read(), process.wait()) == (b"", 1)
