"""Numbers of a configuration: finite where infinity has no meaning, never NaN, and no less than makes sense."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, get_args

import pytest
from pydantic import BaseModel

from hts.config import Config, RunConfig
from hts.config_loading import load_config
from hts.errors import ConfigError


def fake_config(**given) -> RunConfig:
    return load_config(objectives=["fake"], robot="hopper", **given)


def refusal(**given) -> str:
    with pytest.raises(ConfigError) as caught:
        fake_config(**given)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def number_fields(model: type[BaseModel], path: tuple[str, ...] = ()) -> Iterator[str]:
    """Dotted key of every number of a configuration, sections inside included."""
    for name, one in model.model_fields.items():
        kinds = [one.annotation, *get_args(one.annotation)]
        if float in kinds or int in kinds:
            yield ".".join((*path, name))
        for kind in kinds:
            if isinstance(kind, type) and issubclass(kind, Config):
                yield from number_fields(kind, (*path, name))


ENDLESS = {
    "finetune.env.commands.resample_seconds",
    "finetune.env.randomisation.pull_seconds",
    "finetune.env.randomisation.push_interval",
    "finetune.ppo.clip",
    "finetune.ppo.max_grad_norm",
    "measurement.max_seconds",
    "sweep.kl_bounds",
    "sweep.trust_region.close",
    "sweep.trust_region.most",
}
"""Where infinity has a meaning: never, or no bound."""


@pytest.mark.parametrize("key", [key for key in number_fields(RunConfig) if not key.startswith("collection.schedule")])
def test_no_number_is_nan_and_few_are_infinite(key):
    now = value_of(key)
    count = len(now) or 1 if isinstance(now, tuple) else 0

    def said(number):
        return f"{key}=[{', '.join([number] * count)}]" if count else f"{key}={number}"

    refusal(overrides=[said(".nan")])
    if key in ENDLESS:
        fake_config(overrides=[said(".inf")])
    else:
        refusal(overrides=[said(".inf")])


def value_of(key: str) -> Any:
    found: Any = fake_config().model_dump()
    for part in key.split("."):
        found = found[part]
    return found


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("gate.joint_margin=-0.1", "--set gate.joint_margin: expected at least 0, found -0.1."),
        ("gate.seconds=.inf", "--set gate.seconds: expected a finite number, found inf."),
        (f"seed={2**63}", f"--set seed: expected less than 9.22337e+18, found {2**63}."),
        (f"measurement.seed={2**63}", "--set measurement.seed: expected less than"),
        ("finetune.env.commands.heading_gain=-1", "heading_gain: expected at least 0, found -1."),
        ("finetune.env.randomisation.friction=[-1, 1]", "friction: expected two numbers of at least 0, found [-1, 1]."),
        ("finetune.env.randomisation.strength=[-0.9, 1.1]", "strength: expected two numbers of at least 0"),
        ("finetune.env.randomisation.com_shift=[0.1, -0.1]", "com_shift: expected two numbers, the smaller one first"),
        (
            "finetune.env.commands.vx=[1.5, -1.5]",
            "commands.vx: expected two numbers, the smaller one first, found [1.5",
        ),
        ("sweep.trust_region={least: 5, most: 1}", "sweep.trust_region: least: 5 is above most, 1"),
        ("gate.payload=[3.0, -1.0]", "gate.payload: expected two numbers, the smaller one first, found [3.0, -1.0]."),
        ("gate.lost_packets=[0.0, .inf]", "gate.lost_packets.1: expected a finite number, found inf."),
        ("finetune.env.reward_weights.alive=.nan", "reward_weights.alive: expected a finite number, found nan."),
        ("sweep.kl_bounds=[.nan]", "--set sweep.kl_bounds.0: is not a number, found nan."),
        (
            "collection.schedule={commands: [{seconds: .inf, vx: 0.5}]}",
            "--set collection.schedule: a command lasts forever; expected so many seconds of each.",
        ),
    ],
)
def test_a_number_that_makes_no_sense_is_refused(override, expected):
    assert expected in refusal(overrides=[override])


def test_the_largest_seed_is_taken():
    assert fake_config(seed=2**63 - 1).seed == 2**63 - 1


@pytest.mark.parametrize("bound", [0.05, 40.0, math.inf])
def test_a_kl_bound_is_one_that_the_trust_region_keeps(bound):
    asked = ["sweep.trust_region.enabled=true", f"sweep.kl_bounds=[1, {yaml_of(bound)}]"]
    assert fake_config(overrides=asked).sweep.kl_bounds == (1.0, bound)


@pytest.mark.parametrize("bound", [0.02, 41.0])
def test_one_that_it_would_replace_is_refused_where_it_is_on(bound):
    asked = f"sweep.kl_bounds=[1, {bound}]"
    found = refusal(overrides=["sweep.trust_region.enabled=true", asked])
    assert f"kl_bounds: {bound:g} is outside of what the trust region may make of it, 0.05 to 40; set " in found
    assert fake_config(overrides=["sweep.trust_region.enabled=false", asked]).sweep.kl_bounds == (1.0, bound)


def yaml_of(number: float) -> str:
    return ".inf" if math.isinf(number) else str(number)
