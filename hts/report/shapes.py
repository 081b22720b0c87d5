"""What the report's files must hold, whatever version wrote them: what is read of them without asking.

The rest makes the page fuller, and passes as it is.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

Number = float | None
"""JSON has neither NaN nor infinity: null stands for them."""


class Part(BaseModel):
    """Part of a file. A text is no number, and unknown keys are let alone."""

    model_config = ConfigDict(strict=True, extra="ignore")


class Estimate(Part):
    """What was measured of an improvement."""

    improvement: Number = Field(description="the objective's unit")
    improvement_ci95: list[Number] | None = Field(
        None, min_length=2, max_length=2, description="of it; null: it cannot be told"
    )


class Comparison(Estimate):
    """A policy against the pretrained one at one speed, or set-point."""

    segments: int | None = Field(None, description="that count")
    falls: int | None = Field(None, description="of the policy")
    mean_speed: Number = Field(None, description="m/s, or the task's unit")
    every_second: Estimate | None = Field(None, description="the same over all seconds; null: it cannot be told")


class Way(Part):
    """A final at equal commands, beside the one at held speed."""

    speeds: dict[str, Comparison] = Field(description="by speed, those that count")


class Result(Way):
    """The final of one objective."""

    unit: str = Field(description="of its improvement")
    open_loop: Way | None = Field(None, description="the same at equal commands; none: this is at them")


class Final(Part):
    """The final of a summary.json."""

    policy: str = Field(description="the result of the run")
    objectives: dict[str, Result] = Field(description="what it saves; empty: the policy to start from stays")


class Candidate(Part):
    """A policy that was trained."""

    id: str = Field(description="its name in the run")
    anchor: str = Field(description="best, pretrained or a policy's id")
    weights: dict[str, Number] = Field(description="objective -> λ")
    kl_bound: Number = Field(description="c, nats; null: none")
    kl: Number = Field(None, description="from its anchor, nats")
    sim_score: Number = Field(None, description="by which it was judged")
    falls: int | None = Field(None, description="in simulation")
    real: dict[str, dict[str, Comparison]] | None = Field(None, description="its trial; null: there was none")


class Model(Part):
    """The check of a measurement model."""

    held_out_r2: Number = Field(None, description="1")
    rank_correlation: Number = Field(None, description="1")


class Iteration(Part):
    """One iteration."""

    index: int = Field(description="from 0")
    measurement_models: dict[str, Model] = Field(default_factory=dict, description="by objective")
    candidates: list[Candidate] = Field(default_factory=list, description="all that were trained in it")


class Summary(Part):
    """summary.json."""

    objectives: list[str] = Field(min_length=1, description="names")
    robot: str = Field(description="its name")
    preset: str = Field(description="its name")
    engine: str = Field(description="what computed physics in training")
    seed: int = Field(description="of everything random")
    wall_seconds: Number = Field(None, description="of all stages")
    sim_steps: int | None = Field(None, description="control steps in simulation")
    real_samples: int | None = Field(None, description="control steps of the robot's time")
    iterations: list[Iteration] = Field(description="what became of each")
    final: Final | None = Field(description="null: there was none")


class Evaluation(Part):
    """evaluation.json."""

    objectives: dict[str, Result] = Field(description="what it says of each")


class Segments(Part):
    """segments.json: of one objective at one speed, quantity -> one number a segment; null: not finite."""

    policy: dict[str, list[Number]] = Field(description="of the result of the run")
    reference: dict[str, list[Number]] = Field(description="of the pretrained policy")
