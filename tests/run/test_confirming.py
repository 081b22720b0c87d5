"""The best of all iterations walk once more before the final, and the best over both trials goes there."""

from __future__ import annotations

import json

import pytest

from hts.contracts import Comparison, TestedCandidate
from hts.errors import ConfigError
from hts.report.outcome import closing, second_trial
from hts.run.confirming import contenders, over_both, ranked, winner
from hts.run.judging import same_policies
from hts.selection.hierarchical import Hierarchical, HierarchicalSettings
from hts.testing.known_world import KnownWorld
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run

SELECTOR = Hierarchical(HierarchicalSettings())
TWICE = {
    "iterations": 2,
    "sweep.kl_bounds": [0.5, 1.0],
    "selection.elites": 2,
    "selection.speeds": [0.5, 0.8],
    "selection.block_seconds": 10.0,
    "selection.confirm": 2,
}
TRIALS = "iterations/00/test"


def once(name: str, gain: float, fell: bool = False) -> TestedCandidate:
    return TestedCandidate(name, {"power": Comparison(gain, gain, {})}, fell)


def gains(found: list[TestedCandidate]) -> dict[str, float]:
    return {one.id: one.comparisons["power"].selection_score for one in found}


def test_contenders_come_best_first_and_only_those_that_improved():
    before = [once("00-00", 0.1), once("00-01", 0.3), once("01-00", -0.1), once("01-01", 0.2)]
    assert [one.id for one in ranked(SELECTOR, before, 2)] == ["00-01", "01-01"]
    assert [one.id for one in ranked(SELECTOR, before, 9)] == ["00-01", "01-01", "00-00"]


def test_the_best_so_far_is_tried_twice_whatever_those_scored_that_left_a_race_before_it():
    before = [once("00-00", 0.1), once("00-01", 0.3), once("01-00", 0.2)]  # 00-01 left after a flattering round
    assert contenders(SELECTOR, before, "00-00", 2) == ["00-00", "00-01"]
    assert contenders(SELECTOR, before, "00-01", 9) == ["00-01", "01-00", "00-00"]
    assert contenders(SELECTOR, before, "00-00", 0) == contenders(SELECTOR, before, "00-00", -3) == []
    assert contenders(SELECTOR, [once("00-00", -0.1)], "pretrained", 2) == []


def test_the_mean_of_both_trials_counts_and_who_was_refused_is_out():
    before = [once("a", 0.3), once("b", 0.28), once("c", 0.1)]
    found = over_both(before, {"a": once("a", 0.1), "b": None})
    assert gains(found) == {"a": pytest.approx(0.2), "c": pytest.approx(0.1)}


def test_a_fall_in_the_second_trial_counts_as_one():
    found = over_both([once("a", 0.3), once("b", 0.1)], {"a": once("a", 0.3, fell=True), "b": once("b", 0.1)})
    assert winner(SELECTOR, found, ["a", "b"]) == "b"


def test_one_that_was_tried_twice_goes_before_one_that_was_not():
    found = [once("twice", 0.1), once("once", 0.3)]
    assert winner(SELECTOR, found, ["twice"]) == "twice"
    assert winner(SELECTOR, found[1:], ["twice"]) == "once"
    assert winner(SELECTOR, [], ["twice"]) is None


def test_policies_that_ended_alike_are_one():
    rows = [{"id": name, "policy_hash": name[-1]} for name in ("00-a", "01-b", "02-a", "03-a")]
    assert same_policies(rows) == {"02-a", "03-a"}


@pytest.mark.parametrize(
    ("row", "best", "said"),
    [
        ({"refused": "too slow"}, "00-01", "01-00 was refused; 00-01 went to the final"),
        ({"refused": None, "tested": {"fell": True}}, "00-01", "01-00 fell; 00-01 went to the final"),
        ({"refused": "too slow"}, "pretrained", "01-00 was refused; nobody is left"),
    ],
)
def test_the_end_of_a_run_says_why_another_went_to_the_final(row, best, said):
    again = {"tried": ["01-00", "00-01"], "results": {"01-00": row}, "best": best}
    found = second_trial({"iterations": [{"best_so_far": "01-00"}], "confirmation": again})
    assert found is not None and said in found


def test_nothing_is_said_of_second_trials_that_changed_nothing():
    again = {"tried": ["01-00", "00-01"], "results": {}, "best": "01-00"}
    assert second_trial({"iterations": [{"best_so_far": "01-00"}], "confirmation": again}) is None
    assert second_trial({"iterations": [{"best_so_far": "01-00"}]}) is None


@pytest.fixture
def worse_later(monkeypatch):
    """The best of the first trials saves less in the second one, whose speeds come in reverse order."""
    asked, plain = [], KnownWorld.head_to_heads_in_session
    saved: dict[str, float] = {}

    def session(self, policies, reference, speeds, block_seconds):
        again, found = list(speeds) == sorted(speeds, reverse=True), []
        asked.append([(policy.stem, again) for policy in policies])
        for policy in policies:
            saved.setdefault(policy.stem, 0.1 + 0.05 * len(saved))  # each one better than the last
            best = saved[policy.stem] == max(saved.values())
            saving = 0.01 if again and best else saved[policy.stem]
            other = KnownWorld(self.robot, [], self._idle, settings=self.settings.model_copy(update={"saving": saving}))
            other.real, other._hold = self.real, self._hold
            found += plain(other, [policy], reference, speeds, block_seconds)
        return found

    monkeypatch.setattr(KnownWorld, "head_to_heads_in_session", session)
    return asked


def test_a_run_tries_its_best_two_again_and_takes_the_best_over_both(run_on, tmp_path, worse_later):
    run = run_on(TRIALS, tmp_path / "run", TWICE)
    again = json.loads((run.folder / "confirm.json").read_text())
    first, second = again["tried"]
    assert [trial for trial, _ in worse_later[-1]] == [first, second] and all(late for _, late in worse_later[-1])
    assert again["over_both"][first]["fake"] < again["over_both"][second]["fake"]
    assert again["best"] == run.summary["final"]["policy"] == second
    assert run.summary["iterations"][-1]["best_so_far"] == first
    assert run.summary["confirmation"]["tried"] == [first, second]
    said = f"Tried again before the final, {first} measured worse; {second} went to the final."
    assert said in closing(run.summary) and said in (run.folder / "report.html").read_text()


@pytest.fixture(scope="module")
def plain(run_on, tmp_path_factory):
    """A run whose best two were tried again, for those who only read it."""
    return run_on(TRIALS, tmp_path_factory.mktemp("plain") / "run", TWICE)


def stage(run, name):
    return json.loads((run.folder / f"{name}.json").read_text())


def test_second_trials_are_counted_as_real_samples(plain):
    spent = [
        stage(plain, name)["samples"] for name in ("collect", "iterations/00/test", "iterations/01/test", "confirm")
    ]
    assert spent[-1] > 0 and plain.summary["real_samples_before_final"] == sum(spent)


def test_a_cap_that_leaves_room_for_one_leaves_the_second_trials_out(tmp_path, monkeypatch, plain):
    monkeypatch.setattr(KnownWorld, "head_to_head_session_seconds", lambda self, speeds, seconds: speeds * 4 * seconds)
    spent = plain.summary["real_samples_before_final"] - stage(plain, "confirm")["samples"]
    each = stage(plain, "iterations/00/test")["samples"] // 2
    with kit_installed():
        run = tiny_run(tmp_path / "run", settings={**TWICE, "max_real_samples": round(spent + 1.5 * each)})
    assert stage(run, "confirm")["tried"] == []
    assert run.summary["real_samples_before_final"] == spent
    assert run.summary["final"]["policy"] == plain.summary["iterations"][-1]["best_so_far"]


def test_one_candidate_leaves_nothing_to_choose_from(tmp_path):
    with kit_installed(), pytest.raises(ConfigError, match="selection.confirm: one candidate leaves nothing"):
        tiny_run(tmp_path / "run", settings={**TWICE, "selection.confirm": 1})
    assert not (tmp_path / "run").exists()


def test_a_single_speed_has_no_second_order(tmp_path):
    with kit_installed():
        run = tiny_run(tmp_path / "run", settings={**TWICE, "selection.speeds": []})
    assert run.summary["confirmation"]["tried"] == []
