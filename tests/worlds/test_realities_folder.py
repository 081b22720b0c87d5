"""A folder of draws: one command at a time adds to it, and a damaged one is one line, whoever reads it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from hts.cli.main import main
from hts.errors import ConfigError, RunError
from hts.policies.export import to_onnx
from hts.policies.files import load_policy
from hts.worlds.realities import batch, population
from hts.worlds.realities.folder import begun, draws_of, only_one
from hts.worlds.realities.like import Likeness
from hts.worlds.twin.reality import Reality

pytest.importorskip("hts_go1", reason="the draws of this test are of it")
DRAWS = Path(__file__).parents[2] / "docs" / "results" / "realities" / "draws.jsonl"
HEADING = {"format": 1, "seed": "s"}
LIKE = {"format": 2, "seed": "s", "size": 2, "like": {"figures": [], "schedule": None}}
PARTICLE = {"bound": None, "step": 0.5, "distance": 0.5, "shown": {}, "simulated": 1, "accepted": 0, "point": [0.5]}


def draws(*lines: object, heading: dict = HEADING) -> str:
    return "".join(json.dumps(line) + "\n" for line in (heading, *lines))


def dropped(index: int) -> dict[str, object]:
    return {"index": index, "kept": False, "why": "standing 79 W", "switches": [], "measured": {}}


def particle(generation: int, place: int) -> dict[str, object]:
    return {"generation": generation, "place": place, **PARTICLE}


def draw_public(folder: Path) -> None:
    batch.draw_many(batch.Asked(1, "s", "go1", "some", "p.onnx"), folder)


def draw_like(folder: Path) -> None:
    like = Likeness(figures=(), schedule=None)
    population.draw_like(population.Asked(1, "s", "go1", "some", "p.onnx", like, size=4), folder)


@pytest.mark.parametrize("draw", [draw_public, draw_like])
def test_a_second_command_does_not_draw_into_the_same_folder(tmp_path, draw):
    hold = (
        "import sys, pathlib; from hts.worlds.realities.folder import only_one\n"
        "with only_one(pathlib.Path(sys.argv[1])): print('held', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", hold, str(tmp_path / "out")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "held\n"
        with pytest.raises(RunError, match="another process draws into it. Wait for it, or choose") as caught:
            draw(tmp_path / "out")
        other.stdin.close()
    assert "\n" not in str(caught.value)
    assert [path.name for path in (tmp_path / "out").iterdir()] == [".lock"]
    with only_one(tmp_path / "out"):  # what a killed command left is in nobody's way
        assert begun(tmp_path / "out", HEADING) == []


def test_a_worker_without_a_display_says_nothing_about_it():
    """dm_control looks for one when it is imported, and warns."""
    code = (
        "from hts.worlds.realities.workers import worker_processes\n"
        "with worker_processes(1) as pool: pool.submit(exec, 'import dm_control.mjcf').result()"
    )
    without = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "MUJOCO_GL")}
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=without, check=False)
    assert (ended.returncode, ended.stderr) == (0, "")


DAMAGED = {
    "empty": (b"", "line 1 is damaged (expected what was asked for, found nothing)"),
    "cut off in its first line": (b'{"format": 1, "se', "line 1 is damaged (expected what was asked for"),
    "latin-1": (draws().encode() + b'{"index": 0, "why": "\xe9"}\n', "line 2 is damaged (no JSON: 'utf-8'"),
    "cut off in the middle": (draws(dropped(0)).encode()[:-9] + b"\n", "line 2 is damaged (no JSON: "),
    "no object": (draws([0]).encode(), "line 2 is damaged (expected keys and values, found list)"),
    "no index": (draws(dropped(0), {"kept": False, "why": "no"}).encode(), "line 3 is damaged (without 'index')"),
    "no values": (draws({**dropped(0), "kept": True}).encode(), "line 2 is damaged (without 'values')"),
    "twice": (draws(dropped(0), dropped(1), dropped(1)).encode(), "line 4 is damaged (expected draw 2, found draw 1)"),
    "no place": (draws({"generation": 0, **PARTICLE}, heading=LIKE).encode(), "line 2 is damaged (without 'place')"),
    "no point": (
        draws({**particle(0, 0), "point": ["a", [1]]}, heading=LIKE).encode(),
        "line 2 is damaged (setting an array element",
    ),
    "a place twice": (
        draws(particle(0, 0), particle(0, 0), heading=LIKE).encode(),
        "line 3 is damaged (expected place 1 of generation 0, found place 0 of generation 0)",
    ),
    "no size": (draws(heading={**LIKE, "size": None}).encode(), "line 1 is damaged (size: expected a whole number"),
}


@pytest.mark.parametrize(("content", "said"), DAMAGED.values(), ids=list(DAMAGED))
def test_damaged_draws_are_one_line_that_names_the_line(tmp_path, capsys, content, said):
    (tmp_path / "draws.jsonl").write_bytes(content)
    heading = json.loads(content.splitlines()[0]) if b"}" in content else HEADING
    with pytest.raises(RunError) as caught:
        begun(tmp_path, heading)
    assert main(["realities", "posterior", str(tmp_path)]) == 2
    line = capsys.readouterr().err
    assert line == f"error: {caught.value}\n" and line.startswith(f"error: {tmp_path}/draws.jsonl: {said}"), line
    assert "`hts realities draw` with another --out" in line
    assert (tmp_path / "draws.jsonl").read_bytes() == content


def test_a_last_line_that_is_not_there_yet_is_not_counted(tmp_path, capsys):
    shutil.copy(DRAWS, tmp_path / "draws.jsonl")
    with (tmp_path / "draws.jsonl").open("a") as file:
        file.write('{"index": 423, "ke')
    assert main(["realities", "posterior", str(tmp_path)]) == 0
    assert "16 of 423 draws kept" in capsys.readouterr().out
    assert len(draws_of(tmp_path).lines) == 423


@pytest.mark.parametrize("content", [b"\xff\n", b"{\n", b'{"reality": "a"}\n', b'{"reality": "a", "weight": "x"}\n'])
def test_damaged_weights_are_one_line(tmp_path, content):
    (tmp_path / "kept.jsonl").write_bytes(content)
    with pytest.raises(RunError, match=r"kept\.jsonl: line 1 is damaged") as caught:
        population.weights_of(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["../esc", "a/b", "", ".hidden", "a\\b", "a\nb", "x" * 300])
def test_a_name_that_is_no_part_of_a_files_name_is_refused_before_anything_is_drawn(tmp_path, capsys, name):
    words = ["realities", "draw", "--count", "1", "--seed", "s", "--robot", "go1", "--out", str(tmp_path / "out")]
    assert main([*words, "--name", name]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and "--name" in line, line
    assert not list(tmp_path.iterdir())


def test_a_policy_that_falls_on_the_default_twin_is_told_before_anything_is_drawn(robot, tmp_path):
    """Every draw would be dropped, without end: of a slower robot at the speeds that others are held to."""
    walks = load_policy(robot.pretrained_policy())
    odd = {name: -3.0 * value if name.endswith("bias") else value for name, value in walks.tensors.items()}
    with pytest.raises(ConfigError, match=r"'go1': its policy fell at 0\.5, 0\.8, 1\.1 m/s on the default twin"):
        batch.check_walks("go1", to_onnx(replace(walks, tensors=odd), tmp_path / "falls.onnx"))
    batch.check_walks("go1", to_onnx(walks, tmp_path / "walks.onnx"))


def test_draws_of_a_robot_that_falls_are_not_begun(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(batch, "fallen_at", lambda *given: ([0.5, 0.8], "fell at 0.8 m/s"))
    out = tmp_path / "out"
    assert main(["realities", "draw", "--count", "1", "--seed", "s", "--robot", "go1", "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert "fell at 0.8 m/s on the default twin" in said and "--like STORE" in said and said.count("\n") == 1
    assert len((out / "draws.jsonl").read_text().splitlines()) == 1  # the heading


def test_a_draw_ends_with_the_instruments_that_took_part_and_their_packages(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(batch, "check_walks", lambda *given: None)
    reality = Reality(name="", robot="go1", seed="s", index=0, switches=(), parameters={}).model_dump_json()
    kept = {"index": 0, "kept": True, "why": "", "values": {}}
    monkeypatch.setattr(batch, "_in_order", lambda *given: iter([(kept, reality)]))
    words = ["--count", "1", "--seed", "s", "--robot", "go1", "--out", str(tmp_path / "out")]
    assert main(["realities", "draw", *words]) == 0
    said = capsys.readouterr().err.splitlines()[-1]
    assert said == "Drawn with battery_gauge (from hard-to-sim-power), microphone (from hard-to-sim-noise)."


def test_a_folder_that_other_instruments_had_a_part_in_is_not_gone_on_with(tmp_path):
    assert begun(tmp_path, {**HEADING, "ranges_sha256": "aa"}, ["meter"]) == []
    assert begun(tmp_path, {**HEADING, "ranges_sha256": "aa"}, ["meter"]) == []
    with pytest.raises(RunError) as caught:
        begun(tmp_path, {**HEADING, "ranges_sha256": "bb"}, ["meter", "thermometer"])
    assert str(caught.value) == (
        f"{tmp_path}/draws.jsonl: was begun with other ranges (ranges_sha256 aa, now bb): of another version, or with "
        "other instruments than are installed here, meter, thermometer. Go on where it was begun, or choose another "
        "folder with --out."
    )
