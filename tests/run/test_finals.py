"""A policy that loses a speed in its final, or falls there, makes room for the next one of the trials."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hts.errors import EvaluationError
from hts.evaluation import final as judging
from hts.evaluation.held import NotComparable
from hts.report.outcome import closing, finals_before
from hts.run import finals
from hts.run.finals import Tried
from hts.testing.known_world import KnownWorld
from hts.worlds.base import file_hash

SETTINGS = {
    "sweep.kl_bounds": [0.5, 1.0, 2.0],
    "selection.elites": 3,
    "selection.confirm": 2,
    "selection.speeds": [0.5, 0.8],
    "selection.block_seconds": 10.0,
    "evaluation.speeds": [0.5, 0.8],
    "evaluation.min_valid": 0.5,
    "evaluation.min_segments": 5,
    "evaluation.finals": 3,
}


@pytest.fixture
def losing(monkeypatch):
    """lost: for each policy that gets a final, in turn, the speeds at which it walks too slowly there."""
    lost, asked, plain = [], [], KnownWorld.head_to_head

    def head_to_head(self, policy, reference, speeds):
        name = file_hash(policy)
        if name not in asked:
            asked.append(name)
        number, found = asked.index(name), []
        for speed in speeds:
            slow = speed in (lost[number] if number < len(lost) else ())
            settings = self.settings.model_copy(update={"pace": 0.7 if slow else 1.0})
            other = KnownWorld(self.robot, [], self._idle, settings=settings)
            other.real, other._hold = self.real, self._hold
            found += plain(other, policy, reference, [speed])
        return found

    monkeypatch.setattr(KnownWorld, "head_to_head", head_to_head)
    return lost, asked


@pytest.fixture(scope="module")
def ended(run_on):
    """ended(tmp_path, **settings): the run, who gets finals in turn, final.json. Of runs with the same settings only
    the finals are walked anew."""

    def ended(tmp_path, **settings):
        run = run_on("final", tmp_path / "run", SETTINGS | settings)
        again = json.loads((run.folder / "confirm.json").read_text())
        return run, [again["best"], *again["next"]], json.loads((run.folder / "final.json").read_text())

    return ended


@pytest.fixture(scope="module")
def kept(ended, tmp_path_factory):
    """A run whose best policy keeps all speeds, and how many finals were walked."""
    finals_of, plain = [], KnownWorld.head_to_head
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            KnownWorld,
            "head_to_head",
            lambda self, policy, *rest: finals_of.append(file_hash(policy)) or plain(self, policy, *rest),
        )
        return *ended(tmp_path_factory.mktemp("kept")), len(set(finals_of))


def test_the_first_final_is_all_of_the_stage_while_it_keeps_all_speeds(tmp_path, monkeypatch):
    shares = []
    monkeypatch.setattr(finals, "_final_of", lambda job, name, report: report(1.0) or Tried(name))
    finals.final(SimpleNamespace(folder=tmp_path), ["00-00", "00-01", "01-00"], shares.append)
    assert shares == [1.0]


def test_who_keeps_all_speeds_needs_no_other(kept):
    run, (best, *_), final, finals_walked = kept
    assert final["policy"] == best and final["given_up"] == [] and finals_walked == 1
    own = run.folder / f"iterations/{best[:2]}/candidates/{best}.gate.json"
    assert (run.folder / "policies/best.gate.json").read_text() == own.read_text()
    assert "given_up" not in run.summary["final"] and finals_before(run.summary) == []


def test_the_next_one_of_the_trials_takes_the_place_of_who_lost_a_speed(ended, tmp_path, losing, kept):
    losing[0][:] = [[0.5]]
    run, (best, second, *_), final = ended(tmp_path)
    assert final["policy"] == run.summary["final"]["policy"] == second and len(losing[1]) == 2
    (before,) = run.summary["final"]["given_up"]
    assert before["policy"] == best and list(before["refused"]["fake"]) == ["0.5"] and before["falls"] == 0
    assert sorted(run.summary["final"]["objectives"]["fake"]["speeds"]) == ["0.5", "0.8"]
    assert (run.folder / "policies/best.onnx").read_bytes() == (
        run.folder / f"iterations/{second[:2]}/candidates/{second}.onnx"
    ).read_bytes()
    assert len(final["recordings"]) == 2 * len(kept[2]["recordings"])  # what was walked in vain is kept
    said = f"In a final of its own {best} was refused at 0.5 m/s; {second} is the result."
    assert said in closing(run.summary) and said in (run.folder / "report.html").read_text()


def test_where_all_lose_it_is_who_loses_fewest_and_the_first_of_these(ended, tmp_path, losing):
    losing[0][:] = [[0.5, 0.8], [0.5], [0.8]]
    run, order, final = ended(tmp_path)
    assert final["policy"] == order[1] and [one["policy"] for one in final["given_up"]] == [order[0], order[2]]
    assert list(final["objectives"]["fake"]["refused"]) == ["0.5"] and "error" in final["given_up"][0]
    assert (run.folder / "policies/best.onnx").read_bytes() == (
        run.folder / f"iterations/{order[1][:2]}/candidates/{order[1]}.onnx"
    ).read_bytes()


def test_one_final_alone_is_as_before(ended, tmp_path, losing):
    losing[0][:] = [[0.5]]
    _, (best, *_), final = ended(tmp_path, **{"evaluation.finals": 1})
    assert final["policy"] == best and list(final["objectives"]["fake"]["refused"]) == ["0.5"]


def test_where_nobody_keeps_any_speed_the_policy_to_start_from_stays_and_what_was_walked_is_kept(
    ended, tmp_path, losing
):
    losing[0][:] = [[0.5, 0.8]] * 3
    run, order, final = ended(tmp_path)
    assert final["policy"] == run.summary["final"]["policy"] == "pretrained" and final["objectives"] == {}
    assert [one["policy"] for one in run.summary["final"]["given_up"]] == order[:3]
    assert all("segments of the policy are valid" in one["error"] for one in final["given_up"])
    assert final["samples"] > 0 and len(final["recordings"]) == 3 * 4 * len(SETTINGS["evaluation.speeds"])
    assert run.summary["real_samples"] == run.summary["real_samples_before_final"] + final["samples"]
    assert (run.folder / "policies/best.onnx").read_bytes() == (run.folder / "policies/pretrained.onnx").read_bytes()
    assert not (run.folder / "policies/best.gate.json").exists()  # nobody looked at that one
    said = closing(run.summary)
    assert said[0].startswith("No final head-to-head counts: nobody who got one could be compared at any speed")
    assert f"In a final of its own {order[0]} could not be compared at all; pretrained is the result." in said
    assert said[0] in (run.folder / "report.html").read_text()


def test_a_reference_that_cannot_be_judged_ends_the_run_in_one_line(ended, tmp_path, losing, monkeypatch):
    losing[0][:] = [[0.5, 0.8]] * 3
    judge = judging.walked_speeds

    def blaming_the_reference(*args):
        try:
            return judge(*args)
        except NotComparable as error:
            raise NotComparable(str(error), "reference") from error

    monkeypatch.setattr(judging, "walked_speeds", blaming_the_reference)
    with pytest.raises(EvaluationError, match="segments of the policy are valid"):
        ended(tmp_path)
    assert len(losing[1]) == 1


def test_a_speed_that_the_reference_misses_costs_nobody_the_final(ended, tmp_path, monkeypatch):
    plain, order = KnownWorld.head_to_head, []

    def head_to_head(self, policy, reference, speeds):
        order.append(file_hash(policy))
        return [
            one.replace(channels={**one.channels, "base_velocity": _slower(one.channels["base_velocity"])})
            if one.role == "reference" and one.schedule.commands[0].vx == 0.5
            else one
            for one in plain(self, policy, reference, speeds)
        ]

    monkeypatch.setattr(KnownWorld, "head_to_head", head_to_head)
    run, (best, *_), final = ended(tmp_path)
    assert final["policy"] == best and final["given_up"] == [] and len(order) == 1
    entry = run.summary["final"]["objectives"]["fake"]
    assert list(entry["speeds"]) == ["0.8"]
    assert "segments of the reference policy are valid" in entry["refused"]["0.5"]


def _slower(series):
    return replace(series, values=series.values * np.float32(0.6))


def test_a_final_that_can_be_judged_counts_whatever_a_later_reference_does(ended, tmp_path, losing, monkeypatch):
    losing[0][:] = [[0.5], [0.5, 0.8]]
    judge = judging.walked_speeds

    def blaming_the_reference(*args):
        try:
            return judge(*args)
        except NotComparable as error:
            raise NotComparable(str(error), "reference") from error

    monkeypatch.setattr(judging, "walked_speeds", blaming_the_reference)
    run, order, final = ended(tmp_path)
    assert final["policy"] == order[0] and [one["policy"] for one in final["given_up"]] == [order[1]]
    assert list(run.summary["final"]["objectives"]["fake"]["refused"]) == ["0.5"]


def test_where_both_are_why_no_speed_is_left_it_is_the_policy_that_is_said(monkeypatch):
    why = {"0.5": NotComparable("the reference", "reference"), "0.8": NotComparable("the policy")}
    monkeypatch.setattr(judging, "judged_speeds", lambda *args: ({}, why))
    with pytest.raises(NotComparable, match="the policy"):
        judging.entry_both_ways(None, [], [], None)


def test_a_fall_counts_and_what_was_the_references_fault_does_not():
    kept = Tried("a", {"power": {"speeds": {}, "refused": {"1.1": "the reference policy cannot be held"}}})
    fell = Tried("b", blamed={"1.1"}, fallen={"0.5": 2, "1.1": 1})
    assert kept.lost == 0 and fell.lost == 2 and fell.given_up()["falls"] == 3
