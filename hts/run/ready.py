"""Everything that a run will build, built once before anything is spent.

A dry run does this, and every run before it makes its folder. What cannot work is then one line at the beginning, not
after data were collected: with a robot that was somebody's afternoon.
"""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hts.channels import Channel
from hts.config import RunConfig
from hts.config_loading import check_names
from hts.contracts import Objective, Robot, robot_signals
from hts.contracts.spec_faults import fault_of_step
from hts.errors import ConfigError, PluginError
from hts.evaluation.held import ask_to_hold, check_hold, hold_of
from hts.guarded import guarded
from hts.parts import make_model, objectives_of, robot_of, world_of
from hts.plugins import Registry
from hts.run.budget import plan
from hts.run.gate_checks import check_told
from hts.run.score_check import check_score, gain_of_less
from hts.run.selector_check import check_selector
from hts.training.sweep import weights_of

if TYPE_CHECKING:
    from torchrl.envs.transforms import Transform

    from hts.measurement.transform import Measured
    from hts.policies.files import Policy

HALF = 0.5  # standard deviations: a prediction like many others
FEW_ENVS = 2  # per candidate: enough to see that an env can be made and stepped


def check_ready(config: RunConfig, registry: Registry, engine: str | None = None) -> None:
    """Raise the HtsError that a run of this configuration would end in, as far as that can be known before it runs.

    Cheap things first: names and settings, inputs, proxies, λ, scores, the selector, measurement models, the policy's
    file, the world with this robot and these objectives, last an env that takes a step. engine: what `auto` stands for
    here; None: the env is not made.
    """
    from hts.measurement.proxy import try_proxy

    check_names(config, registry)
    robot = robot_of(config, registry)
    objectives = objectives_of(config, registry)
    for objective in objectives.values():
        signals = robot_signals(objective, robot)  # raises for an input that the robot does not give
        if not try_proxy(objective, signals.inputs) and config.reward_source == "proxy":
            raise ConfigError(
                f"Objective '{objective.name}' has no analytic stand-in, so there is no baseline to train. Write its "
                "`proxy` and `baseline_weights`; `hts run` needs neither."
            )
    own = "λ for its proxy" if config.reward_source == "proxy" else "λ of its own"
    if not weights_of(objectives, config):
        raise ConfigError(
            f"sweep.weights: {', '.join(objectives)} names no {own}, so there is nothing to train. "
            "Give some: --set sweep.weights.NAME=[0.5,1,5]"
        )
    check_shared_channels(objectives)
    compared = {
        name: check_score(objective, robot, registry.entry("objectives", name).package)
        for name, objective in objectives.items()
    }
    check_selector(registry, config.selection.selector, compared)
    unfitted_rewards(config, registry)
    pretrained_policy(robot)
    check_world(config, registry)
    if engine is not None:
        _check_env(config, registry, engine)
        if config.gate.enabled:
            from hts.run.gate_trials import check_payload

            check_payload(robot, config.gate)


def check_shared_channels(objectives: Mapping[str, Objective]) -> None:
    """Raise ConfigError for two objectives that measure one channel in different units or shapes: a recording has it
    once."""
    first: dict[str, tuple[str, Channel]] = {}
    for name, objective in objectives.items():
        for channel in objective.real_channels:
            other, known = first.setdefault(channel.name, (name, channel))
            if (known.unit, known.shape) == (channel.unit, channel.shape):
                continue
            one, two = (
                one.unit if known.shape == channel.shape else f"{one.unit}, shape {one.shape}"
                for one in (known, channel)
            )
            raise ConfigError(
                f"Objectives '{other}' and '{name}' both measure '{channel.name}', one in {one}, the other in {two}; a "
                "recording has it once. Let one of them read it as the other does, or measure another channel, or make "
                "two runs."
            )


def unfitted_rewards(config: RunConfig, registry: Registry) -> list[Measured]:
    """The rewards of the run's objectives for an env, from measurement models that are not fitted, or from proxies."""
    from hts.measurement.fitting import check_unfitted
    from hts.measurement.transform import MeasurementTransform, ProxyTransform

    robot = robot_of(config, registry)
    made: list[Measured] = []
    for name, objective in objectives_of(config, registry).items():
        what = f"Measurement model of objective '{name}'"
        if config.reward_source == "proxy":
            made.append(ProxyTransform(objective))
        else:
            model = guarded(what, partial(make_model, registry, objective, config.objectives[name], robot))
            check_unfitted(model, registry)
            made.append(MeasurementTransform.of(objective, model))
    return made


def pretrained_policy(robot: Robot) -> Policy:
    """The policy to start from. Raises ConfigError if there is none, PolicyError if its file cannot be used."""
    from hts.policies.files import load_policy, pretrained_file

    return load_policy(pretrained_file(robot), robot.spec)


def check_world(config: RunConfig, registry: Registry) -> None:
    """The world can serve this robot and these objectives, and hold the speed if it is to. Raises what its `check`
    raises, ConfigError for a speed that cannot be held."""
    check_hold(config)
    with tempfile.TemporaryDirectory(prefix="hts-ready-") as nowhere:
        world = world_of(config, registry, Path(nowhere))
        try:
            ask_to_hold(world, hold_of(config))
            if config.max_real_samples is not None:
                plan(config, registry, world)  # raises for a cap that nothing fits in
            guarded(f"World '{config.world.name}': check()", world.check)
            check_told(config, robot_of(config, registry), world)
        finally:
            world.close()


def _check_reward(name: str, objective: Objective) -> None:
    """An objective's reward of a batch has the batch's shape, whatever that is, and is a finite number for moderate
    predictions above and below the mean."""
    import torch

    from hts.measurement.reward import reward_of

    for shape, given in itertools.product(((1, FEW_ENVS, 1), (FEW_ENVS, 3)), (HALF, -HALF)):
        found = reward_of(name, objective.reward, torch.full(shape, given))
        if not bool(torch.isfinite(found).all()):
            raise PluginError(
                f"Objective '{name}': reward() is {float(found.flatten()[0]):g} for a prediction of {given:g} standard "
                "deviations; expected a finite number."
            )


def check_sign(name: str, objective: Objective, robot: Robot) -> None:
    """What pays in training is what counts on the robot. Raise PluginError for a reward that pays for what `compare`
    calls worse: policies would be trained to be worse, at every λ."""
    import torch

    from hts.measurement.reward import reward_of

    gain = gain_of_less(objective, robot)
    less, more = (float(reward_of(name, objective.reward, torch.full((1, 1), given))) for given in (-HALF, HALF))
    if gain is not None and gain * (less - more) < 0:
        paid, counts = ("less", "more") if less > more else ("more", "less")
        raise PluginError(
            f"Objective '{name}': reward() pays for {paid} of '{objective.target.name}', compare() counts {counts} of "
            "it as an improvement, so training would work against what is measured. Turn the sign of one of them."
        )


def _check_env(config: RunConfig, registry: Registry, engine: str) -> None:
    """The training env of this robot is made, with the rewards in it, and takes a step."""
    from hts.measurement.transform import channels_read

    robot = robot_of(config, registry)
    for name, objective in objectives_of(config, registry).items():
        _check_reward(name, objective)
        check_sign(name, objective, robot)
    channels = channels_read(unfitted_rewards(config, registry))
    check_step(config, robot, engine, channels, lambda: [*unfitted_rewards(config, registry)])


def check_step(
    config: RunConfig, robot: Robot, engine: str, channels: tuple[str, ...], around: Callable[[], list[Transform]]
) -> None:
    """The training env of a robot is made with these channels and transforms, takes two steps and begins again; the
    transforms also see several steps at once, as a collector shows them. Raises PluginError."""
    import torch
    from torchrl.envs.utils import step_mdp

    from hts.rl.deferred import DeferrableTransform
    from hts.training.finetune import measured_env

    def step() -> None:
        bare = robot.make_env(engine, 1, FEW_ENVS, config.finetune.env, channels=channels, seeds=[config.seed])
        if "dt" in dir(bare) and (fault := fault_of_step(bare.dt, robot.spec)):
            bare.close()
            raise PluginError(f"Robot '{config.robot.name}': {fault}. Correct the env's dt, or the spec.")
        made = around()
        env = measured_env(bare, made)
        try:
            state = env.reset()
            for _ in range(2):
                state["action"] = env.action_spec.zero()
                state = step_mdp(env.step(state))
            env.reset()
            for one in made:
                if isinstance(one, DeferrableTransform):
                    recorded = one.record(state["channels"])
                    ended = torch.zeros(2, FEW_ENVS, dtype=torch.bool, device=recorded.device)
                    ended[0, 0] = True
                    one.forward_sequence(torch.stack((recorded, recorded)), ended)
        finally:
            env.close()

    guarded(f"Robot '{config.robot.name}': its env", step)
