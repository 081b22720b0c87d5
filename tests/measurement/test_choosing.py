"""Which measurement model an objective uses: its own choice, or what the configuration says."""

from __future__ import annotations

import pytest

from hts.config import Named
from hts.config_loading import check_names, dump_config, load_config, read_config
from hts.contracts import chosen_model
from hts.errors import ConfigError
from hts.plugins import load
from hts.testing.known_signals import KnownHeat
from hts.testing.packages import kit_installed

OWN = {"hidden": 16, "products": True, "stream": 250, "batch": 4}


@pytest.mark.parametrize(
    ("settings", "name", "found"),
    [
        ({}, "lstm", OWN),
        ({"model": None}, "lstm", OWN),
        ({"model": "linear"}, "linear", {}),
        ({"model": "lstm"}, "lstm", OWN),
        ({"model": {"hidden": 8}}, "lstm", {**OWN, "hidden": 8}),
        ({"model": {"name": "lstm", "hidden": 8}}, "lstm", {**OWN, "hidden": 8}),
        ({"model": {"name": "ensemble", "members": 3}}, "ensemble", {"members": 3}),
    ],
)
def test_a_name_chooses_and_settings_alone_change_the_objectives_own(settings, name, found):
    choice = chosen_model(KnownHeat(), settings)
    assert (choice.name, choice.settings) == (name, found)


@pytest.mark.parametrize("given", [3, ["lstm"], {"name": 3}, "", {"name": ""}])
def test_what_is_no_choice_is_one_line(given):
    with pytest.raises(ConfigError, match="objectives.cool.model: expected the name of a measurement model"):
        chosen_model(KnownHeat(), {"model": given})


def test_an_objective_that_says_nothing_uses_the_lstm():
    from hts.testing.made_up_recordings import CostObjective

    assert CostObjective().measurement_model() == Named(name="lstm")


# ------------------------------------------------------------------------------------------- the configuration


def config(tmp_path, *overrides: str, text: str = ""):
    file = tmp_path / "config.yaml"
    file.write_text(text)
    return load_config(preset="smoke", file=file, objectives=["fake"], robot="tiny", world="known", overrides=overrides)


ENSEMBLE = {"name": "ensemble", "members": 3}


@pytest.mark.parametrize(
    ("overrides", "text", "model"),
    [
        (["objectives.fake.model=ensemble"], "", {"name": "ensemble"}),
        (["objectives.fake.model.name=ensemble"], "", {"name": "ensemble"}),
        (["objectives.fake.model=ensemble", "objectives.fake.model.members=3"], "", ENSEMBLE),
        (["objectives.fake.model.members=3", "objectives.fake.model.name=ensemble"], "", ENSEMBLE),
        ([], "objectives: {fake: {model: ensemble}}", {"name": "ensemble"}),
        ([], "objectives: {fake: {model: {name: ensemble, members: 3}}}", ENSEMBLE),
        (["objectives.fake.model.members=3"], "objectives: {fake: {model: ensemble}}", ENSEMBLE),
        (
            ["objectives.fake.model=linear"],
            "objectives: {fake: {model: {name: ensemble, members: 3}}}",
            {"name": "linear"},
        ),
    ],
)
def test_a_model_is_chosen_by_an_option_and_in_a_file(tmp_path, overrides, text, model):
    found = config(tmp_path, *overrides, text=text)
    assert found.objectives["fake"]["model"] == model
    saved = tmp_path / "resolved.yaml"
    saved.write_text(dump_config(found))
    assert read_config(saved) == found


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("objectives.fake.model=ensmble", "No measurement model named 'ensmble'. Did you mean 'ensemble'"),
        ("objectives.fake.model.hiden=3", "measurement model 'lstm' .from hard-to-sim.: .*Did you mean 'hidden'"),
        ("objectives.fake.model={name: ensemble, beta: -1}", "measurement model 'ensemble' .*beta"),
        ("objectives.fake.model={name: ensemble, member: linaer}", "Did you mean 'linear'"),
        ("objectives.fake.model=[lstm]", "expected the name of a measurement model"),
    ],
)
def test_a_wrong_choice_is_one_line_before_anything_is_spent(tmp_path, override, said):
    with kit_installed():
        made = config(tmp_path, override)
        with pytest.raises(ConfigError, match=said) as caught:
            check_names(made, load())
    assert "\n" not in str(caught.value)


def test_a_right_choice_passes(tmp_path):
    with kit_installed():
        check_names(config(tmp_path, "objectives.fake.model={name: ensemble, member: linear}"), load())


def test_inputs_that_the_robot_does_not_give_are_named_before_anything_is_spent(tmp_path):
    from dataclasses import replace

    from hts.plugins import Entry

    with kit_installed():
        registry = load()
        objective = registry.make_objective("fake")
        objective.inputs = ("joint_torques",)
        other = {"fake": Entry("fake", lambda settings: objective, "test")}
        with pytest.raises(ConfigError, match="'fake' reads 'joint_torques': .*Did you mean 'joint_torque'"):
            check_names(config(tmp_path), replace(registry, objectives=other))
