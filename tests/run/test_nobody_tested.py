"""A candidate that fell in simulation is never given to a machine; a run in which that is all of them still ends."""

from __future__ import annotations

import dataclasses
import math

import pytest

from hts.run import judging
from hts.run.passed_over import could_be_tried
from hts.testing.known_world import KnownWorld
from hts.testing.packages import kit_installed, on_path
from hts.testing.tiny_run import tiny_run


@pytest.mark.parametrize(
    ("falls", "stopped", "lenient", "allowed"),
    [
        (0, None, False, True),
        (1, None, False, False),
        (0, "NaN at step 3", False, False),
        (1, None, True, True),
        (0, "NaN at step 3", True, True),
    ],
)
def test_who_fell_or_was_stopped_in_simulation_is_no_elite_for_a_machine(falls, stopped, lenient, allowed):
    assert judging.may_be_tested(falls, stopped, lenient) is allowed


@pytest.mark.parametrize("selector", ["hierarchical", "racing"])
def test_a_run_on_a_machine_whose_candidates_all_fell_tests_nobody_and_says_so(tmp_path, monkeypatch, capsys, selector):
    judge = judging._judge

    def all_fall(*given):
        return dataclasses.replace(judge(*given), falls=1)

    monkeypatch.setattr(judging, "_judge", all_fall)
    asked = []
    monkeypatch.setattr(KnownWorld, "simulated", False)
    monkeypatch.setattr(KnownWorld, "head_to_heads", lambda self, policies, *rest: asked.append(policies) or [])
    with kit_installed():
        run = tiny_run(tmp_path / "run", selector=selector)
    assert asked == []  # a world need not know how to walk nobody
    assert run.summary is not None
    (iteration,) = run.summary["iterations"]
    assert not any(row["elite"] for row in iteration["candidates"]) and iteration["best"] is None
    assert run.summary["final"]["policy"] == "pretrained"
    assert run.summary["measurement_models"]["fake"]["policies"] == 0
    assert math.isfinite(run.summary["real_samples"])
    said = " ".join(capsys.readouterr().out.split())
    assert "nobody was tested: every candidate fell or was stopped in simulation" in said
    assert "no candidate was tested, since all fell or were stopped in simulation" in said
    assert (tmp_path / "run" / "report.html").is_file()


CHOOSES_NOBODY = """
from hts import hookimpl
from hts.contracts import Selector

HTS_API = 2


class Nobody(Selector):
    def elites(self, candidates, count):
        return []

    def best(self, tested):
        return None


@hookimpl
def hts_selectors(register):
    register("nobody", lambda settings: Nobody())
"""


def test_a_selector_that_chooses_nobody_is_said_to_and_not_simulation(tmp_path, install, capsys):
    with kit_installed(), on_path(install("odd-lab", {"odd_lab": CHOOSES_NOBODY}, {"odd": "odd_lab"})):
        run = tiny_run(tmp_path / "run", selector="nobody")
    assert run.summary is not None
    (iteration,) = run.summary["iterations"]
    count = len(iteration["candidates"])
    assert iteration["passed_over"] == {"selector": "nobody", "candidates": count} and count > 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"nobody was tested: selector 'nobody' chose nobody of {count} candidate" in said
    assert "no candidate was tested, since selector 'nobody' chose nobody of" in said
    assert "in simulation" not in said[said.index("nobody was tested") :]


def row(name: str, policy: str = "", stopped: str | None = None) -> dict:
    return {"id": name, "policy_hash": policy or name, "stopped": stopped}


def test_who_could_be_tried_is_who_neither_fell_nor_was_stopped_nor_is_a_twin_nor_was_refused():
    rows = [row("stands"), row("fell"), row("stopped", stopped="NaN"), row("twin", "stands"), row("refused")]
    falls = {one["id"]: int(one["id"] == "fell") for one in rows}
    gated = {"policies": {"refused": {"passed": False}}}
    assert could_be_tried(rows, falls, gated, lenient=False) == ["stands"]
    assert could_be_tried(rows, falls, None, lenient=False) == ["stands", "refused"]
    assert could_be_tried(rows, falls, None, lenient=True) == ["stands", "fell", "stopped", "refused"]
