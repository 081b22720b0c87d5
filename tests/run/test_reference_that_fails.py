"""A reference that does not keep its speed costs the trial in which it did not, and the run where there is no other."""

from __future__ import annotations

import pytest

from hts.contracts import TestedCandidate
from hts.evaluation.final import CandidateResult
from hts.evaluation.head_to_head import TooFewSegments
from hts.recordings.recording import Series
from hts.run.testing_elites import Tests, check_reference
from hts.testing.known_world import KnownWorld

TWO_TRIED = {"sweep.kl_bounds": [1.0, 2.0], "selection.elites": 2, "finetune.steps": 96}


TRIALS = "iterations/00/test"


def standing_reference(monkeypatch, in_trial):
    """The reference stands in the trials whose number, counted from 0, `in_trial` is true of."""
    plain, trials = KnownWorld._head_to_head, []

    def head_to_head(self, policy, *rest):
        found = plain(self, policy, *rest)
        trials.append(policy)
        return [stand(one) if one.role == "reference" and in_trial(len(trials) - 1) else one for one in found]

    monkeypatch.setattr(KnownWorld, "_head_to_head", head_to_head)
    return trials


def stand(recording):
    walked = recording.channels["base_velocity"]
    still = Series(walked.channel, 0.0 * walked.values)
    return recording.replace(channels={**recording.channels, "base_velocity": still})


def test_who_met_it_is_refused_and_the_other_goes_on(run_on, tmp_path, monkeypatch, capsys):
    trials = standing_reference(monkeypatch, lambda number: number == 0)
    run = run_on(TRIALS, tmp_path / "run", TWO_TRIED)
    (iteration,) = run.summary["iterations"]
    first, second = (next(row for row in iteration["candidates"] if row["id"] in trial.stem) for trial in trials[:2])
    assert "segments of the reference policy are valid" in first["refused"] and not first["real"]
    assert f"{first['id']}: Head-to-head at 0.8 m/s: 0 of 20" in capsys.readouterr().out
    assert second["real"] and not second.get("refused")
    assert run.summary["final"]["policy"] == second["id"]


def test_a_run_ends_where_it_is_why_nobody_could_be_compared(run_on, tmp_path, monkeypatch):
    standing_reference(monkeypatch, lambda number: True)
    with pytest.raises(TooFewSegments, match="0 of 20 segments of the reference policy are valid"):
        run_on(TRIALS, tmp_path / "run", TWO_TRIED)


def test_nor_does_it_go_on_to_the_final_where_nobody_could_be_confirmed(run_on, tmp_path, monkeypatch):
    standing_reference(monkeypatch, lambda number: number >= 2)
    with pytest.raises(TooFewSegments, match="0 of 20 segments of the reference policy are valid"):
        run_on(TRIALS, tmp_path / "run", {**TWO_TRIED, "selection.confirm": 2})


def racing(monkeypatch, stands_beside):
    """The world knows rounds, a short head-to-head of each that still races; the reference stands beside those whose
    name `stands_beside` is true of. Gives the names of the first round."""
    names = []

    def head_to_head_round(self, policies, reference, speed, number, block_seconds):
        names.extend(policy.stem for policy in policies if number == 0)
        speeds = [speed] if isinstance(speed, float) else speed
        rows = []
        for policy in policies:
            row, stands = self._head_to_head(policy, reference, speeds, block_seconds), stands_beside(policy.stem)
            rows.append([stand(one) if one.role == "reference" and stands else one for one in row])
        return rows

    monkeypatch.setattr(KnownWorld, "head_to_head_round", head_to_head_round)
    return names


def test_a_race_in_which_it_stands_beside_one_elite_goes_on_with_the_other(run_on, tmp_path, monkeypatch):
    names = racing(monkeypatch, lambda name: name == names[0])
    run = run_on(TRIALS, tmp_path / "run", TWO_TRIED, selector="racing")
    (iteration,) = run.summary["iterations"]
    first, second = (next(row for row in iteration["candidates"] if row["id"] in name) for name in names)
    assert "segments of the reference policy are valid" in first["refused"] and not first["real"]
    assert second["real"] and run.summary["final"]["policy"] == second["id"]


def test_a_race_in_which_it_always_stands_ends_the_run(run_on, tmp_path, monkeypatch):
    names = racing(monkeypatch, lambda name: True)
    with pytest.raises(TooFewSegments, match="segments of the reference policy are valid"):
        run_on(TRIALS, tmp_path / "run", TWO_TRIED, selector="racing")
    assert len(names) == 2


@pytest.mark.parametrize(("simulated", "said"), [(True, True), (False, False), (None, False)])
def test_only_a_simulated_world_says_that_going_on_ends_the_same(run_on, tmp_path, monkeypatch, simulated, said):
    standing_reference(monkeypatch, lambda number: True)
    monkeypatch.setattr(KnownWorld, "simulated", simulated)
    with pytest.raises(TooFewSegments) as ended:
        run_on(TRIALS, tmp_path / "run", TWO_TRIED)
    assert ("would simulate the same session and end the same" in str(ended.value)) is said
    assert ended.value.role == "reference"


def result(compared=False, reference=None):
    tested = TestedCandidate("00-00", {}, False) if compared else None
    return CandidateResult(None, tested, None if compared else "why", reference=reference)


def test_a_trial_that_gave_a_number_says_that_the_reference_can_walk(hts_known_world):
    few = TooFewSegments("few", "reference")
    said, world = [], hts_known_world
    check_reference(Tests({}, [], {"00-00": result(compared=True), "00-01": result(reference=few)}), world, said.append)
    assert said == ["why"]
    check_reference(Tests({}, [], {"00-00": result()}), world, said.append)  # refused for what it did itself
    check_reference(Tests({}, [], {}), world, said.append)
    with pytest.raises(TooFewSegments):
        check_reference(Tests({}, [], {"00-00": result(), "00-01": result(reference=few)}), world, said.append)
    assert said == ["why"]
