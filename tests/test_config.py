"""Presets, config files, options and --set, down to one frozen configuration."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from pydantic import ValidationError

from hts.config import RunConfig
from hts.config_loading import check_names, dump_config, load_config, read_config
from hts.errors import ConfigError
from hts.layers import laid
from hts.plugins import Entry, Registry, load
from hts.presets import BASELINES, PRESETS
from hts.run.budget import candidate_counts
from hts.testing.examples.log_only_robot.plugin import make_robot
from hts.testing.examples.objective.objective import Fake
from hts.testing.examples.robot.robot import Tiny
from hts.testing.known_world import KnownWorld


def fake_config(**given) -> RunConfig:
    return load_config(**{"objectives": ["fake"], "robot": "hopper", **given})


def refusal(**given) -> str:
    with pytest.raises(ConfigError) as caught:
        fake_config(**given)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def write(folder: Path, text: str) -> Path:
    file = folder / "mine.yaml"
    file.write_text(text)
    return file


@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_is_a_whole_configuration(preset):
    config = fake_config(preset=preset)
    assert config.preset == preset
    assert config.world.name == "twin"
    assert config.selection.selector.name == "hierarchical"
    fake_config(preset=preset, baseline=True)
    assert preset in BASELINES


def test_quick_is_where_a_run_starts_from():
    assert fake_config().preset == "quick"


def test_paper_exact_has_the_numbers_of_the_paper():
    config = fake_config(preset="paper-exact")
    assert config.iterations == 4
    assert config.selection.elites == 6
    assert config.sweep.kl_bounds == (0.2, 0.5, 1.0)
    assert len(config.sweep.anchors) == 2
    assert config.world.settings["block_seconds"] == 80.0  # two blocks each: 160 s per policy
    assert config.evaluation.speeds == (0.5, 0.8, 1.1)
    assert (config.engine, config.finetune.num_envs) == ("warp", 1024)


def test_the_baseline_of_the_paper_has_as_many_samples_and_tests_as_the_method():
    method, baseline = (fake_config(preset="paper-exact", baseline=baseline) for baseline in (False, True))
    assert baseline.iterations * baseline.selection.elites == method.iterations * method.selection.elites == 24
    assert baseline.finetune.steps == method.iterations * method.finetune.steps
    assert baseline.sweep.kl_bounds == (0.1, 0.2, 0.5, 1.0, 5.0, math.inf)


@pytest.mark.parametrize("preset", ["quick", "paper"])
def test_the_baseline_is_measured_as_the_method_is_and_collects_nothing(preset):
    method, baseline = (fake_config(preset=preset, baseline=baseline) for baseline in (False, True))
    assert baseline.evaluation == method.evaluation and baseline.evaluation.hold_speed
    assert baseline.selection.speeds == method.selection.speeds
    assert method.records_first and not baseline.records_first
    assert not baseline.finetune.hold and math.inf in baseline.sweep.kl_bounds


def test_speeds_that_are_held_lie_well_inside_the_trained_commands():
    for preset in ("quick", "paper"):
        config = fake_config(preset=preset)
        low, high = config.finetune.env.commands.vx
        assert low <= 0.5 * min(config.evaluation.speeds) and high >= 1.3 * max(config.evaluation.speeds)


def test_later_sources_win(tmp_path):
    file = write(tmp_path, "seed: 5\niterations: 7\nfinetune: {num_envs: 3}\n")
    assert fake_config(file=file).seed == 5
    assert fake_config(file=file, seed=6).seed == 6
    assert fake_config(file=file, seed=6, overrides=["seed=8"]).seed == 8
    config = fake_config(preset="smoke", file=file)
    assert (config.iterations, config.finetune.num_envs) == (7, 3)
    assert config.finetune.steps == PRESETS["smoke"]["finetune"]["steps"]  # merged key by key


def test_the_preset_of_a_file_counts_unless_another_is_asked_for(tmp_path):
    file = write(tmp_path, "preset: smoke\n")
    assert fake_config(file=file).preset == "smoke"
    assert fake_config(file=file, preset="paper").preset == "paper"


def test_set_reaches_nested_settings_of_a_plugin():
    config = fake_config(overrides=["world.dynamics.trunk_mass_scale=1.08", "objectives.fake.gain=2"])
    assert config.world.settings["dynamics"] == {"trunk_mass_scale": 1.08}
    assert config.objectives == {"fake": {"gain": 2}}


def test_set_reads_lists_and_infinity_as_yaml():
    assert fake_config(overrides=["sweep.kl_bounds=[0.5, .inf]"]).sweep.kl_bounds == (0.5, math.inf)
    nobody_bounded = ["sweep.kl_bounds=[.inf]", "sweep.trust_region.enabled=true"]
    with pytest.raises(ConfigError, match=r"kl_bounds: none is finite.*such as \[16\.0, \.inf\]"):
        fake_config(overrides=nobody_bounded)
    assert fake_config(overrides=[*nobody_bounded[:1], "sweep.trust_region.enabled=false"]).sweep.kl_bounds == (
        math.inf,
    )


def test_settings_of_an_objective_come_from_the_file_and_the_choice_from_the_command_line(tmp_path):
    file = write(tmp_path, "objectives: {fake: {gain: 2}, other: {}}\n")
    assert fake_config(file=file).objectives == {"fake": {"gain": 2}}
    assert set(fake_config(file=file, objectives=[]).objectives) == {"fake", "other"}


def test_another_world_drops_the_settings_of_the_first():
    assert fake_config(world="field").world.settings == {}


def test_the_same_world_keeps_its_settings():
    assert fake_config(world="twin").world.settings["block_seconds"] == PRESETS["quick"]["world"]["block_seconds"]


def test_merging_leaves_both_sides_as_they_were():
    base, over = {"a": {"b": 1}}, {"a": {"c": 2}}
    assert laid(base, over) == {"a": {"b": 1, "c": 2}}
    assert (base, over) == ({"a": {"b": 1}}, {"a": {"c": 2}})


@pytest.mark.parametrize("preset", ["smoke", "quick", "paper"])
def test_another_preset_beside_a_file_that_says_all_of_its_own_is_refused(tmp_path, preset):
    config = fake_config(preset=preset)
    file = write(tmp_path, dump_config(config))
    assert fake_config(file=file) == fake_config(file=file, preset=preset) == config
    other = next(name for name in ("quick", "smoke") if name != preset)
    said = refusal(file=file, preset=other)
    assert said.startswith(f"--preset {other}: {file} says all that preset '{preset}' does") and "Leave" in said


def test_presets_are_not_changed_by_runs():
    before = repr(PRESETS)
    fake_config(overrides=["finetune.ppo.horizon=3", "world.dynamics.x=1"])
    assert repr(PRESETS) == before


def test_a_dumped_configuration_reads_back_equal(tmp_path):
    config = fake_config(overrides=["sweep.kl_bounds=[0.5, .inf]", "world.dynamics.trunk_mass_scale=1.08"])
    file = tmp_path / "config.yaml"
    file.write_text(dump_config(config))
    assert read_config(file) == config


def test_nothing_edits_a_configuration():
    with pytest.raises(ValidationError):
        fake_config().seed = 3


def test_a_misspelt_preset_is_answered_with_the_closest():
    assert refusal(preset="smok").startswith("No preset named 'smok'. Did you mean 'smoke'?")


def test_a_misspelt_key_of_set_is_answered_with_the_closest():
    assert refusal(overrides=["finetune.num_env=3"]).startswith(
        "--set finetune.num_env: there is no key 'num_env' in finetune. Did you mean 'num_envs'?"
    )


def test_a_misspelt_key_of_a_file_names_the_file(tmp_path):
    file = write(tmp_path, "finetune: {ppo: {clipp: 0.3}}\n")
    assert refusal(file=file).startswith(f"{file}: finetune.ppo.clipp: ")
    assert "Did you mean 'clip'?" in refusal(file=file)


def test_a_misspelt_key_inside_a_list_is_found():
    message = refusal(overrides=["collection.schedule.commands=[{seconds: 3, vx: 0.3, yawrate: 2}]"])
    assert "Did you mean 'yaw_rate'?" in message


def test_a_value_of_the_wrong_kind_is_shown():
    assert "found 'many'" in refusal(overrides=["finetune.num_envs=many"])
    assert "found -1" in refusal(overrides=["finetune.num_envs=-1"])


def test_a_key_inside_a_value_is_refused():
    assert "'iterations' is a value, it has no keys inside" in refusal(overrides=["iterations.more=1"])


def test_set_without_a_value_is_refused():
    assert "expected KEY=VALUE" in refusal(overrides=["finetune.num_envs"])


def test_set_for_an_objective_that_is_not_in_the_run_is_refused():
    assert "Did you mean 'fake'?" in refusal(overrides=["objectives.fakee.gain=2"])


def test_a_file_that_is_not_yaml_is_named_with_the_line(tmp_path):
    file = write(tmp_path, "seed: 1\na: b: c\n")
    assert refusal(file=file).startswith(f"{file}:2: not YAML")


def test_a_missing_file_is_named(tmp_path):
    assert "nowhere.yaml: cannot read this config file" in refusal(file=tmp_path / "nowhere.yaml")


def test_a_run_needs_an_objective_and_a_robot():
    assert "--objective NAME" in refusal(objectives=[])
    assert "--robot NAME" in refusal(robot=None)


class Hopper(Tiny):
    spec = replace(Tiny.spec, name="hopper")


def registry() -> Registry:
    return replace(
        load(),
        robots={"hopper": Entry("hopper", lambda settings: Hopper(), "lab")},
        objectives={"fake": Entry("fake", lambda settings: Fake(), "lab")},
        worlds={"twin": Entry("twin", lambda *given: KnownWorld(Tiny(), [], {}), "lab")},
    )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"objectives": ["fkae"]}, "No objective named 'fkae'. Did you mean 'fake'?"),
        ({"robot": "hoper"}, "No robot named 'hoper'. Did you mean 'hopper'?"),
        ({"world": "twni"}, "No world named 'twni'. Did you mean 'twin'?"),
        ({"engine": "wrap"}, "No engine named 'wrap'. Did you mean 'warp'?"),
        ({"executor": "locl"}, "No executor named 'locl'. Did you mean 'local'?"),
        ({"overrides": ["selection.selector.name=hierarchic"]}, "Did you mean 'hierarchical'?"),
        ({"overrides": ["sweep.weights={faek: [1]}"]}, "Did you mean 'fake'?"),
        ({"overrides": ["selection.selector.objective=faek"]}, "Selector 'hierarchical': No objective named 'faek'."),
        (
            {"overrides": ["selection.selector.name=racing", "selection.selector.objective=faek"]},
            "Selector 'racing': No objective named 'faek'.",
        ),
        (
            {"overrides": ["selection.selector.name=pareto", "selection.selector.weights={faek: 2}"]},
            "Selector 'pareto': weights: No objective named 'faek'.",
        ),
        (
            {"overrides": ["selection.selector.name=pareto", "selection.selector.weights={fake: 0}"]},
            "Selector 'pareto': every weight is 0",
        ),
    ],
)
def test_a_misspelt_name_is_answered_with_the_closest(given, message):
    check_names(fake_config(), registry())
    with pytest.raises(ConfigError) as caught:
        check_names(fake_config(**given), registry())
    assert message in str(caught.value)


@pytest.mark.parametrize("key", ["simulation_test.speeds", "selection.speeds", "evaluation.speeds"])
def test_a_speed_that_is_there_twice_is_refused(key):
    assert f"--set {key}: a speed is there twice" in refusal(preset="quick", overrides=[f"{key}=[0.5, 0.5]"])


def test_one_speed_of_trials_is_refused_where_the_preset_has_several(tmp_path):
    assert refusal(preset="quick", overrides=["selection.speed=0.6"]) == (
        "--set selection.speed: says 0.6, but elites are tried at selection.speeds, [0.5, 0.8, 1.1], so it would do "
        "nothing. Say --set selection.speeds=[0.6]"
    )
    mine = write(tmp_path, "selection: {speed: 0.6}\n")
    assert f"{mine}: selection.speed: says 0.6" in refusal(preset="quick", file=mine)
    both = fake_config(preset="quick", overrides=["selection.speed=0.6", "selection.speeds=[]"])
    assert both.selection.tested_speeds == (0.6,)
    resolved = write(tmp_path, dump_config(fake_config(preset="quick")))  # names both
    assert fake_config(preset="quick", file=resolved).selection.tested_speeds == (0.5, 0.8, 1.1)


def test_a_log_only_robot_is_told_what_it_is_for_and_not_what_its_task_lacks():
    logged = {"logged": Entry("logged", make_robot, "lab")}
    with pytest.raises(ConfigError) as caught:
        check_names(fake_config(robot="logged"), replace(registry(), robots=logged))
    assert str(caught.value).startswith("Robot 'logged' is log-only: it has no simulation; `hts import` and `hts fit`")
    assert "base_velocity" not in str(caught.value) and "\n" not in str(caught.value)


def test_a_file_may_name_objectives_robot_and_world_by_name_alone(tmp_path):
    file = write(tmp_path, "objectives: [fake, other]\nrobot: hopper\nworld: field\n")
    config = fake_config(file=file, objectives=[], robot=None)
    assert (set(config.objectives), config.robot.name, config.world.name) == ({"fake", "other"}, "hopper", "field")
    assert fake_config(file=file).objectives == {"fake": {}}  # the command line chooses


def test_an_unknown_key_is_said_before_a_missing_robot(tmp_path):
    file = write(tmp_path, "robbot: hopper\n")
    message = refusal(file=file, robot=None)
    assert message.startswith(f"{file}: robbot: there is no key 'robbot'. Did you mean 'robot'?")
    assert refusal(robot=None).startswith("No robot given.")


def test_all_that_is_wrong_is_said():
    message = refusal(overrides=["seed=-1", "iteration=2", "finetune.num_envs=many"])
    assert message.startswith("--set iteration: there is no key 'iteration'")
    assert "Also: --set seed: " in message and "found 'many'" in message


def test_more_than_four_faults_are_counted():
    assert refusal(overrides=[f"{key}=1" for key in ("aa", "bb", "cc", "dd", "ee", "ff")]).endswith(
        "(2 more things wrong.)"
    )


def test_set_may_name_the_objectives():
    assert list(fake_config(objectives=[], overrides=["objectives=[fake, other]"]).objectives) == ["fake", "other"]


def test_an_objective_without_settings_in_a_file_is_fine(tmp_path):
    assert fake_config(file=write(tmp_path, "objectives:\n  fake:\n")).objectives == {"fake": {}}


@pytest.mark.parametrize(
    "text", ["preset: [a]", "preset: {a: 1}", "objectives: {1: {}}", "iterations: {a: 1}", "finetune: 3"]
)
def test_values_of_another_kind_end_in_one_line(tmp_path, text):
    assert refusal(file=write(tmp_path, text + "\n"), objectives=[])


def test_an_objective_that_is_chosen_twice_is_refused():
    found = refusal(objectives=["other", "fake", "fake"])
    assert found.startswith("Objective 'fake' is named 2 times") and found.endswith("Name it once.")


def test_the_letter_of_the_paper_holds_for_what_an_objective_says_itself():
    pytest.importorskip("hts_power", reason="the objective of this test is not installed")
    exact = load_config(preset="paper-exact", objectives=["power"], robot="go1")
    assert exact.objectives["power"]["products"] is False and exact.objectives["power"]["criterion"] == "net"
    assert exact.collection.exploring == 0 and exact.sweep.kl_bounds == (0.2, 0.5, 1.0)
    assert not exact.finetune.hold and not exact.sweep.trust_region.enabled
    changed = load_config(
        preset="paper-exact", objectives=["power"], robot="go1", overrides=["objectives.power.criterion=smaller"]
    )
    assert changed.objectives["power"]["criterion"] == "smaller" and changed.objectives["power"]["products"] is False


def test_a_proxy_as_reward_keeps_the_methods_own_budget():
    method = fake_config(preset="quick")
    inside, baseline = fake_config(preset="quick", reward_source="proxy"), fake_config(preset="quick", baseline=True)
    assert inside.reward_source == baseline.reward_source == "proxy"
    assert inside.iterations == method.iterations and inside.finetune == method.finetune
    assert baseline.iterations == 1


@pytest.mark.parametrize("preset", ["quick", "paper"])
@pytest.mark.parametrize("objective", ["power", "noise"])
def test_a_proxy_as_reward_trains_as_many_candidates_as_the_method(preset, objective):
    def trained(**given) -> list[int]:
        return candidate_counts(load_config(preset=preset, objectives=[objective], robot="go1", **given), load())

    assert trained(overrides=["reward_source=proxy"]) == trained()


@pytest.mark.parametrize("text", ["", "finetunes: {}\n", "preset: [\n"])
def test_a_saved_configuration_that_was_changed_says_how_to_get_it_back(tmp_path, text):
    file = tmp_path / "config.yaml"
    file.write_text(text and text + dump_config(fake_config()))
    with pytest.raises(ConfigError, match=rf"Put {file} back as the run wrote it\.$"):
        read_config(file)
    (tmp_path / "provenance.json").write_text("{}")
    with pytest.raises(
        ConfigError, match=r"it; .*provenance.json names the version of hts that wrote it \(pack"
    ) as caught:
        read_config(file)
    assert "\n" not in str(caught.value)
