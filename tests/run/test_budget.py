"""A cap on real samples: what is planned, what is refused, and a run that keeps to it and says so."""

from __future__ import annotations

import json
import re
from types import SimpleNamespace

import pytest

from hts.cli.main import main
from hts.config import ScheduleConfig
from hts.config_loading import load_config
from hts.errors import ConfigError, RunError
from hts.evaluation.held import hold_of
from hts.plugins import load
from hts.run.algorithm import cap_reached, goes_on
from hts.run.budget import Budget, shortened, spread
from hts.run.cost import estimate
from hts.schedules import Command
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run

SCHEDULE = ScheduleConfig(commands=(Command(seconds=12.0, vx=0.5), Command(seconds=8.0, vx=0.8)))


@pytest.mark.parametrize(
    ("tests", "wanted", "found"),
    [
        (4, [2, 2], [2, 2]),
        (3, [2, 2], [2, 1]),  # the earlier one first
        (3, [2, 2, 2, 2], [1, 1, 1]),  # more iterations before more elites
        (1, [3, 3], [1]),
        (9, [2, 2], [2, 2]),
        (0, [2], []),
    ],
)
def test_tests_are_spread_over_iterations(tests, wanted, found):
    assert spread(tests, wanted) == found


def test_a_schedule_is_shortened_by_one_share_in_whole_control_steps():
    found = shortened(SCHEDULE, 15.0, 50.0)
    assert [command.seconds for command in found.commands] == [9.0, 6.0]
    assert [command.vx for command in found.commands] == [0.5, 0.8]
    with pytest.raises(ConfigError, match=r"leaves 3.6 s for each 12 s"):
        shortened(SCHEDULE, 6.0, 50.0)


def test_what_was_really_spent_counts_and_not_what_was_planned():
    budget = Budget(SCHEDULE, (2, 2), first=1000, each=400, most=2600, wanted=(2, 2))
    assert budget.samples == 2600
    assert budget.affordable([2], spent=1800) == 2
    assert budget.affordable([2], spent=1801) == 1  # a sample too many before
    assert budget.affordable([2], spent=2300) == 0
    assert Budget(SCHEDULE, (2, 2), 1000, 400, None, (2, 2)).affordable([2], spent=10**9) == 2


@pytest.mark.parametrize(
    ("wanted", "tried", "may"),
    [
        ((2, 2, 2), [], 2),
        ((2, 2, 2), [2], 1),  # as planned
        ((2, 2, 2), [2, 1, 1], 0),  # no more of them
        ((2, 2, 2), [1], 2),  # three tests over two iterations, the earlier one first
        ((2, 2, 2), [0, 0], 2),  # never more than an iteration wants
        ((9, 9, 9, 9, 9), [0], 1),  # four over four
        ((9, 9, 9, 9, 9), [1, 0, 1, 0], 2),
        ((9, 9, 9, 9, 9), [1, 1, 1, 1], 0),
    ],
)
def test_tests_that_were_not_used_are_planned_again_for_the_iterations_that_are_left(wanted, tried, may):
    plan = Budget(SCHEDULE, tuple(spread(4, wanted)), first=1000, each=400, most=2600, wanted=wanted)
    assert plan.affordable(tried, spent=1000 + 400 * sum(tried)) == may


def test_where_every_test_is_used_the_plan_stays():
    for wanted in ([2, 2], [6, 6, 6, 6], [1, 6, 3], [3, 1, 1, 2]):
        for tests in range(1, sum(wanted) + 1):
            plan = tuple(spread(tests, wanted))
            budget = Budget(SCHEDULE, plan, first=0, each=1, most=tests, wanted=tuple(wanted))
            found = [budget.affordable(plan[:done], sum(plan[:done])) for done in range(len(wanted))]
            assert found == [*plan, *[0] * (len(wanted) - len(plan))]


# ------------------------------------------------------------------------------------------ presets, by estimate


def planned(preset: str, *overrides: str):
    pytest.importorskip("hts_go1", reason="the robot of these estimates is not installed")
    pytest.importorskip("hts_power", reason="the objective of these estimates is not installed")
    return estimate(load_config(preset=preset, objectives=["power"], robot="go1", overrides=overrides), load())


def test_paper_stays_within_the_papers_real_samples():
    assert planned("paper")["real_samples"] <= planned("paper")["real_samples_most"] <= 384_000


def test_the_cap_of_paper_is_the_methods_alone():
    """The baseline and runs of several objectives try other numbers of candidates."""

    def cap(*objectives: str, **given) -> int | None:
        return load_config(preset="paper", objectives=objectives, robot="go1", **given).max_real_samples

    assert cap("power") == cap("noise") == cap("power", overrides=["reward_source=proxy"]) == 384_000
    assert cap("power", baseline=True) is cap("power", "noise") is cap("power", "noise", baseline=True) is None


@pytest.mark.parametrize("preset", ["quick", "paper"])
@pytest.mark.parametrize("most", [96_000, 60_000])
def test_a_cap_holds_by_estimate_and_is_used(preset, most):
    found = planned(preset, f"max_real_samples={most}")
    assert 0.8 * most < found["real_samples"] <= most


@pytest.mark.parametrize("trim", [8, 12, 60])
def test_a_test_is_counted_with_standing_up_however_short_it_is(trim):
    from hts.worlds.twin.programme import STANDING_SECONDS, session_seconds

    held = ("evaluation.hold_speed=true", f"evaluation.trim_seconds={trim}", "selection.elites=1", "gate.enabled=false")
    config = load_config(preset="smoke", objectives=["power"], robot="go1", overrides=held)
    walked = 50 * (session_seconds(1, 1, 1, 6, hold_of(config)) + STANDING_SECONDS)
    first = 50 * 3 * 12
    assert walked <= estimate(config, load())["real_samples"] - first <= 1.02 * walked


def test_a_cap_that_is_not_reached_changes_nothing():
    """But for what is walked again, which has to fit, too."""
    capped, free = planned("paper"), planned("paper", "max_real_samples=null")
    assert {key for key in free if capped[key] != free[key]} <= {key for key in free if key.endswith("_most")}
    assert capped["real_samples_most"] == 384_000 < free["real_samples_most"]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["max_real_samples=20000"], r"max_real_samples=20000: half of the first data are 12000 .* Expected \d+"),
        (["max_real_samples=96000", "selection.selector.name=racing"], r"selector 'racing' tests in rounds"),
        (["max_real_samples=0"], r"max_real_samples"),
    ],
)
def test_a_cap_that_nothing_fits_in_is_one_line(settings, said):
    with pytest.raises(ConfigError, match=said):
        planned("quick", *settings)


# ------------------------------------------------------------------------------------------ a whole run

CAPPED = {
    "iterations": 3,
    "selection.elites": 2,
    "sweep.kl_bounds": [0.5, 1.0],
    "evaluation.each_iteration": True,
    "world.block_seconds": 6.0,
    "collection.schedule": {"commands": [{"seconds": 6.0, "vx": 0.5}, {"seconds": 6.0, "vx": 0.8}]},
    # 200 less than two first recordings of 12 s at 50 Hz, and 1.01 x 4 x 80 s for each of two elites: what a world
    # that says nothing of its own counts with
    "max_real_samples": 1000 + 2 * 16_160,
}


@pytest.fixture(scope="module")
def capped(tmp_path_factory):
    with kit_installed():
        yield tiny_run(tmp_path_factory.mktemp("capped") / "run", settings=CAPPED)


class FewOfAJob:
    """What `cap_reached` asks of a job."""

    config = SimpleNamespace(iterations=3, max_real_samples=2000)
    budget = Budget(SCHEDULE, (1, 1), first=1000, each=400, most=2000, wanted=(1, 1))

    def __init__(self, spent: int) -> None:
        self.spent = lambda iteration: spent


@pytest.mark.parametrize(
    ("spent", "said"),
    [
        (1601, "1,601 of at most 2,000 real samples are spent, and the test of another elite takes about 400."),
        (1600, "1,600 of at most 2,000 .* less than was planned for 2 tests of elites, and the plan has no more"),
    ],
)
def test_the_line_at_the_end_of_the_iterations_says_why(spent, said):
    assert re.search(said, cap_reached(FewOfAJob(spent), 2))


def test_what_an_earlier_version_ended_is_not_begun_again(tmp_path):
    """It planned no test again, so that there may be some left."""
    path, config = tmp_path / "iterations.json", SimpleNamespace(iterations=3)
    job = SimpleNamespace(folder=tmp_path, config=config, elites=lambda iteration: 1)
    path.write_text('{"done": 1, "of": 3}')
    (tmp_path / "final.json").write_text("{}")
    assert goes_on(job, 0) and not goes_on(job, 1)
    (tmp_path / "final.json").unlink()  # stopped before it went on to the final: so it has another iteration
    assert goes_on(job, 1) and not path.exists()
    path.write_text('{"done": "1"}')
    with pytest.raises(RunError, match=r"iterations.json: damaged \(done: expected a whole number"):
        goes_on(job, 1)


def test_a_run_ends_its_iterations_where_the_next_would_pass_the_cap(capped):
    summary = capped.summary
    assert [len([one for one in row["candidates"] if one["elite"]]) for row in summary["iterations"]] == [1, 1]
    assert summary["iterations_asked"] == 3 and summary["max_real_samples"] == CAPPED["max_real_samples"]
    assert json.loads((capped.folder / "iterations.json").read_text()) == {"done": len(summary["iterations"]), "of": 3}
    final = json.loads((capped.folder / "final.json").read_text())["samples"]
    assert summary["real_samples_before_final"] == summary["real_samples"] - final <= CAPPED["max_real_samples"]
    assert not (capped.folder / "iterations/02").exists()
    assert (capped.folder / "report.html").exists()


def test_the_best_so_far_is_measured_after_each_iteration_and_not_counted(capped):
    rows = [row["measured_best"] for row in capped.summary["iterations"]]
    assert all(row["policy"] != "pretrained" for row in rows)
    assert rows[0]["objectives"]["fake"]["speeds"]["0.8"]["improvement"] == pytest.approx(0.2, abs=0.01)
    assert rows[0]["uncounted"] == 4 * 6 * 50
    if rows[1]["policy"] == rows[0]["policy"]:
        assert rows[1]["uncounted"] == 0  # it was measured already
    tests = [json.loads((capped.folder / f"iterations/{i:02d}/test.json").read_text())["samples"] for i in (0, 1)]
    collected = json.loads((capped.folder / "collect.json").read_text())["samples"]
    assert capped.summary["real_samples_before_final"] == collected + sum(tests)


def test_a_capped_run_that_is_resumed_stops_at_the_same_place(capped):
    before = (capped.folder / "summary.json").read_text()
    for name in ("final.json", "summary.json", "report.html"):
        (capped.folder / name).unlink()
    assert main(["resume", str(capped.folder)]) == 0
    assert json.loads((capped.folder / "summary.json").read_text())["iterations"] == json.loads(before)["iterations"]


def test_first_data_are_recorded_by_the_shortened_schedule(capped):
    assert json.loads((capped.folder / "collect.json").read_text())["samples"] == 1000
