"""What `--dry-run` says before anything is spent; every number here is checked on paper."""

from __future__ import annotations

import pytest

from hts.config_loading import load_config
from hts.errors import ConfigError
from hts.evaluation.held import hold_of
from hts.evaluation.simulation import trial_steps
from hts.plugins import load
from hts.run.cost import (
    AROUND_SECONDS,
    BASE_MEMORY_GB,
    BYTES_PER_SAMPLE,
    STEPS_PER_SECOND,
    check_memory,
    estimate,
    machine_memory_gb,
)

pytest.importorskip("hts_go1", reason="the robot of these estimates is not installed")
pytest.importorskip("hts_power", reason="the objective of these estimates is not installed")

WEIGHTS = "sweep.weights.power=[0.5, 1.0, 5.0]"


def cost_of(preset: str, *overrides: str, **given):
    config = load_config(preset=preset, objectives=["power"], robot="go1", overrides=[WEIGHTS, *overrides], **given)
    return estimate(config, load())


def test_a_smoke_run_costs_what_its_configuration_says():
    cost = cost_of("smoke")
    assert cost["candidates"] == 1 * 3 * 2
    assert cost["tested on the robot"] == 2
    # 3 recordings of 12 s, then 2 tests and one final head-to-head of 1 s + 4 x 6 s each
    assert cost["robot_minutes"] == pytest.approx((3 * 12 + 3 * 25) / 60)
    # 6 candidates of 400 steps; 6 candidates and the pretrained policy in 4 worlds for 4 s at 50 Hz; at the gate the
    # two that are tested, for 3 s
    assert cost["simulation_steps"] == 6 * 400 + 7 * 4 * 200 + 2 * 4 * 150
    assert cost_of("smoke", "gate.enabled=false")["simulation_steps"] == 6 * 400 + 7 * 4 * 200
    # 6 candidates x 8 worlds x 24 steps in a batch
    assert cost["memory_gb"] == pytest.approx(BASE_MEMORY_GB + 6 * 8 * 24 * BYTES_PER_SAMPLE / 1e9)
    assert cost["wall_minutes"] >= (AROUND_SECONDS + cost["simulation_steps"] / STEPS_PER_SECOND["mujoco"]) / 60


def test_what_pulls_at_the_machine_is_looked_at_in_simulation_before_each_later_iteration():
    alone = cost_of("quick", "simulation_test.measured_pull=false", "finetune.measured_pull=false")
    more = cost_of("quick")["simulation_steps"] - alone["simulation_steps"]
    test = load_config(objectives=["power"], robot="go1", preset="quick").simulation_test
    assert more == 2 * test.num_envs * 3 * trial_steps(test, 50.0)


def test_a_run_beside_a_robot_says_how_many_visits_it_asks_for(capsys):
    from hts.run.cost import print_estimate

    assert cost_of("smoke")["beside"] is None  # nobody is needed
    plain = cost_of("smoke", world="field")  # first data, a trial, a final
    assert plain["beside"].startswith("Beside the robot: 3 deploy bundles, a visit each, where nobody is refused; 2 of")
    assert "begin with 10 minutes of warming up, 20 in all." in plain["beside"]
    baseline = cost_of("smoke", world="field", baseline=True)  # collects nothing
    assert "2 deploy bundles" in baseline["beside"] and "; 2 of them compare" in baseline["beside"]
    # first data, trials of three iterations, second trials, a final at held speed and one at equal commands
    once = ("selection.trims_again=0", "evaluation.trims_again=0", "evaluation.finals=1")
    held = cost_of("quick", *once, world="field")
    assert "7 deploy bundles" in held["beside"] and "; 6 of them compare" in held["beside"]
    assert "60 in all" in held["beside"]
    assert "6 deploy bundles" in cost_of("quick", *once, "selection.confirm=0", world="field")["beside"]
    print_estimate(held)
    assert capsys.readouterr().out.count("Beside the robot: 7 deploy bundles") == 1


def test_visits_that_settings_allow_on_top_are_counted_and_named():
    said = cost_of("quick", world="field")["beside"]
    # 6 + 2 trials may be walked again once, the final four times, and two more finals are two bundles and four each
    assert said.startswith("Beside the robot: 7 to 31 deploy bundles, a visit each; 6 to 30 of them compare")
    assert "10 minutes of warming up, 60 to 300 in all." in said
    for words in (
        "More than 7: up to 8 for trials that did not find their commands (selection.trims_again), ",
        "up to 4 for a final that did not find its commands (evaluation.trims_again), ",
        "up to 12 for finals of the next best where one is given up (evaluation.finals). ",
    ):
        assert words in said
    assert "to" not in cost_of("smoke", "evaluation.finals=1", world="field")["beside"].split(";")[0]


def test_the_best_so_far_is_measured_at_most_once_an_iteration_and_the_last_of_them_goes_to_the_final():
    each = ("iterations=3", "evaluation.each_iteration=true")
    cost = cost_of("smoke", *each, world="field")
    # first data, three trials, a final; the logs of the last best serve in the final too, where nobody is confirmed
    assert cost["beside"].startswith("Beside the robot: 5 to 7 deploy bundles")
    assert "up to 2 for the best so far after each iteration (evaluation.each_iteration). " in cost["beside"]
    assert cost["robot_minutes_most"] - cost["robot_minutes"] == pytest.approx(2 * 320 / 60)
    confirmed = cost_of("smoke", *each, "selection.confirm=2", "selection.speeds=[0.5, 0.8]", world="field")
    assert confirmed["beside"].startswith("Beside the robot: 6 to 9 deploy bundles")


def test_the_time_of_what_is_walked_again_is_said_as_a_range(capsys):
    from hts.run.cost import print_estimate

    held = ("evaluation.hold_speed=true", "evaluation.trims_again=3", "selection.trims_again=1")
    cost = cost_of("smoke", *held, world="field")
    # 3 recordings of 12 s; 2 trials and a final trim 12 s each of both and walk 320 s; the final at equal commands
    least = 3 * 12 + 3 * (2 * 12 + 320) + 320
    # again: both trials, trimmed for 24 s; the final, for 24, 48 and 48 s
    most = least + 2 * (2 * 24 + 320) + (2 * (24 + 48 + 48) + 3 * 320)
    assert cost["robot_minutes"] == pytest.approx(least / 60)
    assert cost["robot_minutes_most"] == pytest.approx(most / 60)
    # the next finals would be that of the other trial: once, at equal commands, and three times again
    again = cost_of("smoke", *held, "evaluation.finals=5", world="field")
    final = (2 * 12 + 320) + 320 + (2 * (24 + 48 + 48) + 3 * 320)
    assert again["robot_minutes_most"] == pytest.approx((most + final) / 60)
    print_estimate(cost)
    assert f"{least / 60:.1f} to {most / 60:.1f}" in capsys.readouterr().out


def test_a_cap_holds_for_what_is_walked_again_too():
    cost = cost_of("quick", "max_real_samples=96000", world="field")
    assert cost["real_samples"] <= cost["real_samples_most"] == 96_000
    assert "up to 1 for second trials, if the cap leaves room for them (selection.confirm)" in cost["beside"]
    # four trials and second ones of the best two
    assert cost["tested on the robot"] == 4 and "up to 6 for trials that did not find their commands" in cost["beside"]


def test_second_trials_are_walked_at_least_and_at_most():
    cost = cost_of("smoke", "selection.confirm=2", "selection.speeds=[0.5, 0.8]", "evaluation.finals=1", world="field")
    # 3 recordings of 12 s, two trials and two second ones of 320 s at each of two speeds, a final at one
    assert cost["robot_minutes"] == cost["robot_minutes_most"] == pytest.approx((36 + 4 * 640 + 320) / 60)


def test_the_best_so_far_of_each_iteration_may_be_walked_again_too():
    held = ("evaluation.hold_speed=true", "evaluation.trims_again=1", "selection.trims_again=0", "evaluation.finals=1")
    cost = cost_of("smoke", "iterations=3", "evaluation.each_iteration=true", *held, world="field")
    # 6 trials and a final trim 12 s each of both and walk 320 s; the final at equal commands
    least = 36 + 7 * 344 + 320
    # again, trimmed for 24 s each: the final; and the best of two iterations, measured once and again
    assert cost["robot_minutes"] == pytest.approx(least / 60)
    assert cost["robot_minutes_most"] == pytest.approx((least + 368 + 2 * (344 + 368)) / 60)


@pytest.mark.parametrize("hold", [False, True], ids=["not held", "held"])
def test_a_round_is_warmed_up_for_once_whoever_walks_in_it(hold):
    from hts.worlds.twin.programme import session_seconds

    held = f"evaluation.hold_speed={str(hold).lower()}"
    race = ("selection.selector.name=racing", "world.warmup_seconds=20", held)
    config = load_config(preset="smoke", objectives=["power"], robot="go1", overrides=[WEIGHTS, *race])
    trimmed = hold_of(config)
    final = sum(session_seconds(1, 1, 20, 6, one) for one in ({None, trimmed} if hold else {None}))
    cost = estimate(config, load())
    longest = 3 if hold else 0  # s: the reference's trimming that the warm-up is too short for, at most
    walked = 60 * cost["robot_minutes"] - 3 * 12 - final
    assert 0 <= walked - session_seconds(2, 1, 20, 15, trimmed) <= longest + 1e-6


def test_a_race_is_a_visit_a_round():
    cost = cost_of("smoke", "selection.selector.name=racing", world="field")
    # first data, one to four rounds, a final; a round of two is six blocks of 15 s
    assert cost["beside"].startswith("Beside the robot: 3 to 6 deploy bundles")
    assert "up to 3 for the rounds of selector 'racing'" in cost["beside"]
    assert cost["robot_minutes"] == pytest.approx((3 * 12 + 90 + 320) / 60)
    assert cost["robot_minutes_most"] == pytest.approx((3 * 12 + 4 * 90 + 320) / 60)
    assert cost["real_samples"] == (3 * 12 + 90) * 50


def test_a_final_is_made_once_in_a_world_that_makes_no_sessions():
    cost = cost_of("smoke", "evaluation.sessions=4", world="field")
    assert cost["robot_minutes"] == pytest.approx((3 * 12 + 3 * 320) / 60)
    assert cost_of("smoke", "evaluation.sessions=4")["robot_minutes"] == pytest.approx((3 * 12 + (2 + 4) * 25) / 60)


def test_the_papers_run_trains_63_candidates_and_tests_24():
    cost = cost_of("paper-exact")
    assert cost["candidates"] == 9 + 3 * 18  # the first iteration has one anchor
    assert cost["tested on the robot"] == 4 * 6
    recorded = 5 * 32  # s, once
    tested = (24 + 3) * (20 + 4 * 80)  # s: 24 elites and three final speeds, 20 s of warming up before four blocks
    assert cost["robot_minutes"] == pytest.approx((recorded + tested) / 60)


def test_fewer_candidates_than_elites_are_all_that_is_tested():
    assert cost_of("smoke", "selection.elites=50")["tested on the robot"] == 6


def test_the_baseline_collects_nothing():
    cost = cost_of("smoke", baseline=True)
    assert cost["candidates"] == 3  # one bound
    assert cost["robot_minutes"] == pytest.approx((2 + 1) * 25 / 60)


def test_a_world_that_does_not_say_how_long_a_test_takes_counts_as_the_papers():
    cost = cost_of("smoke", world="field")
    assert cost["robot_minutes"] == pytest.approx((3 * 12 + 3 * 320) / 60)
    assert cost["real_samples"] == 50 * 36 + 2 * 16_160  # a hundredth on top of each test's 320 s: 323.2 s


def test_charges_are_minutes_of_walking_by_the_robots_endurance():
    cost = cost_of("smoke")  # 111 s of walking; a charge lasts an hour
    assert cost["charges"] == pytest.approx(111 / 3600)


def test_the_time_is_that_of_the_measured_speed():
    config = load_config(preset="paper", objectives=["power"], robot="go1", overrides=[WEIGHTS], engine="mujoco")
    slow, fast = (estimate(config, load(), steps_per_second=rate) for rate in (1000.0, 2000.0))
    saved = slow["simulation_steps"] / 1000.0 / 2 / 60  # min
    assert slow["wall_minutes"] - fast["wall_minutes"] == pytest.approx(saved)
    assert "1,000 a second, measured here" in slow["speed"]
    assert "not measured here" in estimate(config, load())["speed"]


def test_a_dry_run_measures_builds_everything_and_writes_nothing(hts_here, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "run"
    options = ("--objective", "power", "--robot", "go1", "--preset", "smoke", "--out", out, "--dry-run")
    done = hts_here("run", *options)
    assert done.returncode == 0, done.stderr
    for words in (
        *("candidates trained", "minutes of walking", "simulation steps  ", "minutes in all", "GB of memory"),
        *("a second, measured here", "all of it works"),
    ):
        assert words in done.stdout
    assert not list(tmp_path.iterdir())


def test_a_dry_run_with_a_wrong_name_ends_in_one_line(hts):
    done = hts("run", "--objective", "powr", "--robot", "go1", "--dry-run")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1 and "Did you mean 'power'?" in done.stderr


def test_holding_the_speed_costs_its_trimming_and_a_second_final():
    held = "evaluation.hold_speed=true"
    cost = cost_of("smoke", held)
    # a warm-up of 1 s becomes 0.5 s and 12 s in which the reference trims; the policy trims 12 s; four blocks of 6 s
    assert cost["robot_minutes"] == pytest.approx((3 * 12 + 3 * (12.5 + 12 + 24) + 25) / 60)
    steps = cost_of("smoke", held, "simulation_test.hold_speed=true")["simulation_steps"]
    assert steps - cost["simulation_steps"] == 7 * 4 * 10 * 50  # 10 s more of each instance


def test_selection_at_several_speeds_warms_up_once_for_all_of_them():
    cost = cost_of("smoke", "selection.speeds=[0.5, 0.8, 1.1]", "selection.block_seconds=5")
    assert cost["robot_minutes"] == pytest.approx((3 * 12 + 2 * (1 + 3 * 4 * 5) + 25) / 60)


def test_paper_stays_within_the_samples_of_the_paper():
    """384,000 of them, warm-up, trimming and reference counted, the final apart."""
    whole, final = cost_of("paper"), cost_of("paper", "iterations=1", "selection.elites=1", "collection.exploring=0")
    elite = 20 + 3 * (2 * 20 + 4 * 20)  # s, at least: warm up once, then trim both and walk four blocks at each speed
    final_minutes = final["robot_minutes"] - (2 * 5 * 32 + elite) / 60
    assert (whole["robot_minutes"] - final_minutes) * 60 * 50 < 384_000


def test_only_what_lies_in_this_machines_memory_counts_against_it():
    batch = 6 * 8 * 24 * BYTES_PER_SAMPLE / 1e9
    assert cost_of("smoke", engine="mujoco")["host_memory_gb"] == pytest.approx(BASE_MEMORY_GB + batch)
    assert cost_of("smoke", engine="warp")["host_memory_gb"] == BASE_MEMORY_GB
    on_cpu = cost_of("smoke", "finetune.env.device=cpu", engine="warp")
    assert on_cpu["host_memory_gb"] == pytest.approx(BASE_MEMORY_GB + batch)


def test_a_run_that_needs_more_memory_than_there_is_says_so(monkeypatch):
    cost = cost_of("smoke", "finetune.num_envs=1000000")
    monkeypatch.setattr("hts.run.cost.machine_memory_gb", lambda: 16.0)
    with pytest.raises(ConfigError, match=r"needs about 347 GB of memory, this machine has 16.0.*finetune.num_envs=N"):
        check_memory(cost)
    check_memory(cost_of("smoke"))
    monkeypatch.setattr("hts.run.cost.machine_memory_gb", lambda: None)  # nobody says
    check_memory(cost)


def test_a_container_may_have_less_than_the_machine(monkeypatch, tmp_path):
    whole = machine_memory_gb()
    assert whole is not None and whole > 0.1
    limit = tmp_path / "memory.max"
    monkeypatch.setattr("hts.run.cost.CONTAINER_LIMITS", (tmp_path / "nowhere", limit))
    limit.write_text("500000000\n")
    assert machine_memory_gb() == 0.5
    limit.write_text("max\n")
    assert machine_memory_gb() >= whole


def test_a_dry_run_that_cannot_fit_is_one_line(hts_here, tmp_path):
    options = ("--objective", "power", "--robot", "go1", "--preset", "smoke", "--out", tmp_path / "run", "--dry-run")
    done = hts_here("run", *options, "--set", "finetune.num_envs=100000000000")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1 and "GB of memory, this machine has" in done.stderr
