"""A whole run at held speed, elites tried at two speeds, in a world whose policies walk slower than they are told."""

from __future__ import annotations

import json

import pytest

from hts.errors import ConfigError
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run

HELD = {
    "evaluation.hold_speed": True,
    "evaluation.speeds": [0.5, 0.8],
    "selection.speeds": [0.5, 0.8],
    "selection.block_seconds": 10.0,
    "world.pace": 0.97,
}


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    with kit_installed():
        return tiny_run(tmp_path_factory.mktemp("held") / "run", settings=HELD)


def test_the_final_figures_are_held_ones_with_those_at_equal_commands_beside(held):
    final = held.summary["final"]["objectives"]["fake"]
    for speed in (0.5, 0.8):
        at_speed, beside = final["speeds"][str(speed)], final["open_loop"]["speeds"][str(speed)]
        assert (at_speed["held"], beside["held"]) == (True, False)
        assert at_speed["mean_speed"] == pytest.approx(speed, rel=1e-4)
        assert at_speed["commanded"] == pytest.approx(speed / 0.97)
        assert at_speed["reference"]["commanded"] == beside["commanded"] == speed
        assert beside["mean_speed"] == pytest.approx(0.97 * speed, rel=1e-4)


def test_elites_are_tried_at_both_speeds_in_short_blocks_and_count_by_their_mean(held):
    (iteration,) = held.summary["iterations"]
    (elite,) = [one for one in iteration["candidates"] if one["elite"]]
    entries = elite["real"]["fake"]
    assert list(entries) == ["0.5", "0.8"] and all(one["held"] for one in entries.values())
    assert all(one["segments"] == 2 * (10 - 2) for one in entries.values())
    mean = sum(one["improvement"] for one in entries.values()) / 2
    (front,) = [one for one in held.summary["front"]["real"] if one["id"] == elite["id"]]
    assert front["improvements"]["fake"]["improvement"] == pytest.approx(mean)
    assert elite["selection_scores"]["fake"] == pytest.approx(mean)  # this objective selects by its improvement


def test_the_report_says_which_figures_are_which(held):
    page = (held.folder / "report.html").read_text()
    assert "At held speed" in page and "At equal commands (open loop)" in page
    assert page.index("At held speed") < page.index("At equal commands (open loop)")


def test_every_block_of_both_finals_is_kept(held):
    recorded = json.loads((held.folder / "final.json").read_text())["recordings"]
    assert len(recorded) == 2 * 2 * 4


def test_a_command_that_would_leave_the_trained_range_refuses_that_speed_alone(tmp_path):
    narrow = {"finetune.env.commands.vx": [0.3, 0.81]}  # 0.8 / 0.97 is more
    with kit_installed():
        run = tiny_run(tmp_path / "run", settings={**HELD, **narrow, "selection.speeds": [0.5]})
    final = run.summary["final"]["objectives"]["fake"]
    assert list(final["speeds"]) == ["0.5"] and list(final["open_loop"]["speeds"]) == ["0.5", "0.8"]
    assert "its command reached the end of the range (0.81 m/s" in final["refused"]["0.8"]


def test_a_world_that_cannot_hold_a_speed_is_refused_before_a_folder_is_made(tmp_path, monkeypatch):
    from hts.contracts import World
    from hts.testing.known_world import KnownWorld

    monkeypatch.setattr(KnownWorld, "hold_speed", World.hold_speed)
    with kit_installed(), pytest.raises(ConfigError, match="World 'known' cannot hold a speed"):
        tiny_run(tmp_path / "run", settings=HELD)
    assert not (tmp_path / "run").exists()
