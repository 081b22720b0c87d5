"""Each ablation is ours without one thing: its settings differ there alone, and there the thing is off."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from batch.methods import METHODS, jobs_of

from hts.config import RunConfig
from hts.config_loading import load_config
from hts.errors import ConfigError
from hts.evaluation.held import hold_of
from hts.parts import make_model
from hts.plugins import load
from hts.run.trust_region import Tried, next_scale, scaled

pytest.importorskip("hts_go1", reason="the robot of these configurations is not installed")
pytest.importorskip("hts_power", reason="the objective of these configurations is not installed")

SETTINGS = {
    "ours-proxy": {"reward_source"},
    "lstm": {"objectives.power.model"},
    "no-products": {"objectives.power.model"},
    "linear": {"objectives.power.model"},
    "late-reward": {"objectives.power.model"},
    "no-doubt": {"objectives.power.model"},
    "no-hold": {"finetune.hold"},
    "no-hold-below": {"finetune.hold_below"},
    "fixed-bounds": {"sweep.trust_region.enabled"},
    "no-exploring": {"collection.exploring", "collection.repeats"},
    "no-held-speed": {"evaluation.hold_speed"},
    "last-moment": {"finetune.also_at"},
    "no-average": {"finetune.average"},
    "prices-anew": {"finetune.hold_from_anchor"},
    "no-margin": {"selection.min_valid"},
    "no-pull": {"simulation_test.measured_pull", "finetune.measured_pull"},
    "no-second-trial": {"selection.confirm"},
    "no-second-try": {"selection.trims_again"},
    "no-stops": {
        "finetune.env.reward_weights.joint_range",
        "finetune.env.reward_weights.termination",
        "finetune.env.soft_joint_range",
        "finetune.env.randomisation.added_mass",
        "finetune.env.randomisation.delay_share",
        "gate.strict",
        "gate.nearer",
    },
    "one-speed": {"selection.speeds"},
    "racing": {  # another selector, which has no such settings
        "selection.selector.name",
        "selection.selector.each_bound",
        "selection.selector.at_random",
    },
}
"""What each may change, and nothing else."""


def config_of(name: str, preset: str = "quick", objective: str = "power") -> RunConfig:
    (job,) = jobs_of(
        {name: METHODS[name]}, ["default"], [0], objectives=[objective], robot="go1", preset=preset, commit="c"
    )
    given = list(job.arguments)
    sets = [value for option, value in pairwise(given) if option == "--set"]
    return load_config(preset=preset, objectives=[objective], robot="go1", world="twin", overrides=sets)


def flat(value: Any, prefix: str = "") -> dict[str, Any]:
    """Dotted key -> value; what an objective says of its model is one value."""
    if isinstance(value, dict) and not prefix.endswith(".model."):
        return {key: one for name, inner in value.items() for key, one in flat(inner, f"{prefix}{name}.").items()}
    return {prefix[:-1]: value}


def differing(name: str, preset: str) -> set[str]:
    ours, other = (flat(config_of(one, preset).model_dump(mode="json")) for one in ("ours", name))
    return {key for key in {*ours, *other} if ours.get(key) != other.get(key)}


def model_of(name: str, objective: str = "power"):
    registry, config = load(), config_of(name, objective=objective)
    made = registry.make_objective(objective, config.objectives[objective])
    return make_model(registry, made, config.objectives[objective], registry.make_robot("go1"))


@pytest.mark.parametrize("preset", ["quick", "paper"])
@pytest.mark.parametrize("name", sorted(SETTINGS))
def test_an_ablation_changes_its_own_settings_and_no_others(name, preset):
    found = differing(name, preset)
    assert found and found <= SETTINGS[name]


def test_every_method_that_is_ours_without_one_thing_is_watched_here():
    whole = {"ours", "baseline", "paper-exact", "oracle", "oracle-reward"}
    assert {name for name in METHODS if name not in whole} == set(SETTINGS)


def test_models_are_what_their_names_say():
    assert [model_of(name).name for name in ("ours", "lstm", "linear")] == ["drive_train", "battery_current", "linear"]
    assert model_of("lstm").settings["products"] is True
    assert model_of("no-products").settings["products"] is False
    assert model_of("no-products", "noise").settings["products"] is False
    assert model_of("ours", "noise").settings["products"] is True


def test_without_doubt_the_reward_is_that_of_the_mean_and_nothing_else_is_changed():
    ours, other = model_of("ours"), model_of("no-doubt")
    assert ours.pessimism > 0 and other.pessimism == 0
    assert {**ours.settings, "beta": 0.0} == other.settings


def test_a_late_reward_looks_at_what_the_gauge_shows():
    ours, other = model_of("ours"), model_of("late-reward")
    assert ours.settles and not other.settles
    assert ours.pessimism == other.pessimism


def test_speed_is_a_constraint_in_training_unless_it_is_taken_out():
    assert config_of("ours").finetune.hold and not config_of("no-hold").finetune.hold
    assert hold_of(config_of("no-hold")) is not None  # in reality it is held all the same


def test_bounds_stay_where_they_do_not_move():
    kept = Tried("a", predicted=0.2, measured=0.25, half_width=0.001, kl=2.9, kl_bound=3.0, fell=False)
    for name, moved in (("ours", True), ("fixed-bounds", False)):
        region = config_of(name).sweep.trust_region
        scale, _ = next_scale(1.0, [kept, replace(kept, id="b")], region, (3.0, 10.0))
        assert (scaled((3.0, 10.0), scale, region) != (3.0, 10.0)) is moved


def test_without_exploring_there_are_as_many_recordings_and_all_are_of_the_mean_action():
    ours, other = config_of("ours").collection, config_of("no-exploring").collection
    assert other.exploring == 0 and ours.exploring > 0
    assert other.repeats == ours.repeats + ours.exploring


def test_speed_is_not_held_where_it_is_not_to_be():
    assert hold_of(config_of("ours")) is not None and hold_of(config_of("no-held-speed")) is None
    assert config_of("one-speed").selection.tested_speeds == (0.8,)
    assert config_of("one-speed").evaluation.speeds == config_of("ours").evaluation.speeds


def test_rounds_and_a_proxy_are_there():
    registry = load()
    for name, rounds in (("ours", False), ("racing", True)):
        selector = config_of(name).selection.selector
        assert (registry.make_selector(selector.name, selector.settings).rounds() is not None) is rounds
    assert config_of("ours-proxy").reward_source == "proxy"


def test_what_belongs_to_one_objective_is_refused_with_another():
    pytest.importorskip("hts_noise", reason="the other objective is not installed")
    with pytest.raises(ConfigError, match=r"Method 'no-doubt' changes what belongs to power; with objective 'noise'"):
        config_of("no-doubt", objective="noise")


@pytest.mark.parametrize("name", ["ours", "ours-proxy", "baseline", "paper-exact"])
@pytest.mark.parametrize("preset", ["quick", "paper"])
def test_noise_has_the_methods_that_are_compared(name, preset):
    pytest.importorskip("hts_noise", reason="its objective is not installed")
    (job,) = jobs_of(
        {name: METHODS[name]}, ["dev-03"], [0], objectives=["noise"], robot="go1", preset=preset, commit="c"
    )
    assert "noise" in job.arguments and not any("objectives.power" in text for text in job.arguments)
