"""The configuration of a run: frozen pydantic models, every field with meaning, symbol and unit.

Plugins keep their own settings models; here their settings are plain mappings beside a name, and the
plugin's factory validates them. Nothing edits a config after it is built.
"""

from __future__ import annotations

import math
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from hts.config_base import SEEDS, Config, MayBeEndless, Named, shares_of
from hts.config_env import CommandConfig, EnvConfig, RandomisationConfig
from hts.config_gate import GateConfig
from hts.config_judging import EvaluationConfig, SelectionConfig, SimulationTestConfig
from hts.schedules import NOTHING, Command, ScheduleConfig

__all__ = [
    "NOTHING",
    "CollectionConfig",
    "Command",
    "CommandConfig",
    "Config",
    "EnvConfig",
    "EvaluationConfig",
    "FinetuneConfig",
    "GateConfig",
    "MeasurementConfig",
    "Named",
    "PPOConfig",
    "PretrainConfig",
    "ProvenanceConfig",
    "RandomisationConfig",
    "RunConfig",
    "ScheduleConfig",
    "SelectionConfig",
    "SimulationTestConfig",
    "SweepConfig",
    "TrustRegionConfig",
]


class PPOConfig(Config):
    """Anchored PPO. Defaults: Rudin et al. 2022 as released, with the caution for fine-tuning (small rate)."""

    horizon: int = Field(24, ge=1, description="control steps per world and batch, T")
    epochs: int = Field(5, ge=1, description="passes over each batch")
    minibatches: int = Field(4, ge=1, description="parts of a batch per pass")
    clip: float = Field(0.2, allow_inf_nan=True, gt=0, description="epsilon of the clipped surrogate")
    gamma: float = Field(0.99, gt=0, lt=1, description="discount per control step")
    gae_lambda: float = Field(0.95, ge=0, le=1, description="lambda of generalised advantage estimation")
    entropy_coef: float = Field(0.0, ge=0, description="entropy bonus")
    value_coef: float = Field(1.0, gt=0, description="weight of the value loss")
    learning_rate: float = Field(3e-4, gt=0, description="Adam step size (start value if adaptive)")
    adaptive_rate: bool = Field(False, description="rate follows KL(old‖new) per candidate, target `desired_kl`")
    desired_kl: float = Field(0.01, gt=0, description="target of the adaptive rate, nats")
    max_grad_norm: float = Field(1.0, allow_inf_nan=True, gt=0, description="per candidate")
    multiplier_rate: float = Field(0.05, gt=0, description="eta: step of the Lagrange multiplier per batch")
    centring_rate: float = Field(0.05, gt=0, le=1, description="beta of reward centring, per batch")
    hold_rate: float = Field(0.0125, ge=0, description="step of the multipliers of held means per batch and error")
    hold_gain: float = Field(0.5, ge=0, description="their proportional part, per error that matters")
    hold_smoothing: float = Field(0.15, gt=0, le=1, description="share of a new batch in the mean that they see")
    warmup_batches: int = Field(0, ge=0, description="first batches that only fit the critic")
    tf32: bool = Field(True, description="on a GPU: matrix products of policy and critic in TF32 (10 bits of mantissa)")
    fuse: bool | None = Field(
        None,
        description="on a GPU: control step, loss and Adam through torch.compile; null: where a C compiler is",
    )
    capture: bool = Field(
        True, description="on a GPU: control and gradient steps as CUDA graphs; false: one by one, to look for an error"
    )


def check_minibatches(ppo: PPOConfig, num_envs: int) -> None:
    """Raises ValueError where a batch of a candidate has fewer samples than it shall have parts."""
    samples = ppo.horizon * num_envs
    if ppo.minibatches > samples:
        raise ValueError(
            f"ppo.minibatches: {ppo.minibatches} parts of a batch of {samples} samples (ppo.horizon {ppo.horizon} x "
            f"num_envs {num_envs}); expected at most {samples}"
        )


def check_warmup(ppo: PPOConfig, num_envs: int, steps: int) -> None:
    """Raises ValueError where the batches that fit the critic alone are all that there are."""
    batches = max(1, round(steps / (num_envs * ppo.horizon)))
    if ppo.warmup_batches >= batches:
        raise ValueError(
            f"ppo.warmup_batches: {ppo.warmup_batches} of the training's {batches} batches (steps {steps} / (num_envs "
            f"{num_envs} x ppo.horizon {ppo.horizon})) fit the critic alone, so the policy would not learn; expected "
            f"at most {batches - 1}, or more steps"
        )


class FinetuneConfig(Config):
    """Fine-tuning of all candidates of an iteration, together."""

    num_envs: int = Field(64, ge=1, description="worlds per candidate, N")
    steps: int = Field(400_000, gt=0, description="control steps per candidate")
    max_candidates: int = Field(32, ge=1, description="trained together at most; more go in several groups")
    also_at: tuple[float, ...] = Field(
        (), description="shares of the training, between 0 and 1, at which candidates are kept too and judged beside"
    )
    average: float = Field(
        0.0,
        ge=0.0,
        lt=1.0,
        description="share of the training, at its end, over which a candidate's parameters are averaged; 0: as they "
        "ended",
    )
    hold: bool = Field(
        False,
        description="hold the task's own measure at zero on average (of a velocity robot: its relative speed error) "
        "by a multiplier per candidate, so that doing less of the task is no saving",
    )
    hold_below: bool = Field(
        True,
        description="with `hold`: also keep how much the task is missed (of a velocity robot: its speed of about a "
        "second) at or below what the robot names",
    )
    hold_from_anchor: bool = Field(
        True,
        description="with `hold`: prices begin where the training of the anchor found them, not at nothing",
    )
    renew_noise: bool = Field(
        False,
        description="candidates begin with the exploration noise of the pretrained policy, not with what is left of it "
        "in their anchor, and KL to the anchor is counted with it",
    )
    measured_pull: bool = Field(
        False,
        description="pull at the trunk in training as strongly as the trials so far say that the world does, where "
        "that is more than env.randomisation.pull; from the second iteration on",
    )
    ppo: PPOConfig = Field(default_factory=PPOConfig, description="how it learns")
    env: EnvConfig = Field(default_factory=EnvConfig, description="what it learns in")

    @field_validator("also_at")
    @classmethod
    def _on_the_way(cls, shares: tuple[float, ...]) -> tuple[float, ...]:
        return shares_of("training", shares)

    @model_validator(mode="after")
    def _batches_fit_their_parts_and_the_policy(self) -> FinetuneConfig:
        check_minibatches(self.ppo, self.num_envs)
        check_warmup(self.ppo, self.num_envs, self.steps)
        return self


class PretrainConfig(Config):
    """The policy to start from, made in simulation with the task's own reward."""

    engine: str = Field("warp", description="warp (GPU, minutes), mujoco (CPU, hours) or auto")
    num_envs: int = Field(8192, ge=1, description="worlds")
    steps: int = Field(300_000_000, gt=0, description="control steps in all")
    hidden: tuple[int, ...] = Field((256, 128), min_length=1, description="hidden layers of actor and critic")
    init_std: float = Field(1.0, gt=0, description="sigma of the first policy, action units")
    seed: int = Field(0, ge=0, lt=SEEDS, description="of networks, env and exploration")
    ppo: PPOConfig = Field(
        default_factory=lambda: PPOConfig(learning_rate=1e-3, adaptive_rate=True, entropy_coef=0.005),
        description="PPO without an anchor",
    )
    env: EnvConfig = Field(default_factory=EnvConfig, description="what it learns in")

    @model_validator(mode="after")
    def _batches_fit_their_parts_and_the_policy(self) -> PretrainConfig:
        check_minibatches(self.ppo, self.num_envs)
        check_warmup(self.ppo, self.num_envs, self.steps)
        return self


class TrustRegionConfig(Config):
    """How the KL bounds move from one iteration to the next, by rho, the measured improvement over the predicted."""

    enabled: bool = Field(False, description="whether they move at all; false: the same bounds in each iteration")
    agreement: float = Field(
        0.5, gt=0, lt=1, description="grow if all of rho's interval lies above, shrink if all of it lies below"
    )
    close: float = Field(
        0.75, allow_inf_nan=True, gt=0, description="grow twice if all of rho's interval lies above this"
    )
    grow: float = Field(2.0, ge=1, description="factor on every bound")
    shrink: float = Field(0.5, gt=0, le=1, description="factor on every bound, also after any fall")
    least: float = Field(0.05, gt=0, description="smallest bound, nats")
    most: float = Field(40.0, allow_inf_nan=True, gt=0, description="largest finite bound, nats")

    @model_validator(mode="after")
    def _in_order(self) -> TrustRegionConfig:
        if self.least > self.most:
            raise ValueError(f"least: {self.least:g} is above most, {self.most:g}")
        return self


class SweepConfig(Config):
    """Anchors × weights λ × KL bounds c."""

    weights: dict[str, tuple[float, ...]] = Field(
        default_factory=dict,
        description="λ per objective; missing: the objective's own. Several objectives: none given, each alone and all "
        "together, level by level; some given, every combination (all zero is left out)",
    )
    kl_bounds: tuple[MayBeEndless, ...] = Field((0.2, 0.5, 1.0), min_length=1, description="c, nats; .inf: no bound")
    anchors: tuple[Literal["best", "pretrained", "front"], ...] = Field(
        ("best", "pretrained"),
        min_length=1,
        description="which policies to start from; front: for each combination of λ the measured one that goes "
        "furthest in its direction",
    )

    trust_region: TrustRegionConfig = Field(
        default_factory=TrustRegionConfig, description="how the bounds move between iterations"
    )

    @model_validator(mode="after")
    def _positive(self) -> SweepConfig:
        for name, values in self.weights.items():
            for value in values:
                if not (math.isfinite(value) and value >= 0):
                    raise ValueError(f"weights.{name}: {value} is not a number of at least 0")
        limits = self.trust_region
        if limits.enabled and all(map(math.isinf, self.kl_bounds)):
            raise ValueError(
                "kl_bounds: none is finite, so the trust region has nothing to move, and a robot would try nobody who "
                "is held near what it knows; add one, such as [16.0, .inf], or set trust_region.enabled=false"
            )
        for bound in self.kl_bounds:
            if not bound > 0 or math.isnan(bound):
                raise ValueError(f"kl_bounds: {bound} is not a positive number")
            if limits.enabled and math.isfinite(bound) and not limits.least <= bound <= limits.most:
                raise ValueError(
                    f"kl_bounds: {bound:g} is outside of what the trust region may make of it, {limits.least:g} to "
                    f"{limits.most:g}; set trust_region.least and trust_region.most around it, or kl_bounds inside them"
                )
        return self


class CollectionConfig(Config):
    """Real data from the pretrained policy, before the first fit.

    A model fitted to the mean action alone has seen one walk; in training it meets the policy's own exploration, and
    then candidates that walk differently. Recordings with exploration noise show it what such changes cost.
    """

    schedule: ScheduleConfig = Field(description="what each recording is commanded, and for how long")
    repeats: int = Field(2, ge=1, description="recordings of the schedule with the mean action, as policies are tested")
    exploring: int = Field(6, ge=0, description="recordings of the schedule with exploration noise")
    exploration: float = Field(0.3, gt=0, description="sigma of that noise, as a share of the policy's own sigma")

    @field_validator("schedule")
    @classmethod
    def _comes_to_an_end(cls, schedule: ScheduleConfig) -> ScheduleConfig:
        if not math.isfinite(schedule.seconds):  # which a mapping may leave open: there the log ends it
            raise ValueError("a command lasts forever; expected so many seconds of each")
        return schedule


class MeasurementConfig(Config):
    """Fitting of measurement models."""

    epochs: int = Field(20, ge=1, description="passes over the data")
    held_out: float = Field(0.2, gt=0, lt=1, description="share of recordings kept for checking")
    refit: bool = Field(
        True,
        description="after the check, fit again to all recordings: the policy that the next iteration starts from may "
        "be among those that were held out",
    )
    seed: int = Field(0, ge=0, lt=SEEDS, description="of initial weights and batch order")
    max_seconds: float = Field(
        600.0, allow_inf_nan=True, gt=0, description="stop after the epoch in which so much time has passed, s"
    )


class ProvenanceConfig(Config):
    """What provenance.json holds beside versions, commit, seeds and hardware."""

    diff: bool = Field(False, description="whether to keep the `git diff` of the sources, and not its hash alone")


class RunConfig(Config):
    """All of a run. `preset` says which defaults it started from."""

    preset: str = Field(description="which defaults it started from: smoke, quick, paper or paper-exact")
    objectives: dict[str, dict[str, Any]] = Field(min_length=1, description="name -> settings of its plugin")
    robot: Named = Field(description="the machine, and its settings")
    world: Named = Field(description='where policies run "for real", and its settings')
    engine: str = Field(
        "auto", description="mujoco (CPU), warp (GPU), or auto: warp where CUDA and its package are there"
    )
    reward_source: Literal["model", "proxy", "oracle"] = Field(
        "model",
        description="r_real from the measurement model, from the objective's analytic proxy (the baseline), or, in "
        "`hts oracle` alone, from inside a twin",
    )
    start: str | None = Field(
        None, description="of `hts oracle`: policy file that candidates start from; null: the pretrained one"
    )
    oracle_trains_in: Literal["reality", "simulation"] = Field(
        "reality",
        description="of `hts oracle`: candidates train on the reality, or as a run's in simulation, paid by its "
        "instruments in the place of a fitted model: then only the reward sees inside",
    )
    executor: str = Field("local", description="local (ray is planned)")
    seed: int = Field(0, ge=0, lt=SEEDS, description="of the whole run")
    iterations: int = Field(ge=1, le=1000, description="rounds of Algorithm 1")
    max_real_samples: int | None = Field(
        None,
        ge=1,
        description="of the robot before the final: first data, iterations and tests are planned within, and the "
        "iterations end where the next would pass it; null: no cap",
    )
    collection: CollectionConfig = Field(description="first real data")
    measurement: MeasurementConfig = Field(
        default_factory=MeasurementConfig, description="fitting of measurement models"
    )
    sweep: SweepConfig = Field(default_factory=SweepConfig, description="anchors, weights λ and KL bounds c")
    finetune: FinetuneConfig = Field(default_factory=FinetuneConfig, description="training of the candidates")
    simulation_test: SimulationTestConfig = Field(
        default_factory=SimulationTestConfig, description="candidates judged in simulation"
    )
    gate: GateConfig = Field(
        default_factory=GateConfig, description="what elites must bear in simulation before they are tried for real"
    )
    selection: SelectionConfig = Field(default_factory=SelectionConfig, description="elites and the best")
    evaluation: EvaluationConfig = Field(default_factory=EvaluationConfig, description="the final head-to-head")
    provenance: ProvenanceConfig = Field(
        default_factory=ProvenanceConfig, description="what is kept of where results come from"
    )

    @property
    def records_first(self) -> bool:
        """Whether real data are recorded before any candidate is tried: models are fitted to them, and a trust region
        needs them to say what a proxy promises."""
        return self.fits_models or self.sweep.trust_region.enabled

    @property
    def fits_models(self) -> bool:
        """Whether measurement models are fitted. Of an oracle in simulation, too: it is a run but for what pays."""
        return self.reward_source == "model" or self.oracle_trains_in == "simulation"

    @model_validator(mode="after")
    def _something_to_learn(self) -> RunConfig:
        given = [self.sweep.weights.get(name) for name in self.objectives]
        if all(values and not any(values) for values in given):
            raise ValueError("sweep.weights: every λ is 0, so nothing measured would be learned from; give one above 0")
        if self.selection.confirm == 1:
            raise ValueError("selection.confirm: one candidate leaves nothing to choose from; give 0, or 2 or more")
        if self.start is not None and self.reward_source != "oracle":
            raise ValueError(
                "start: only `hts oracle` starts from another policy; for a run: robot.policy, of its robot"
            )
        if self.oracle_trains_in != "reality" and self.reward_source != "oracle":
            raise ValueError(
                "oracle_trains_in: belongs to `hts oracle`, whose reward_source is oracle; every run trains in "
                f"simulation. Found reward_source {self.reward_source}: leave one of the two out."
            )
        if self.oracle_trains_in != "reality" and self.start is not None:
            raise ValueError(
                "start: of an oracle that trains on the reality; in simulation it starts as a run does. Leave it out."
            )
        return self
