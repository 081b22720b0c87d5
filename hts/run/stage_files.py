"""What the JSON of each finished stage must hold for a run to go on with it: what later stages read without asking.

A file that was cut off, or edited, may be JSON all the same. What is here is checked before anything is made of it, so
that such a file is named, and what to do with it. Keys that later versions added are optional: runs begun by earlier
ones go on. Everything that no stage reads passes as it is.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from hts.explain import explain
from hts.report.shapes import Number, Part, Summary
from hts.run.stages import damaged, read_json

if TYPE_CHECKING:
    from hts.config import RunConfig


class Collect(Part):
    """collect.json: ids of recordings; samples and falls of the robot."""

    recordings: list[str] = Field(description="ids in the run's store")
    samples: int = Field(description="of the robot, control steps")
    falls: int | None = Field(None, description="none: of before they were counted")


Facts = dict[str, Any] | None
"""What is looked into where it is there; a run of an earlier version may lack it."""


class HeldOut(Part):
    """A check on recordings that were kept from the fit."""

    recordings: list[str] = Field(description="their ids")
    r2: Number = Field(None, description="1")
    linear: Facts = Field(None, description="the same of a linear model")
    proxy: dict[str, Facts] | None = Field(None, description="the same of the analytic stand-ins")
    spread: Facts = Field(None, description="whether its doubt is as large as its errors")


class Fitted(Part):
    """How one objective's model was fitted and checked."""

    dataset: str = Field(description="SHA-256 of what it was fitted to")
    held_out_r2: Number = Field(description="on recordings kept from the fit, 1")
    rank_correlation: Number = Field(description="of predicted and measured cost over policies, 1")
    held_out: HeldOut = Field(description="all of that check")
    training: list[Any] = Field(default_factory=list, description="what it was fitted to")
    model: Facts = Field(None, description="its name and settings")
    same_session: Facts = Field(None, description="how many of these are of a session that was fitted to")
    masked: Facts = Field(None, description="samples that were left out")
    drift: Facts = Field(None, description="of the target within recordings")
    weights: list[float] | None = Field(None, description="λ that the objective asks for behind this model")


Fit = dict[str, Fitted]
"""fit.json: by objective."""


class Tuned(Part):
    """A candidate; kl and kl_bound in nats, null: infinite."""

    id: str = Field(description="its name in the run")
    anchor: str = Field(description="best, pretrained or a policy's id")
    weights: dict[str, Number] = Field(description="objective -> λ")
    kl_bound: Number = Field(description="c, nats; null: none")
    kl: Number = Field(description="mean KL to the anchor, nats")
    std: Number = Field(description="its mean σ, action units")
    anchor_std: Number = Field(
        description="what it began with: the anchor's, or with renewed noise the pretrained policy's, action units"
    )
    stopped: str | None = Field(description="why its training was stopped; null: it was not")
    policy_hash: str = Field(description="of the exported policy")


class Pull(Part):
    """How strongly the world pulls, as far as its trials say."""

    pull: list[float] = Field(description="at each speed of `simulation_test.speeds`, m/s²")
    steps: int = Field(0, description="control steps that were simulated for it")


class Finetune(Part):
    """finetune.json."""

    candidates: list[Tuned] = Field(description="all that were trained")
    steps: int = Field(description="control steps of all of them")
    reward_scale: dict[str, dict[str, Any]] | None = Field(None, description="objective -> how large its reward is")
    pull: Pull | None = Field(None, description="where it was measured")


class Promise(Part):
    """What is promised of a candidate at one speed, or set-point."""

    improvement: float = Field(description="over the pretrained policy, the objective's unit")
    selection_score: float = Field(description="what selection goes by")


class GaveUp(Part):
    """Who earns less of the task than it is to."""

    elites: list[str] = Field(description="who of those that are tried")
    line: str | None = Field(description="what was said; null: nothing")


class Simulate(Part):
    """simulate.json: by candidate."""

    policy_hashes: dict[str, str] | None = Field(None, description="of whom it judged; none: of before they were kept")
    scores: dict[str, Number] = Field(description="mean r_real, 1/s")
    falls: dict[str, int] = Field(description="env instances that fell")
    tracked: dict[str, bool] = Field(description="whether it does its task at every set-point")
    elites: list[str] = Field(description="whom the selector named")
    steps: int = Field(description="control steps")
    objective_scores: dict[str, dict[str, Number]] | None = Field(
        None, description="candidate -> objective -> score, 1/s"
    )
    task_rewards: dict[str, Number] | None = Field(None, description="the task's own reward, 1/s")
    predicted: dict[str, dict[str, dict[str, Promise]]] | None = Field(
        None, description="candidate -> objective -> speed -> what is promised"
    )
    trials: dict[str, list[dict[str, Any]]] | None = Field(None, description="candidate -> its trials")
    gave_up: GaveUp | None = Field(None, description="of the task")


class Gated(Part):
    """A policy that the gate looked at."""

    passed: bool = Field(description="every check")
    failed: list[str] = Field(description="checks that it did not pass")
    refused: str | None = Field(description="the line; null: it passed")
    worst: dict[str, Any] = Field(description="check -> what was worst")


class Gate(Part):
    """gate.json."""

    strict: bool = Field(description="whether who fails is kept from the world")
    checks: list[str] = Field(description="that were made")
    untold: list[str] = Field(description="that the env cannot tell")
    accepted_untold: list[str] = Field(description="for which of those a person vouches")
    limits: dict[str, Number] = Field(description="check -> what its value is held against")
    proposed: list[str] = Field(description="whom the selector named first")
    elites: list[str] = Field(description="who is tried for real")
    kept_out: dict[str, str] = Field(description="candidate -> why it was not asked about")
    policies: dict[str, Gated] = Field(description="who was tried here")
    pretrained: Gated | None = Field(description="the yardstick, where somebody was refused")
    first_run: dict[str, Any] = Field(description="how gently a policy first runs on a machine")
    lines: list[str] = Field(description="what was said")
    steps: int = Field(description="control steps")


class Nearer(Part):
    """nearer.json: candidates as finetune.json has them, and the two files that follow."""

    line: str = Field(description="what was said")
    candidates: list[Tuned] = Field(description="those closer to their anchors")
    simulate: Simulate = Field(description="as simulate.json")
    gate: Gate = Field(description="as gate.json")
    elites: list[str] = Field(default_factory=list, description="who is tried for real, of all that passed")


class Trial(Part):
    """What a trial measured of a candidate that was not refused."""

    fell: bool = Field(description="in the world")
    selection_score: dict[str, float] = Field(description="by objective; a number that is none never left its stage")


class AtSpeed(Part):
    """A final at one speed, or set-point."""

    improvement: Number = Field(description="over the pretrained policy, the objective's unit")
    falls: int = Field(description="how often it fell")


class Tried(Part):
    """A trial at one speed, or set-point."""

    improvement: float = Field(description="over the pretrained policy, the objective's unit")
    metrics: dict[str, float] = Field(default_factory=dict, description="what else the objective says of it")


class Result(Part):
    """A trial."""

    real: dict[str, Annotated[dict[str, Tried], Field(min_length=1)]] | None = Field(
        description="objective -> speed -> improvement and metrics; null: refused"
    )
    refused: str | None = Field(description="why; null: it was not")
    tested: Trial | None = Field(None, description="what selection goes by")


class Region(Part):
    """How the KL bounds moved."""

    scale: float = Field(gt=0, description="factor on the finite bounds from now on, 1")


class PolicyLevel(Part):
    """What a model made of one policy at one speed, or set-point, in its target's unit."""

    speed: Number = Field(description="commanded")
    measured: float = Field(description="mean of the target")
    predicted: float = Field(description="the same by the model")


class Ranked(Part):
    """What ranks are made of over all iterations."""

    policies: list[PolicyLevel] = Field(description="all that walked")


class ModelCheck(Ranked):
    """How well a model predicted the policies that were made with it."""

    proxy: dict[str, Ranked] | None = Field(None, description="the same of the analytic stand-ins")


class Test(Part):
    """test.json."""

    __test__ = False  # its name begins like a pytest class

    elites: list[str] = Field(description="who was tried")
    results: dict[str, Result] = Field(description="by elite")
    recordings: list[str] = Field(description="ids in the run's store")
    best: str | None = Field(description="the best of them; null: nobody was better")
    best_so_far: str = Field(description="of all iterations until now")
    samples: int = Field(description="of the robot, control steps")
    model_checks: dict[str, ModelCheck] = Field(description="objective -> how well its model predicted them")
    trust_region: Region | None = Field(None, description="where the bounds move")


class Ended(Part):
    """iterations.json."""

    done: int = Field(description="iterations before the real samples ended them")
    of: int = Field(description="that were to be")


class Best(Part):
    """best.json."""

    policy: str = Field(description="the best so far")
    objectives: dict[str, Any] = Field(description="what it saves")


class Confirm(Part):
    """confirm.json."""

    tried: list[str] = Field(description="who was tried twice")
    results: dict[str, Result] = Field(description="by candidate")
    recordings: list[str] = Field(description="ids in the run's store")
    samples: int = Field(description="of the robot, control steps")
    best: str = Field(description="who goes to the final")
    next: list[str] = Field(default_factory=list, description="who else may get one, the best first")


class GivenUp(Part):
    """A final that another one took the place of."""

    policy: str = Field(description="its id")
    falls: int = Field(description="in all that it walked")


class OpenLoop(Part):
    """What a final found at equal commands."""

    speeds: dict[str, AtSpeed] = Field(default_factory=dict, description="those that were kept")


class Compared(Part):
    """What a final found of one objective."""

    unit: str = Field(description="of its improvement")
    speeds: dict[str, AtSpeed] = Field(description="those that were kept")
    open_loop: OpenLoop | None = Field(None, description="the same at equal commands, where speeds were held")


class Final(Part):
    """final.json."""

    policy: str = Field(description="the result of the run")
    objectives: dict[str, Compared] = Field(description="what it saves; empty: the policy to start from stays")
    recordings: list[str] = Field(description="ids in the run's store")
    samples: int = Field(description="of the robot, control steps")
    given_up: list[GivenUp] = Field(default_factory=list, description="finals before it")


class Provenance(Part):
    """provenance.json."""

    world: dict[str, str] = Field(default_factory=dict, description="which machine it is, as far as the world says")
    config_sha256: str | None = Field(None, description="of config.yaml's settings when the run was begun")
    pretrained_policy: str | None = Field(None, description="hash of the policy that the run was begun with")


class TrueLevel(Part):
    """Mean and spread of a true quantity, in its instrument's unit."""

    model_config = ConfigDict(strict=True, extra="forbid")

    mean: float = Field(description="in its instrument's unit")
    std: float = Field(description="in its instrument's unit")


class Truth(Part):
    """truth.json of an oracle: by objective."""

    levels: dict[str, TrueLevel] = Field(description="by objective")


def has_gate(config: RunConfig, iteration: Path) -> bool:
    """Whether an iteration has the stage `gate`; iteration: its folder. One that was tested by a version that had no
    gate has none: the config.yaml of such a run does not name it."""
    if not config.gate.enabled:
        return False
    return "gate" in config.model_fields_set or not (iteration / "test.json").exists()


def gate_is_due(config: RunConfig, iteration: Path) -> bool:
    """Whether that stage is still to be done, or again, since its result was deleted."""
    return has_gate(config, iteration) and not (iteration / "gate.json").exists()


FILES: dict[str, Any] = {
    "collect": Collect,
    "fit": Fit,
    "finetune": Finetune,
    "simulate": Simulate,
    "gate": Gate,
    "nearer": Nearer,
    "test": Test,
    "iterations": Ended,
    "best": Best,
    "confirm": Confirm,
    "final": Final,
    "summary": Summary,
    "provenance": Provenance,
    "truth": Truth,
}
"""Stage -> what its file must hold."""


def read_stage(path: Path) -> Any:
    """The JSON of a finished stage, as it lies there. Raises RunError, one line, for a file that is missing, that is no
    JSON, or that lacks what a run needs of it."""
    found = read_json(path)
    if path.stem in FILES:
        try:
            TypeAdapter(FILES[path.stem]).validate_python(found)
        except ValidationError as error:
            raise damaged(path, explain(error, Part).rstrip(".")) from error
    return found
