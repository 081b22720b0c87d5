"""What a selector of somebody else may answer, and how a wrong answer is said."""

from __future__ import annotations

import pytest

from hts.checked_selector import CheckedSelector
from hts.contracts import Comparison, RacedCandidate, Rounds, Selector, SimulatedCandidate, TestedCandidate
from hts.errors import ConfigError, PluginError
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run

SIMULATED = [SimulatedCandidate(name, 1.0, 0, True) for name in ("a", "b", "c")]
TESTED = [TestedCandidate(name, {"power": Comparison(0.1, 0.1)}, False) for name in ("a", "b")]
RACED = [RacedCandidate(name, None, True, []) for name in ("a", "b")]


def asked(capped=False, **answers) -> CheckedSelector:
    """A selector that answers so; an answer that is a function is called."""

    def method(answer):
        return lambda self, *given: answer(*given) if callable(answer) else answer

    sound = {"elites": lambda candidates, count: ["a"], "best": lambda tested: "a"}
    made = type("Odd", (Selector,), {name: method(answer) for name, answer in (sound | answers).items()})
    return CheckedSelector(made(), "Selector 'odd' (from odd-lab)", capped)


def fails(*given):
    raise KeyError("zz")


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (["a", "zz"], r"elites\(\) gives 'zz', which is none of \['a', 'b', 'c'\]"),
        (["a", "a"], r"elites\(\) gives a candidate twice"),
        ("a", r"elites\(\) gives 'a', expected a list of ids"),
        (None, r"elites\(\) gives None, expected a list of ids"),
        (SIMULATED[:1], r"elites\(\) gives a SimulatedCandidate, which is none of|elites\(\) gives Simul"),
        (fails, r"elites\(\) failed, KeyError: 'zz'"),
    ],
)
def test_elites_are_known_each_once_and_no_more_than_were_asked_for(answer, said):
    with pytest.raises(PluginError, match=rf"^Selector 'odd' \(from odd-lab\): .*{said}|{said}") as caught:
        asked(elites=answer).elites(SIMULATED, 2)
    assert "\n" not in str(caught.value)


def test_more_than_were_asked_for_are_tried_but_where_a_cap_was_counted_for_fewer():
    assert asked(elites=["a", "b", "c"]).elites(SIMULATED, 2) == ["a", "b", "c"]
    with pytest.raises(PluginError, match=r"elites\(\) gives 3 candidates, but max_real_samples is enough for 2"):
        asked(capped=True, elites=["a", "b", "c"]).elites(SIMULATED, 2)


def test_sound_answers_pass():
    odd = asked(elites=lambda candidates, count: ("b", "a"), rounds=Rounds(4.0, 3), keep=lambda raced: ["b"])
    assert odd.elites(SIMULATED, 2) == ["b", "a"] and odd.best(TESTED) == "a" and odd.keep(RACED) == ["b"]
    assert odd.rounds() == Rounds(4.0, 3) and asked(best=None).best(TESTED) is None and asked().rounds() is None
    asked().check(["power"])


@pytest.mark.parametrize(
    ("method", "answer", "said"),
    [
        ("best", lambda tested: tested[0], r"best\(\) gives a TestedCandidate, expected None or one of"),
        ("best", "zz", r"best\(\) gives 'zz', expected None or one of \['a', 'b'\]"),
        ("rounds", 3, r"rounds\(\) gives 3, expected None or Rounds"),
        ("keep", ["zz"], r"keep\(\) gives 'zz', which is none of"),
        ("check", fails, r"check\(\) failed, KeyError"),
    ],
)
def test_other_wrong_answers_are_said_in_one_line(method, answer, said):
    given = {"best": (TESTED,), "rounds": (), "keep": (RACED,), "check": (["power"],)}[method]
    with pytest.raises(PluginError, match=said):
        getattr(asked(**{method: answer}), method)(*given)


def test_its_own_words_about_settings_pass():
    def refuses(objectives):
        raise ConfigError("no such objective")

    with pytest.raises(ConfigError, match="^no such objective$"):
        asked(check=refuses).check(["power"])


def test_a_run_ends_in_that_line_before_anybody_walks(tmp_path, monkeypatch):
    from hts.selection.hierarchical import Hierarchical

    monkeypatch.setattr(Hierarchical, "elites", lambda self, candidates, count: ["zz"])
    with kit_installed(), pytest.raises(PluginError, match=r"Selector 'hierarchical' .*elites\(\) gives 'zz'"):
        tiny_run(tmp_path / "run")
    assert not (tmp_path / "run" / "iterations" / "00" / "test.json").exists()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (Rounds(4.0, 0), r"rounds\(\) gives most=0, expected a whole number of at least 1"),
        (Rounds(4.0, 2.5), r"rounds\(\) gives most=2.5"),
        (Rounds(-4.0, 3), r"rounds\(\) gives block_seconds=-4.0, expected 1 s at least"),
        (Rounds(0.01, 3), r"rounds\(\) gives block_seconds=0.01, expected 1 s at least"),
        (Rounds("4", 3), r"rounds\(\) gives block_seconds='4'"),
        (Rounds(float("nan"), 3), r"rounds\(\) gives block_seconds=nan"),
    ],
)
def test_rounds_that_nobody_can_walk_are_refused(given, said):
    with pytest.raises(PluginError, match=said):
        asked(rounds=given).rounds()


def test_a_selector_that_sorts_what_it_is_given_sorts_a_copy():
    given = list(SIMULATED)
    asked(elites=lambda candidates, count: [candidates.pop().id]).elites(given, 1)
    assert given == SIMULATED
