"""Numbers of a configuration: finite where infinity has no meaning, never NaN, and no less than makes sense."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Literal, get_args

import pytest
from pydantic import BaseModel

from hts.config import Config, PretrainConfig, RunConfig
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
        ("selection.block_seconds=0.5", "--set selection.block_seconds: expected at least 1, found 0.5."),
        ("iterations=true", "--set iterations: expected a whole number, found True."),
        ("sweep.kl_bounds=[true, 1.0]", "--set sweep.kl_bounds: expected a number, found [True, 1.0]."),
        ("finetune.steps=1e6", "--set finetune.steps: expected a whole number, found '1e6', write 1000000."),
        (f"seed={2**63}", f"--set seed: expected less than 9.22337e+18, found {2**63}."),
        (f"measurement.seed={2**63}", "--set measurement.seed: expected less than"),
        ("finetune.env.commands.heading_gain=-1", "heading_gain: expected at least 0, found -1."),
        ("finetune.env.randomisation.friction=[-1, 1]", "friction: expected two numbers of at least 0, found [-1, 1]."),
        ("finetune.env.randomisation.strength=[-0.9, 1.1]", "strength: expected two numbers above 0"),
        ("finetune.env.randomisation.strength=[0, 0]", "strength: expected two numbers above 0"),
        ("finetune.env.randomisation.com_shift=[0.1, -0.1]", "com_shift: expected two numbers, the smaller one first"),
        (
            "finetune.env.randomisation.com_shift=[-20, 20]",
            "com_shift: expected two numbers from -1 to 1 m (write m, not mm), found [-20, 20].",
        ),
        (
            "finetune.env.randomisation.joint_offset=[-1.2, 1.2]",
            "joint_offset: expected two numbers from -1 to 1 rad (write rad, not degrees), found [-1.2, 1.2].",
        ),
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


@pytest.mark.parametrize(
    ("key", "most"),
    [("finetune.env.threads", 1024), ("finetune.env.randomisation.models", 10_000), ("iterations", 1000)],
)
def test_numbers_that_would_only_fill_a_machine_have_an_upper_end(key, most):
    fake_config(overrides=[f"{key}={most}"])
    for number in (most + 1, 10**18):
        assert f"{key}: expected" in refusal(overrides=[f"{key}={number}"])


def test_a_batch_is_not_cut_into_more_parts_than_it_has_samples():
    small = ["finetune.num_envs=2", "finetune.ppo.horizon=3"]
    fake_config(overrides=[*small, "finetune.ppo.minibatches=6"])
    said = refusal(overrides=[*small, "finetune.ppo.minibatches=7"])
    assert "7 parts of a batch of 6 samples (ppo.horizon 3 x num_envs 2); expected at most 6" in said
    with pytest.raises(ValueError, match="7 parts of a batch of 6 samples"):
        PretrainConfig(num_envs=2, ppo={"horizon": 3, "minibatches": 7})


def test_false_where_a_field_says_that_it_may_stand_for_none():
    class Limited(Config):
        limit: float | Literal[False] = False

    assert Limited(limit=False).limit is False and Limited(limit=1.0).limit == 1.0
