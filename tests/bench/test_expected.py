"""Predicted saving from draws like a reality's logs, against what was saved there: rules, and the whole command."""

from __future__ import annotations

import functools
import json
import shutil
import sys
from pathlib import Path

import expected as command
import pytest
from batch import expected as parts
from batch.expected import compared, reached
from batch.expected_lines import MEAN, expected_table, read_expected
from batch.lines import append
from batch.methods import reality_hash
from fake_lines import line

from hts.errors import RunError
from hts.worlds.twin.reality import locate

FAKE = (sys.executable, str(Path(__file__).parent / "fake_hts.py"))
ABOUT = {"method": "ours", "preset": "smoke", "commit": "c"}


def folder_of_draws(folder: Path, weights: dict[str, float], bound: float = 1.0) -> Path:
    """Two particles and a kept.jsonl, as the sampler leaves them."""
    folder.mkdir(parents=True, exist_ok=True)
    particle = {"distance": 0.5, "shown": {}, "simulated": 3, "accepted": 1, "point": [0.5]}
    rows = [{"size": 2, "like": {}}]
    rows += [{"generation": 0, "place": at, "bound": None, "step": 0.5, **particle} for at in (0, 1)]
    rows += [{"generation": 1, "place": at, "bound": bound, "step": 0.5, **particle} for at in (0, 1)]
    (folder / "draws.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    kept = [{"reality": name, "weight": weight, "distance": 0.5} for name, weight in weights.items()]
    (folder / "kept.jsonl").write_text("".join(json.dumps(row) + "\n" for row in kept))
    return folder


def test_predicted_is_the_weighted_mean_and_error_what_is_measured_less_it(tmp_path):
    draws = folder_of_draws(tmp_path, {"a": 0.5, "b": 0.25, "c": 0.25}, bound=1.3)
    lines = {
        "a": line(reality="a", saved=(0.1, 0.2, 0.3)),
        "b": line(reality="b", saved=(0.2, 0.2, None)),  # refused counts as 0
        "c": line(reality="c", saved=(None, None, None)),  # nobody was better
    }
    found = compared(("dev-00", "hash"), draws, lines, [line(saved=(0.2, 0.1, 0.3))], "power", ABOUT)
    assert found.speeds["0.5"].predicted == pytest.approx(0.5 * 0.1 + 0.25 * 0.2)
    assert found.speeds["1.1"].predicted == pytest.approx(0.15)
    assert found.speeds["0.5"].error == pytest.approx(0.2 - 0.1) and found.speeds["0.5"].inside is True
    assert found.speeds[MEAN].predicted == pytest.approx(0.5 * 0.2 + 0.25 * 0.4 / 3)
    assert (found.within, found.draws, found.refused, found.measured_runs) == (1.3, 3, 1, 1)
    assert found.worth == pytest.approx(1 / (0.25 + 2 / 16))
    text = expected_table([found])
    assert "| dev-00 | 0.5 | 10.0 % |" in text and "1 realities: mean error +6.7 points" in text


def test_without_a_run_there_it_is_a_prediction_alone_and_without_runs_on_draws_it_is_none(tmp_path):
    draws = folder_of_draws(tmp_path, {"a": 1.0})
    found = compared(("dev-00", "hash"), draws, {"a": line(reality="a")}, [], "power", ABOUT)
    assert found.speeds["0.8"].measured is None and found.speeds["0.8"].interval95 is None
    assert "none" in expected_table([found]) and "realities: mean error" not in expected_table([found])
    failed = line(reality="a", status="failed", error="exit status 2", result=None)
    with pytest.raises(RunError, match="dev-00: no run on its draws ended well"):
        compared(("dev-00", "hash"), draws, {"a": failed}, [], "power", ABOUT)


def test_what_was_reached_is_the_last_whole_generations(tmp_path):
    draws = folder_of_draws(tmp_path, {"a": 1.0}, bound=1.7)
    assert reached(draws) == 1.7
    whole = (draws / "draws.jsonl").read_text().splitlines(keepends=True)
    (draws / "draws.jsonl").write_text("".join(whole[:4]))
    assert reached(draws) == float("inf") and reached(tmp_path / "none") == float("inf")


def test_a_spent_budget_takes_what_was_reached_unless_that_is_too_far(tmp_path, monkeypatch):
    asked = []

    def draw_like(asked_, folder, *, within, budget, processes, tell):
        asked.append(within)
        if within < 1.7:
            folder_of_draws(folder, {"a": 1.0}, bound=1.7)
            raise RunError("spent")
        return [folder / "a.json"]

    for name, value in (("draw_like", draw_like), ("record", lambda *_: None), ("of_store", lambda *_: None)):
        monkeypatch.setattr(parts, name, value)
    monkeypatch.setattr(parts, "exported_policy", lambda robot, folder: folder / "p.onnx")
    monkeypatch.setattr(parts, "accepted", lambda folder: "")
    given = ("dev-00", "dev-00", tmp_path)
    rest = (parts.Visit(), ["power"], lambda text: None)
    assert parts.fitted(*given, parts.Fitting("go1"), *rest) == [tmp_path / "draws/a.json"]
    assert asked == [1.0, 1.7]
    with pytest.raises(RunError, match="spent"):
        parts.fitted(*given, parts.Fitting("go1", at_most=1.5), *rest)


@pytest.fixture
def whole(tmp_path, monkeypatch):
    """The command with a stand-in for `hts` and for the sampler: draws of dev-00 are copies of other realities."""

    def fitted(reality, name, folder, how, visit, objectives, tell):
        if name == "dev-02":
            raise RunError("dev-02: 3000 simulations are spent")
        tell(f"{name}: draws")
        names = [f"like-{name}-{index:02d}" for index in range(how.count)]
        draws = folder_of_draws(folder / "draws", dict.fromkeys(names, 1 / how.count))
        for index, one in enumerate(names):
            shutil.copy(locate(f"dev-{index + 5:02d}"), draws / f"{one}.json")
        return [draws / f"{one}.json" for one in names]

    monkeypatch.setenv("FAKE_HTS", str(tmp_path))
    monkeypatch.setattr(command, "fitted", fitted)
    monkeypatch.setattr(command, "run_batch", functools.partial(command.run_batch, program=FAKE))
    options = ["--preset", "smoke", "--commit", "c", "--draws", "2", "--cores", "1", "--out", str(tmp_path / "out")]

    def run(realities, *more):
        return command.main(["run", "--realities", realities, *options, *more])

    return run


def typed(tmp_path) -> list[str]:
    return (tmp_path / "typed.txt").read_text().splitlines()


def test_the_whole_command_makes_what_is_missing_and_one_line_each(tmp_path, whole, capsys):
    known = tmp_path / "known.jsonl"
    append(known, line(reality="dev-01", reality_hash=reality_hash("dev-01"), preset="smoke", saved=(0.3, 0.3, 0.3)))
    append(known, line(reality="dev-00", reality_hash=reality_hash("dev-00"), preset="quick"))  # another preset
    assert whole("dev-00,dev-01", "--measured", str(known)) == 0
    made = typed(tmp_path)
    assert len(made) == 5  # two draws each, and the run on dev-00
    assert sum("world.reality=dev-00" in text for text in made) == 1
    first, second = read_expected(tmp_path / "out/expected.jsonl")
    assert (first.reality, first.draws, first.measured_runs, second.measured_runs) == ("dev-00", 2, 1, 1)
    assert first.speeds["0.8"].predicted == pytest.approx(0.2)  # what the stand-in saves
    assert second.speeds["0.8"].error == pytest.approx(0.1)
    shown = capsys.readouterr().out
    assert "| dev-01 | 0.8 | 20.0 % |" in shown
    assert whole("dev-00,dev-01", "--measured", str(known)) == 0 and typed(tmp_path) == made
    assert command.main(["table", "--out", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().out.count("| dev-01 | 0.8 | 20.0 % |") == 2


def test_time_that_is_up_and_a_reality_that_no_draw_is_like_are_said(tmp_path, whole, capsys):
    assert whole("dev-00", "--stop-after", "0") == 75
    assert whole("dev-00,dev-02") == 1
    rows = read_expected(tmp_path / "out/expected.jsonl")
    assert rows[1].error == "dev-02: 3000 simulations are spent" and rows[0].error is None
    assert "3000 simulations" in capsys.readouterr().out
    assert whole("dev-99") == 2 and "No reality named 'dev-99'" in capsys.readouterr().err
    assert command.main(["table", "--out", str(tmp_path)]) == 2
