"""The stages that learn: fit measurement models, fine-tune the sweep."""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hts.config import FinetuneConfig
from hts.contracts import MeasurementModel, Objective, physics_steps_of
from hts.errors import PluginError
from hts.guarded import guarded
from hts.measurement import files
from hts.measurement.fit_command import FitResult, fit_and_check
from hts.measurement.fit_report import doubts, masked_lines
from hts.measurement.outliers import masked_split
from hts.measurement.transform import Measured, MeasurementTransform, ProxyTransform, channels_read
from hts.policies.files import Policy, make_card
from hts.policies.proof import inherited
from hts.policy_ids import PRETRAINED
from hts.recordings import Recording
from hts.run.curves import Curves
from hts.run.felt_pull import felt_pull, pull_line
from hts.run.front import real_front
from hts.run.job import Job
from hts.run.stages import Report
from hts.run.task_watch import reward_scale, scale_lines
from hts.run.trust_region import scaled
from hts.selection.fronts import towards
from hts.training.finetune import Finetuned
from hts.training.finetune import finetune as finetune_candidates
from hts.training.sweep import FRONT, Candidate, candidates, combinations


def fit(job: Job, iteration: int, report: Report) -> dict[str, Any]:
    """f_i <- A(D_i) for each objective: models in iterations/NN/models, their checks as the result."""
    ids = job.known(iteration)
    dataset = job.dataset(ids)
    recordings = job.recordings(ids)
    keep = {recording.policy_hash for recording in recordings if recording.role in ("collection", "reference")}
    result = {}
    for number, (name, objective) in enumerate(job.objectives.items()):

        def share(epoch: int, epochs: int, error: float, number: int = number) -> None:
            report((number + epoch / epochs) / len(job.objectives))

        fitted = fit_one(job, name, recordings, keep=keep, progress=share)
        notes = {"dataset": dataset.sha256, "iteration": iteration}
        files.save(fitted.model, job.model_path(iteration, name), notes)
        result[name] = {**fitted.report, "dataset": dataset.sha256, "recordings": list(dataset.ids)}
        if asks_weights(job, iteration, name):
            result[name]["weights"] = own_weights_of(objective, fitted.model, recordings)
        before = job.read("fit", iteration - 1)[name] if iteration else None
        if before is None or not doubts(before):  # once is enough
            for line in doubts(result[name]):
                job.say(line)
        for line in masked_lines(result[name], before):  # again where new recordings have more of them
            job.say(line)
    return result


def fit_one(job: Job, name: str, recordings: Sequence[Recording], **how: Any) -> FitResult:
    """One objective's model, with the settings of the run; how: of `fit_and_check`."""
    return fit_and_check(
        job.objectives[name],
        recordings,
        job.config.measurement,
        settings=job.config.objectives[name],
        registry=job.registry,
        physics_steps=physics_steps_of(job.robot),
        **how,
    )


def asks_weights(job: Job, iteration: int, name: str) -> bool:
    """Whether an objective's own λ are asked for behind its model: where nobody names any, and not in the midst of a
    run that an earlier version began without."""
    if not job.config.fits_models or job.config.sweep.weights.get(name):
        return False
    return iteration == 0 or "weights" in job.read("fit", iteration - 1)[name]


def own_weights_of(objective: Objective, model: MeasurementModel, recordings: Sequence[Recording]) -> list[float]:
    """Its own λ behind a fitted model. Raises PluginError for others than the contract allows."""
    channels = (*objective.inputs, objective.target.name)
    clean, _, _ = masked_split(recordings, (), channels, None)  # as the model saw them
    found = guarded(
        f"Objective '{objective.name}': weights_for()",
        lambda: [float(one) for one in objective.weights_for(float(model.target_std), clean)],
    )
    if len(found) != len(objective.weights) or not all(math.isfinite(one) and one >= 0 for one in found):
        raise PluginError(
            f"Objective '{objective.name}': weights_for gave {found}; expected as many finite λ of at least 0 as "
            f"`weights` has, {len(objective.weights)}."
        )
    return found


def combinations_of(job: Job, iteration: int) -> list[dict[str, float]]:
    """λ of each candidate of an iteration: own ones as the objectives say behind the models of now, or where they were
    not asked those that need no model."""
    if not job.config.fits_models:
        return job.combinations
    fits = job.read("fit", iteration)
    own = {name: fits[name].get("weights", objective.weights) for name, objective in job.objectives.items()}
    return combinations(own, job.config.sweep.weights)


def transforms(job: Job, iteration: int) -> list[Measured]:
    """Fresh measurement models (or analytic proxies) to put into an env; of an oracle what it sees."""
    seen = job.rewards(iteration)
    if seen is not None:
        return seen
    if job.config.reward_source == "proxy":
        return [ProxyTransform(objective) for objective in job.objectives.values()]
    return [
        MeasurementTransform.of(objective, job.model(iteration, name)) for name, objective in job.objectives.items()
    ]


def sweep(job: Job, iteration: int, best: str) -> list[Candidate]:
    """The candidates of an iteration. An anchor "front" becomes, for each combination of λ, the id of a policy."""

    def policy_hash(name: str) -> str:
        return job.policy(name).card.policy_hash

    behind = {"best": best, PRETRAINED: PRETRAINED}
    hashes: dict[str, str] = {
        anchor: policy_hash(behind[anchor]) if anchor in behind else "" for anchor in job.config.sweep.anchors
    }
    front = real_front(job, iteration) if FRONT in hashes else []

    def furthest(weights: Mapping[str, float]) -> tuple[str, str]:
        name = front[towards([one.gains for one in front], [weights[key] for key in job.objectives])].id
        return name, policy_hash(name)

    bounds = scaled(job.config.sweep.kl_bounds, bound_scale(job, iteration), job.config.sweep.trust_region)
    return candidates(iteration, hashes, combinations_of(job, iteration), bounds, furthest)


def bound_scale(job: Job, iteration: int) -> float:
    """Factor on the finite KL bounds of an iteration, as the tests of the one before it left it."""
    if iteration == 0:
        return 1.0
    return float((job.read("test", iteration - 1).get("trust_region") or {}).get("scale", 1.0))


def finetune(job: Job, iteration: int, best: str, report: Report) -> dict[str, Any]:
    """Fine-tune every candidate; policies in iterations/NN/candidates, training curves in log/ (TensorBoard)."""
    config = job.config
    group = sweep(job, iteration, best)
    behind = {"best": best}
    anchors = {name: job.anchor(behind.get(name, name)) for name in ("best", *sorted({one.anchor for one in group}))}
    checkpoint = job.iteration_folder(iteration) / "checkpoint"
    checkpoint.parent.mkdir(parents=True, exist_ok=True)
    begun = any(checkpoint.parent.glob(f"{checkpoint.name}-*"))
    curves = job.folder / "log" / f"iteration-{iteration:02d}"
    if not begun:  # from the start: a killed process' log comes again
        shutil.rmtree(curves, ignore_errors=True)
    key = f"{iteration}/{'/'.join(anchor.card.policy_hash for anchor in anchors.values())}/{config.seed}"
    pull = felt_pull(job, iteration)
    if pull is not None:
        job.say(f"iteration {iteration:02d}: {pull_line(pull, config.simulation_test.speeds)}")
    with Curves(curves, goes_on=begun) as log:
        tuned, steps = finetune_candidates(
            job.robot,
            config.engine,
            _trained_in(config.finetune, pull),
            group,
            anchors,
            lambda: transforms(job, iteration),
            channels_read(transforms(job, iteration)),
            seed=job.seed("finetune", iteration),
            checkpoint=checkpoint,
            key=key,
            progress=report,
            log=log.add,
        )
    rows = [_saved(job, iteration, one, anchors[one.candidate.anchor]) for one in tuned]
    _remove_checkpoints(checkpoint)
    scale = reward_scale(rows, list(job.objectives))
    held = bool(config.finetune.hold and job.robot.held_at_zero)  # then a large λ cannot buy less of the task
    for line in () if held else scale_lines(scale, rows):
        job.say(line)
    rows += job.untrained(iteration)
    found = {} if pull is None else {"pull": pull}
    return {"candidates": rows, "steps": steps, "reward_scale": scale, "held": held, **found}


def _saved(job: Job, iteration: int, tuned: Finetuned, anchor: Policy) -> dict[str, Any]:
    """A candidate after training: written, and its row of finetune.json."""
    candidate = tuned.candidate
    made = {
        "anchor": anchor.card.policy_hash,
        "weights": dict(candidate.weights),
        "kl_bound": str(candidate.kl_bound),
        "kl": tuned.kl,
        "iteration": iteration,
        **({"prices": dict(tuned.prices)} if tuned.prices else {}),
        **inherited(anchor.card.made),
    }
    layout = [dict(part) for part in anchor.card.observation]
    card = make_card(job.robot.spec, tuned.tensors, layout, anchor.card.sizes(), **made)
    job.save(candidate.id, Policy(tuned.tensors, card))
    return {
        "id": candidate.id,
        "anchor": candidate.anchor,
        "weights": dict(candidate.weights),
        "kl_bound": candidate.kl_bound,
        "kl": tuned.kl,
        "std": tuned.std,
        "anchor_std": tuned.anchor_std,
        "stopped": tuned.stopped,
        **({"share": tuned.share} if tuned.share < 1.0 else {}),
        "policy_hash": card.policy_hash,
        "curve": tuned.history[:: max(1, len(tuned.history) // 50)],
    }


def _trained_in(config: FinetuneConfig, pull: Mapping[str, Any] | None) -> FinetuneConfig:
    """Training with the pulls that were measured, dealt out to the instances in turn, where that is asked for; none is
    less than what is configured."""
    if pull is None or not config.measured_pull:
        return config
    least = max(config.env.randomisation.pull)
    changed = config.env.randomisation.model_copy(update={"pull": tuple(max(least, one) for one in pull["pull"])})
    return config.model_copy(update={"env": config.env.model_copy(update={"randomisation": changed})})


def _remove_checkpoints(checkpoint: Path) -> None:
    """Those of this stage, and what a killed process left of writing one."""
    for left in [*checkpoint.parent.glob(f"{checkpoint.name}-*"), *checkpoint.parent.glob(f".{checkpoint.name}-*")]:
        if left.is_dir():
            shutil.rmtree(left)
        else:
            left.unlink()
