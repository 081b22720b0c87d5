"""A visit that ends gently: somebody asks the robot to sit down, and it is not let fall."""

from __future__ import annotations

import importlib.util
import json
import os
import queue
import threading
from pathlib import Path

import pytest

from hts_go1_runtime.bundle import load_bundle
from hts_go1_runtime.machine import SIT
from hts_go1_runtime.operator_key import listen
from hts_go1_runtime.question import metres
from hts_go1_runtime.rest import Rest

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)
WALKS = 5.0  # s on the link's clock, when the first row's command is being trimmed


def doing(act, at: float = WALKS):
    """A robot that is as it should be, beside which something is done once."""
    done = []

    def spoil(state):
        if state.stamp > at and not done:
            done.append(act())
        return state

    return scripted.ScriptedLink(spoil)


def told(bundle) -> list[str]:
    lines = (bundle / "logs" / "events.jsonl").read_text().splitlines()
    return [json.loads(line)["what"] for line in lines]


def sits_at_last(link) -> bool:
    """Whether the last pose that was held is that of sitting."""
    held = [command for _, command in link.sent if command.kp.any()]
    return bool(abs(held[-1].q - SIT).max() < 1e-9)


@pytest.mark.parametrize("at", [WALKS, 8.5], ids=["while a command is trimmed", "in a row"])
def test_the_file_sit_lets_the_robot_sit_down_and_the_row_is_walked_again(bundle, visit, capsys, at):
    link = doing((bundle / "SIT").touch, at)
    assert visit("--yes", link=link) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("refused: Asked to sit down (the file SIT): the visit ends here. Rows that have a log stay")
    assert "sat down" in told(bundle) and "stopped" not in told(bundle) and sits_at_last(link)
    assert visit("--yes") == 2  # the file is still there
    assert f"{bundle / 'SIT'}: is there and means sit down. Remove it to begin." in capsys.readouterr().err
    (bundle / "SIT").unlink()
    assert visit("--yes") == 0
    assert sorted(path.name for path in (bundle / "logs").glob("*.csv")) == ["00.csv", "01.csv"]


def test_one_that_was_asked_before_it_stands_does_not_stand_up(bundle, visit):
    link = doing((bundle / "SIT").touch, 0.2)
    assert visit("--yes", link=link) == 2
    assert not any(command.kp.any() for _, command in link.sent)


def test_s_and_enter_let_it_sit_down(bundle, visit, monkeypatch, capsys):
    (reading, typing), heard, ask = os.pipe(), threading.Event(), Rest.ask
    monkeypatch.setattr(Rest, "ask", lambda rest, how: (ask(rest, how), heard.set()))
    before = set(threading.enumerate())
    with os.fdopen(reading) as keys:
        monkeypatch.setattr("sys.stdin", keys)

        def typed() -> None:
            os.write(typing, b" S \n")
            assert heard.wait(60)  # by the thread that reads it

        link = doing(typed)
        assert visit("--yes", link=link) == 2
        assert "Asked to sit down (the key s)" in capsys.readouterr().err
        assert sits_at_last(link)
        os.close(typing)
        for thread in set(threading.enumerate()) - before:
            thread.join(60)


@pytest.mark.parametrize("line", ["\n", "ss\n", "stop\n", "x\n"])
def test_any_other_line_stops_the_robot_at_once(line):
    said: queue.SimpleQueue[str] = queue.SimpleQueue()
    reading, typing = os.pipe()
    with os.fdopen(reading) as keys:
        listen(lambda reason, detail: said.put(f"{reason}: {detail}"), keys, said.put, lambda how: said.put(how))
        os.write(typing, b"s\n" + line.encode())
        assert [said.get(timeout=60), said.get(timeout=60)] == ["the key s", "operator: a key on the terminal"]
        os.close(typing)


def test_the_question_says_how_far_it_walks(bundle, visit, capsys):
    rows = load_bundle(bundle).rows
    assert metres(load_bundle(bundle), rows, False, 600.0) == pytest.approx(0.6 * (600 + 2 * 2.0 + 2 * 1.0))
    assert metres(load_bundle(bundle), rows, True, 600.0) == pytest.approx(2 * 20.0 * 0.5 * 0.6)
    assert visit("--yes", "--warmup", "1") == 0
    assert "It walks about 4 m without a pause, keeps its heading and sees nothing" in capsys.readouterr().out
