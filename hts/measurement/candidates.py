"""Measurement models that may be fitted, beside the chosen one, and the rows of the table that come of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from hts.config import MeasurementConfig, Named
from hts.contracts import MeasurementModel, ModelContext, chosen_model, physics_steps_of
from hts.errors import HtsError, RecordingError
from hts.measurement import comparison
from hts.measurement.baseline import stand_ins
from hts.measurement.data import recorded_signals
from hts.measurement.fit_settings import FitSettings
from hts.measurement.fitting import fit_model
from hts.measurement.outliers import masked_split

if TYPE_CHECKING:
    from hts.contracts import Objective, RobotSpec, Settings
    from hts.contracts.measurement_model import Progress
    from hts.measurement.split_rule import Split
    from hts.plugins import Registry
    from hts.recordings.recording import Recording

COMPARED = ("linear", "lstm")
"""Models that the best is chosen among, beside the objective's own, where nobody names any."""


def context_of(
    objective: Objective, recording: Recording, registry: Registry, physics_steps: int | None = None
) -> ModelContext:
    """Of a model that is fitted to recordings like this one: channels as it has them; physics_steps: None, as the
    training env of its robot keeps them, if that is installed and needs no settings."""
    if physics_steps is None:
        physics_steps = 0
        with suppress(HtsError):  # of a robot that is another one with settings nothing is known
            physics_steps = physics_steps_of(registry.make_robot(recording.robot))
    signals = recorded_signals(objective, recording)
    return ModelContext(signals, objective.measurement_model(), physics_steps=physics_steps)


@dataclass(frozen=True)
class Candidates:
    """Measurement models by choice, unfitted, for the channels of one recording."""

    objective: Objective
    settings: Settings
    registry: Registry
    like: Recording
    config: MeasurementConfig
    progress: Progress | None

    @property
    def how(self) -> FitSettings:
        return FitSettings(self.config.seed, self.config.epochs, self.config.max_seconds)

    def made(self, choice: Named) -> MeasurementModel:
        context = context_of(self.objective, self.like, self.registry)
        return self.registry.make_measurement_model(choice.name, choice.settings, context)

    def fitter(self, choice: Named) -> comparison.Fitter:
        def fit(training: Sequence[Recording]) -> comparison.Fitted:
            model = self.made(choice)
            report = fit_model(model, training, replace(self.how, progress=self.progress), self.registry)
            told = [f"{key} {report[key]:.3g}" for key in ("ridge", "pooling", "lag_seconds") if key in report]
            return comparison.Fitted(comparison.of_model(model), ", ".join(told))

        return fit


def compared(
    candidates: Candidates,
    parts: Split,
    models: Sequence[str],
    best: bool,
    spec: RobotSpec | None,
    say: Callable[[str], None],
) -> tuple[Named, list[comparison.Row], dict[str, float | None] | None]:
    """The model to keep, the rows of all others, and cross-validated R² where the best is wanted."""
    objective = candidates.objective
    target = objective.target.name
    own = chosen_model(objective, candidates.settings)
    names = dict.fromkeys((own.name, *models, *(COMPARED if best and not models else ())))
    choices = {name: own if name == own.name else Named(name=name) for name in names}
    for choice in choices.values():
        candidates.made(choice)  # a wrong name is one line before anything is spent
    training, held_out, _ = masked_split(parts.training, parts.held_out, (*objective.inputs, target), spec)
    fixed = comparison.references(target, stand_ins(objective, recorded_signals(objective, candidates.like)))
    fitters = {name: candidates.fitter(choice) for name, choice in choices.items()}
    tried = comparison.cross_validated({**fixed, **fitters}, target, training, say) if best else None
    kept = own
    if tried is not None:
        known = {name: r2 for name in choices if (r2 := tried[name]) is not None}
        if not known:
            raise RecordingError("Too little is left to cross-validate: leave --best out, or record more.")
        kept = choices[max(known, key=lambda name: known[name])]
    found = tried or {}
    rows = [
        comparison.row(name, "reference", fitter, target, training, held_out, found.get(name))
        for name, fitter in fixed.items()
    ]
    others = {name: fitter for name, fitter in fitters.items() if name != kept.name}
    if "linear" not in fitters:
        others["linear"] = candidates.fitter(Named(name="linear"))
    for name, fitter in others.items():
        say(f"fitting {name}, to compare")
        rows.append(comparison.row(name, "model", fitter, target, training, held_out, found.get(name)))
    return kept, rows, tried


def table_rows(report: Mapping[str, Any], rows: Sequence[comparison.Row]) -> list[dict[str, Any]]:
    """All rows, the kept model's among them; worst first, as the table is printed."""
    held, name = report["held_out"], report["model"]["name"]
    fit = report["fit"]
    told = ", ".join(f"{key} {fit[key]:.3g}" for key in ("ridge", "pooling", "lag_seconds") if key in fit)
    own = comparison.Row(
        name, "kept", held["r2"], held["r2_interval"], held["rmse"], (report["best_of"] or {}).get(name), told,
        float(fit.get("seconds", 0.0)),
    )  # fmt: skip
    references = [one for one in rows if one.kind == "reference"]
    models = [*(one for one in rows if one.kind == "model"), own]
    models = sorted(models, key=lambda one: one.r2 if one.r2 is not None else -1e9)
    return [vars(one) for one in (*references, *models)]
