"""The question whether everybody is clear: what answers it, and what does not."""

from __future__ import annotations

import dataclasses
import importlib.util
import io
import os
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from hts_go1_runtime.link import DAMPING

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)
ScriptedLink = scripted.ScriptedLink
ENTER = 60.0
"""s after the question, for whom it was not ended by then: no busy computer takes so long."""


class Screen(io.StringIO):
    """What is shown; `answer` is called once the question is."""

    def __init__(self, answer) -> None:
        super().__init__()
        self._answer = answer

    def write(self, text: str) -> int:
        written, asked = super().write(text), "Enter begins" in text
        if asked:
            self._answer()
        return written


@pytest.fixture
def terminal(monkeypatch):
    """terminal(answer): stdin is a terminal; bytes that are typed into it from now on, and once it asks."""
    typing, reading = os.openpty()
    before, later = set(threading.enumerate()), []
    keys = os.fdopen(reading)
    monkeypatch.setattr(sys, "stdin", keys)

    def made(answer, early: bytes = b"") -> Screen:
        os.write(typing, early)
        screen = Screen(answer if callable(answer) else lambda: os.write(typing, answer))
        monkeypatch.setattr(sys, "stdout", screen)
        return screen

    def after(seconds: float, act, *arguments) -> None:
        later.append(threading.Timer(seconds, act, arguments))
        later[-1].start()

    made.type, made.after = lambda text: os.write(typing, text), after
    yield made
    for one in later:
        one.cancel()
    os.close(typing)  # whoever still listens for a key hears its end
    for thread in set(threading.enumerate()) - before:
        thread.join(10)
    keys.close()


def moved(link) -> bool:
    return any(command is not DAMPING for _, command in link.sent)


def test_enter_alone_begins(terminal, visit):
    screen = terminal(b"\n")
    assert visit() == 0
    assert "recorded log=01" in screen.getvalue()


@pytest.mark.parametrize("typed", [b"no\n", b"n\n", b" \n", b"y\n", b"no\x04\n"])
def test_any_word_is_a_no(terminal, visit, typed, capsys):
    terminal(typed)
    link = ScriptedLink()
    assert visit(link=link) == 2
    assert link.sent == []
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("refused: ") and "Enter alone begins" in line and "Nothing has moved" in line


def test_the_end_of_what_is_typed_is_a_no(terminal, visit, capsys):
    terminal(b"\x04")
    link = ScriptedLink()
    assert visit(link=link) == 2
    assert link.sent == []
    assert "Nobody said that the robot may move" in capsys.readouterr().err


def test_without_any_input_nothing_begins(monkeypatch, visit, capsys):
    monkeypatch.setattr(sys, "stdin", None)
    assert visit() == 2
    assert "Nobody said that the robot may move" in capsys.readouterr().err


def test_enter_that_was_pressed_before_the_question_does_not_answer_it(terminal, visit, capsys):
    screen = terminal(b"no\n", early=b"\n\n")
    link = ScriptedLink()
    assert visit(link=link) == 2
    assert link.sent == []
    assert "'no'" in capsys.readouterr().err
    assert "waiting for the robot's first state at_most_s=10" in screen.getvalue()


def interrupted(terminal, visit, act, typed: bytes = b"") -> tuple[int, float, ScriptedLink]:
    """Exit code, seconds, and the robot of a visit to which something comes while it asks. Enter comes at ENTER."""

    def answer() -> None:
        if typed:
            terminal.type(typed)
        terminal.after(0.3, act)
        terminal.after(ENTER, terminal.type, b"\n")

    terminal(answer)
    link, began = ScriptedLink(), time.monotonic()
    return visit(link=link), time.monotonic() - began, link


@pytest.mark.parametrize("typed", [b"", b"n"])
def test_ctrl_c_at_the_question_ends_it_at_once(terminal, visit, typed, capsys):
    code, seconds, link = interrupted(terminal, visit, lambda: os.kill(os.getpid(), signal.SIGINT), typed)
    assert (code, moved(link)) == (3, False)
    assert seconds < ENTER
    assert capsys.readouterr().err.startswith("stopped: operator: signal SIGINT. ")


def test_the_file_stop_at_the_question_ends_it_at_once(terminal, visit, bundle, capsys):
    code, seconds, link = interrupted(terminal, visit, (bundle / "STOP").touch)
    assert (code, moved(link)) == (3, False)
    assert seconds < ENTER
    assert "the file STOP is there" in capsys.readouterr().err
    assert '"what": "stopped", "reason": "operator"' in (bundle / "logs" / "events.jsonl").read_text()


def test_ctrl_c_while_the_robot_says_nothing_ends_it(visit, capsys):
    looks = []

    def nothing(state) -> None:
        looks.append(state)
        if len(looks) == 20:  # not by a clock, which may be ahead of a visit that has not begun
            os.kill(os.getpid(), signal.SIGINT)

    assert visit("--yes", link=ScriptedLink(nothing)) == 3
    assert "signal SIGINT" in capsys.readouterr().err


def test_a_robot_that_stood_up_while_a_person_thought_is_not_let_down(terminal, visit, capsys):
    up = threading.Event()
    loaded = np.tile([0.0, 0.5, 5.0], 4)
    link = ScriptedLink(lambda state: dataclasses.replace(state, tau=state.tau + up.is_set() * loaded))

    def answer() -> None:
        up.set()
        terminal.type(b"\n")

    terminal(answer)
    assert visit(link=link) == 2
    assert link.sent == []
    assert "lay it down first" in capsys.readouterr().err.lower()
