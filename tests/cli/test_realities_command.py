"""`hts realities`: what it prints, and how mistakes end."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from hts.cli.main import main
from hts.worlds.realities import batch
from hts.worlds.realities.check import Verdict
from hts.worlds.twin.reality import Measured, locate, sha256

pytest.importorskip("hts_go1", reason="the realities of this test come with it")
DRAWS = Path(__file__).parents[2] / "docs" / "results" / "realities"


def test_the_realities_of_installed_robots_are_listed_with_their_hashes(capsys):
    assert main(["realities", "list"]) == 0
    listed = dict(line.split() for line in capsys.readouterr().out.splitlines())
    assert listed["dev-00"] == sha256(locate("dev-00"))


def test_a_reality_is_shown_with_what_makes_it_another_machine(capsys):
    assert main(["realities", "show", "dev-00", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert (content["robot"], content["sha256"]) == ("go1", sha256(locate("dev-00")))
    assert main(["realities", "show", "dev-00"]) == 0
    shown = capsys.readouterr().out
    scale = content["parameters"]["dynamics"]["trunk_mass_scale"]
    assert f"dynamics.trunk_mass_scale: {scale} (default twin: 1.04)" in shown
    assert "physics_dt" not in shown  # as in the default twin
    assert f"structures: {', '.join(content['switches'])}" in shown
    assert re.search(r"^standing: [\d.]+ W \(53 to 65\)$", shown, re.MULTILINE)
    assert re.search(r"^idle share at 0\.5 m/s: [\d.]+ \(0\.2325 to 0\.3875\)$", shown, re.MULTILINE)


@pytest.mark.parametrize("command", ["show", "check"])
def test_an_unknown_reality_is_one_line(capsys, command):
    assert main(["realities", command, "dev-0O"]) == 2
    said = capsys.readouterr().err.strip()
    assert "\n" not in said and "No reality named 'dev-0O'. Did you mean 'dev-" in said


@pytest.mark.parametrize("command", ["show", "check"])
@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"dynamics": {"trunk_mass_scale": 99}}, "parameters.dynamics.trunk_mass_scale: expected"),
        ({"dynamic": {}}, "parameters.dynamic: there is no key 'dynamic'"),
        ({"instruments": {"battery_gauge": {"idle_power": "x"}}}, "idle_power"),
    ],
)
def test_parameters_that_no_twin_takes_are_one_line_that_names_the_file(tmp_path, capsys, command, parameters, said):
    content = json.loads(locate("dev-00").read_text())
    file = tmp_path / "mine.json"
    file.write_text(json.dumps({**content, "parameters": parameters}))
    assert main(["realities", command, str(file)]) == 2
    line = capsys.readouterr().err
    assert line.startswith(f"error: reality {file}: ") and said in line and line.count("\n") == 1, line
    assert "TwinSettings" not in line


@pytest.mark.parametrize(
    ("changed", "absent"),
    [({"robot": "no_such_robot"}, "robot 'no_such_robot'"), ({"instrument": "no_such_gauge"}, "instrument 'no_such_g")],
)
def test_a_reality_is_shown_without_the_package_of_its_robot_or_instrument(tmp_path, capsys, changed, absent):
    content = json.loads(locate("dev-00").read_text())
    if "instrument" in changed:
        content["parameters"]["instruments"][changed["instrument"]] = {"noise": 0.5}
    content["robot"] = changed.get("robot", content["robot"])
    file = tmp_path / "mine.json"
    file.write_text(json.dumps(content))
    assert main(["realities", "show", str(file)]) == 0
    shown = capsys.readouterr()
    assert f"dev-00: a {content['robot']}, draw " in shown.out and "dynamics.trunk_mass_scale: " in shown.out
    assert f"Not installed here: {absent}" in shown.err and "was not checked" in shown.err
    assert shown.err.count("\n") == 1
    assert main(["realities", "show", str(file), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["robot"] == content["robot"]
    assert main(["realities", "check", str(file)]) == 2  # which needs a twin
    content["parameters"]["dynamics"]["trunk_mass_scale"] = 99
    file.write_text(json.dumps(content))
    assert main(["realities", "show", str(file)]) == 2  # what needs no package is checked as ever
    assert "parameters.dynamics.trunk_mass_scale: expected" in capsys.readouterr().err


def verdict(why: str) -> Verdict:
    return Verdict((Measured(name="standing", value=70.0 if why else 60.0, low=53, high=65, unit="W"),), why)


@pytest.mark.parametrize(("why", "code", "said"), [("", 0, "agrees"), ("standing 70 W", 1, "does not agree: standing")])
def test_check_says_whether_a_reality_agrees_with_the_facts(capsys, monkeypatch, why, code, said):
    monkeypatch.setattr(batch, "verdict_on", lambda reality: verdict(why))
    assert main(["realities", "check", "dev-00"]) == code
    shown = capsys.readouterr().out
    assert said in shown and ("OUTSIDE" in shown) == bool(why)
    assert main(["realities", "check", "dev-00", "--json"]) == code
    assert json.loads(capsys.readouterr().out)["agrees"] is not bool(why)


def test_a_folder_that_holds_other_things_is_not_drawn_into(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(batch, "exported_policy", lambda robot, folder, file=None: folder / "p.onnx")
    (tmp_path / "mine.txt").write_text("x")
    assert main(["realities", "draw", "--count", "1", "--seed", "s", "--robot", "go1", "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err.strip()
    assert "\n" not in said and "not empty" in said


def test_what_was_kept_is_held_against_what_was_drawn(capsys):
    assert main(["realities", "posterior", str(DRAWS), "--most", "1"]) == 0
    shown = capsys.readouterr().out
    lines = (DRAWS / "draws.jsonl").read_text().splitlines()
    assert f"16 of {len(lines) - 1} draws kept" in shown
    assert "`instruments.battery_gauge.phase_resistance`" in shown  # the one that moves most
    assert main(["realities", "posterior", str(DRAWS)]) == 0
    documented = (DRAWS.parents[1] / "realities.md").read_text(encoding="utf-8")
    assert capsys.readouterr().out.strip() in documented


def test_a_folder_without_draws_is_one_line(capsys, tmp_path):
    assert main(["realities", "posterior", str(tmp_path)]) == 2
    assert "there is no such file" in capsys.readouterr().err
