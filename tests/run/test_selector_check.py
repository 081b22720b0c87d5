"""What a selector of a plugin would end a run with after a robot has walked is told before."""

from __future__ import annotations

import pytest

from hts.config import Named
from hts.contracts import Comparison, Rounds, Selector
from hts.errors import ConfigError, PluginError
from hts.plugins import Entry, Registry
from hts.run.selector_check import check_selector

COMPARED = {"power": Comparison(0.0, 0.0, {"watts": 100.0}), "noise": Comparison(0.0, 0.0)}


def checked(comparisons=COMPARED, **methods) -> None:
    sound = {"elites": lambda self, candidates, count: [], "best": lambda self, tested: None}
    made = type("Odd", (Selector,), {**sound, **methods})
    registry = Registry(selectors={"odd": Entry("odd", lambda settings: made(), "odd-lab", {})})
    check_selector(registry, Named(name="odd"), comparisons)


def refuses(self, *given):
    raise ConfigError("two candidates are not enough")


@pytest.mark.parametrize(
    ("methods", "said"),
    [
        ({"elites": lambda self, candidates, count: [one.score for one in candidates]}, r"elites\(\) gives 0, which"),
        ({"elites": lambda self, candidates, count: candidates[0].tracks}, r"elites\(\) failed, AttributeError"),
        ({"best": lambda self, tested: tested[0].comparisons["heat"]}, r"best\(\) failed, KeyError: 'heat'"),
        ({"rounds": lambda self: Rounds(4.0, 0)}, r"rounds\(\) gives most=0"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_selector(methods, said):
    with pytest.raises(PluginError, match=rf"^Selector 'odd' \(from odd-lab\): {said}"):
        checked(**methods)


def test_what_a_selector_has_reason_to_say_of_made_up_candidates_is_let_pass():
    checked(elites=refuses, best=lambda self, tested: [1.0][0] / 0)


def test_it_sees_the_objectives_of_the_run_with_their_metrics():
    seen = []
    checked(
        elites=lambda self, candidates, count: seen.append([set(one.scores) for one in candidates]) or [],
        best=lambda self, tested: seen.append(tested[0].comparisons["power"].metrics["watts"]),
    )
    assert seen == [[{"power", "noise"}] * 2, 100.0]


def test_where_metrics_are_not_known_nobody_is_asked_for_the_best():
    checked({**COMPARED, "power": None}, best=lambda self, tested: tested[0].comparisons["power"].metrics["watts"])
