"""Speeds, yaw rates and loads of a configuration that no such machine has are in another unit: a dry run says so."""

from __future__ import annotations

import dataclasses

import pytest

from hts.config_loading import load_config
from hts.contracts.speeds import fastest
from hts.errors import ConfigError
from hts.plugins import load
from hts.run.ready import check_ready
from hts.task_settings import check_task
from hts.testing.packages import kit_installed

pytest.importorskip("hts_go1", reason="a robot with legs is needed")


def checked(*overrides: str) -> None:
    registry = load()
    config = load_config(preset="smoke", objectives=["fake"], robot="go1", world="twin", overrides=overrides)
    check_task(config, registry.make_robot("go1"))


@pytest.fixture(autouse=True)
def _kit():
    with kit_installed():
        yield


@pytest.mark.parametrize(
    ("override", "said"),
    [
        (
            "finetune.env.commands.vx=[-1500, 1500]",
            "found -1500. It is probably in another unit: write m/s, not km/h or mm/s.",
        ),
        ("finetune.env.commands.vy=[-0.5, 500]", "found 500. It is"),
        ("finetune.env.commands.fixed=[0.8, 80]", "found 80. It is"),
        (
            "finetune.env.commands.yaw_rate=[-57, 57]",
            "rad/s of a robot with feet, found -57. It is probably in another unit: write ",
        ),
        ("finetune.env.randomisation.push_speed=500", "found 500. It is"),
        ("simulation_test.speeds=[0.5, 800]", "expected at most 20 m/s of a robot with feet, found 800. It is"),
        ("selection.speed=28.8", "found 28.8. It is"),
        ("selection.speeds=[0.5, 800]", "found 800. It is"),
        ("evaluation.speeds=[500]", "found 500. It is"),
    ],
)
def test_a_velocity_that_no_legs_have_is_one_line_with_its_key_and_unit(override, said):
    with pytest.raises(ConfigError) as caught:
        checked(override)
    text = str(caught.value)
    assert text.startswith(override.split("=")[0] + ": expected at most 20 ") and said in text and "\n" not in text


def test_a_schedule_says_which_of_its_commands():
    with pytest.raises(ConfigError, match=r"^collection\.schedule\.commands\.1\.yaw_rate: .* found 30\. .*degrees/s"):
        checked("collection.schedule.commands=[{seconds: 4, vx: 0.5}, {seconds: 4, vx: 0.5, yaw_rate: 30}]")


def test_what_the_fastest_legs_do_passes_and_wheels_may_be_faster():
    checked("finetune.env.commands={vx: [-15, 15], vy: [-5, 5], yaw_rate: [-15, 15]}", "evaluation.speeds=[15]")
    spec = load().make_robot("go1").spec
    assert (fastest(spec), fastest(dataclasses.replace(spec, foot_sites=()))) == (20.0, 100.0)


@pytest.mark.parametrize("key", ["finetune.env.randomisation.added_mass", "gate.payload"])
def test_a_load_in_grams_is_one_line_with_what_the_robot_weighs(key):
    sets = ("sweep.weights.fake=[1.0]", f"{key}=[0, 2000]")
    config = load_config(preset="smoke", objectives=["fake"], robot="tiny", world="known", overrides=sets)
    with pytest.raises(
        ConfigError, match=r"kg, 5 times what 'tiny' weighs, found 2000\. .* write kg, not g\.$"
    ) as caught:
        check_ready(config, load(), "mujoco")
    assert str(caught.value).startswith(key.removeprefix("finetune.env."))
