"""`hts fit`: one measurement model from a recording store, with its checks.

`OUT/model.safetensors` and `OUT/model.json` are the model, `OUT/fit.json` says what it was fitted to and how well it
predicts. `fit_and_check` is the same thing for callers that have the recordings in hand, such as a run.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hts.atomic import atomic_write
from hts.config import MeasurementConfig
from hts.contracts import MeasurementModel, ModelContext, chosen_model
from hts.errors import ConfigError, RecordingError, RunError, unknown_name
from hts.layers import in_full
from hts.measurement import files
from hts.measurement.checks import check
from hts.measurement.data import recorded_signals
from hts.measurement.split import split
from hts.overrides import Override, nested, parsed

if TYPE_CHECKING:
    from hts.contracts import Objective, Settings
    from hts.contracts.measurement_model import Progress
    from hts.plugins import Registry
    from hts.recordings.recording import Recording

WORSE_THAN_LINEAR = 0.1
"""By so much less variance explained a model is not worth its training."""
POOR_SPREAD = 2.0
"""Errors that are more than so many times as large as a model says are worth a line."""


@dataclass
class FitResult:
    """A fitted model, and a report of plain JSON values."""

    model: MeasurementModel
    report: dict[str, Any] = field(default_factory=dict)


def new_model(
    objective: Objective, recording: Recording, settings: Settings | None = None, registry: Registry | None = None
) -> MeasurementModel:
    """The objective's model, unfitted, for the channels as the recording has them.

    settings: what stands under `objectives.NAME`, of which `model` chooses;
    registry: None, everything that is installed.
    """
    if registry is None:
        from hts import plugins

        registry = plugins.load()
    choice = chosen_model(objective, settings)
    context = ModelContext(recorded_signals(objective, recording), objective.measurement_model())
    return registry.make_measurement_model(choice.name, choice.settings, context)


def fit_and_check(
    objective: Objective,
    recordings: Sequence[Recording],
    config: MeasurementConfig | None = None,
    *,
    settings: Settings | None = None,
    registry: Registry | None = None,
    keep: Collection[str] = (),
    warm_start: MeasurementModel | None = None,
    progress: Progress | None = None,
) -> FitResult:
    """Split, fit on the larger part, check on the rest. The report is plain JSON values:

    model: name and settings; fit: see the model's `fit`; held_out: see `checks.check`; training: ids fitted to;
    held_out_r2, rank_correlation: the two numbers of `summary.json` (None where they mean nothing, such as the first
    with one recording).
    settings, registry: see `new_model`; keep: hashes of policies never held out whole.
    """
    config = config or MeasurementConfig()
    training, held_out = split(recordings, config.held_out, config.seed, keep)
    model = new_model(objective, training[0], settings, registry)
    fitted = model.fit(
        training,
        seed=config.seed,
        epochs=config.epochs,
        max_seconds=config.max_seconds,
        warm_start=warm_start,
        progress=progress,
    )
    checked = check(objective, model, held_out, training)
    report = {
        "objective": objective.name,
        "model": {"name": model.name, **model.settings},
        "target": objective.target.name,
        "inputs": list(objective.inputs),
        "held_out_r2": checked["r2"],
        "rank_correlation": checked["rank_correlation"],
        "held_out": checked,
        "training": [recording.id for recording in training],
        "fit": fitted,
    }
    return FitResult(model, report)


def fit_store(
    objective_name: str,
    store_path: Path,
    out: Path,
    *,
    overrides: Sequence[str | Override] = (),
    progress: Progress | None = None,
) -> Path:
    """Fit the objective's model to all recordings of a store that have its channels; returns the path of fit.json.

    overrides: KEY=VALUE, the key `measurement.…` or `objectives.NAME.…` as in a run's config.
    Recordings without one of the channels are left out and listed in fit.json under `left_out`.
    Raises RunError if `out` holds a fit already; RecordingError if nothing can be fitted.
    """
    from hts import plugins
    from hts.recordings.store import RecordingStore

    settings = _settings(overrides, objective_name)
    registry = plugins.load()
    objective = registry.make_objective(objective_name, settings["objectives"])
    config = _measurement_config(settings["measurement"])
    report_file = Path(out) / "fit.json"
    if report_file.exists():
        raise RunError(f"{report_file} exists: nothing is overwritten. Choose another folder with --out.")
    store = RecordingStore(store_path)
    wanted = (*objective.inputs, objective.target.name)
    usable, left_out = [], {}
    for recording_id in store.ids():
        missing = [name for name in wanted if name not in store.attributes(recording_id)["arrays"]]
        if missing:
            left_out[recording_id] = f"has no channel '{missing[0]}'"
        else:
            usable.append(recording_id)
    if not usable:
        raise RecordingError(
            f"{store_path}: none of its {len(left_out)} recordings has all of {', '.join(wanted)}. "
            f"`hts data show` lists their channels; import logs that hold these."
        )
    dataset = store.dataset(usable)
    recordings = [store.read(i, wanted) for i in usable]
    result = fit_and_check(
        objective, recordings, config, settings=settings["objectives"], registry=registry, progress=progress
    )
    report = {**result.report, "dataset": dataset.sha256, "left_out": left_out, "store": str(store_path)}
    try:
        files.save(result.model, Path(out) / "model", {"objective": objective.name, "dataset": dataset.sha256})
        atomic_write(report_file, json.dumps(report, indent=2, allow_nan=False) + "\n")
    except OSError as error:
        raise RunError(f"{out}: cannot be written ({error.strerror}). Choose another folder with --out.") from error
    return report_file


def summary_line(report: Mapping[str, Any]) -> str:
    """One line for a person, from the report of `fit_and_check`."""
    held = report["held_out"]
    if not held["recordings"]:
        return (
            f"{report['target']}: fitted to one recording, so none was held out and nothing is known of how well it "
            "predicts. Import two at least."
        )
    proxy = (held["proxy"] or {}).get("smoothed")
    linear = held.get("linear")
    against = f", linear {_number(linear['r2'])}" if linear else ""
    against += f", analytic stand-in {_number(proxy['r2'])}" if proxy else ""
    return (
        f"{report['target']}: R² {_number(report['held_out_r2'])} on {len(held['recordings'])} held-out "
        f"recordings{against}; rank correlation across {len(held['policies'])} policies "
        f"{_number(report['rank_correlation'])}"
    )


def doubts(report: Mapping[str, Any]) -> list[str]:
    """What a person should know before a model is trusted, one line each; empty where nothing is wrong.

    report: that of `fit_and_check`.
    """
    held, target = report["held_out"], report["target"]
    found, linear = held["r2"], (held.get("linear") or {}).get("r2")
    lines = []
    if found is not None and found < 0:
        lines.append(
            f"{target}: held-out R² {_number(found)} is below 0: the mean of the data predicts better. Either the "
            "inputs do not explain it, or it remembers more than about a second (a temperature does): make a target of "
            "the loss that heats instead, or record more."
        )
    elif found is not None and linear is not None and linear - found >= WORSE_THAN_LINEAR:
        lines.append(
            f"{target}: held-out R² {_number(found)} is {_number(linear - found)} below that of `linear`, "
            f"{_number(linear)}. Choose it, --set objectives.{report['objective']}.model=linear, or record more."
        )
    spread = held.get("spread") or {}
    times = spread.get("error_over_spread")
    if times is not None and times > POOR_SPREAD:
        lines.append(
            f"{target}: the model's doubt is too small: {spread['within_1']:.2f} of its errors lie within one of its "
            f"standard deviations (of a Gaussian 0.68), and they are {times:.1f} times as large as it says."
        )
    return lines


def _number(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:.3f}"


def _settings(overrides: Sequence[str | Override], objective_name: str) -> dict[str, dict[str, Any]]:
    """{"measurement": {...}, "objectives": settings of this objective} from KEY=VALUE texts."""
    sets = parsed(overrides)
    for one in sets:
        if one.path[0] not in ("measurement", "objectives") or len(one.path) < 2:
            raise ConfigError(
                f"{one.text}: expected measurement.KEY=VALUE or objectives.{objective_name}.KEY=VALUE, "
                "e.g. --set measurement.epochs=40"
            )
        if one.path[0] == "objectives" and one.path[1] != objective_name:
            raise ConfigError(f"{one.text}: " + unknown_name("objective of this fit", one.path[1], [objective_name]))
    found = nested(sets, in_full)
    return {
        "measurement": found.get("measurement", {}),
        "objectives": found.get("objectives", {}).get(objective_name, {}),
    }


def _measurement_config(values: Mapping[str, Any]) -> MeasurementConfig:
    from hts.config_loading import section_of

    def origin(location: tuple[int | str, ...]) -> str:
        return "--set measurement." + ".".join(str(step) for step in location)

    return section_of(MeasurementConfig, values, origin)
