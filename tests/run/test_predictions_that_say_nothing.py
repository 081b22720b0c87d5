"""Where predictions say nothing a person is told: the policies that were tried are predicted worse than by their mean,
or the objective scores what nothing predicts."""

from __future__ import annotations

import pytest

from hts.run import testing_elites
from hts.testing.examples.objective.objective import Fake
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run


@pytest.mark.parametrize(("r2", "told"), [(-12.5, True), (0.4, False), (None, False)])
def test_it_is_told_in_a_line_and_stands_in_the_summary(run_on, tmp_path, monkeypatch, capsys, r2, told):
    real = testing_elites.check
    monkeypatch.setattr(testing_elites, "check", lambda *given: {**real(*given), "r2": r2})
    run = run_on("iterations/00/test", tmp_path / "run", {})
    shown = " ".join(capsys.readouterr().out.split())
    line = "'fake_level' of the policies that were tried is predicted worse than by its mean (R² -12.5)"
    assert (line in shown) == told
    assert run.summary["iterations"][0]["measurement_models"]["fake"]["elites_r2"] == r2


def test_once_for_an_objective_that_scores_what_nothing_predicts(tmp_path, monkeypatch, capsys):
    real = Fake.score

    def score(self, segments):
        segments.values("joint_torque")
        return real(self, segments)

    monkeypatch.setattr(Fake, "score", score)
    with kit_installed():
        run = tiny_run(tmp_path / "run", settings={"sweep.kl_bounds": [0.5, 1.0]})
    shown = " ".join(capsys.readouterr().out.split())
    line = "Objective 'fake': what candidates would save cannot be predicted. Its score reads what nothing predicts."
    assert shown.count(line) == 1 and shown.count("No channel named 'joint_torque'") == 1
    assert all(row["predicted"] == {"fake": {}} for row in run.summary["iterations"][0]["candidates"])
