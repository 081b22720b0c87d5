"""`hts fit`: one measurement model from a recording store, with its checks.

`OUT/model.safetensors` and `OUT/model.json` are the model, `OUT/fit.json` says what it was fitted to, how well it
predicts, and how well others do on the same split. `fit_and_check` is the core of it for callers that have the
recordings in hand, such as a run; what is printed is in `fit_report`.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hts.atomic import atomic_write
from hts.config import MeasurementConfig
from hts.contracts import MeasurementModel, chosen_model
from hts.errors import ConfigError, RecordingError, RunError, unknown_name
from hts.guarded import guarded
from hts.layers import in_full
from hts.measurement import files
from hts.measurement.alike import check_alike
from hts.measurement.candidates import Candidates, compared, context_of, table_rows
from hts.measurement.checks import check
from hts.measurement.data import recorded_signals
from hts.measurement.drift import drift
from hts.measurement.fit_settings import FitSettings
from hts.measurement.fitting import called, fit_model
from hts.measurement.outliers import masked_split
from hts.measurement.physics_steps import NEEDED
from hts.measurement.proxy import proxy_along
from hts.measurement.shared import Shared, shared_samples, told_of_copies, without_shared
from hts.measurement.split import of_fitted_sessions, split
from hts.measurement.split_rule import AUTOMATIC, TEST_STORE, Split, SplitRule, split_by
from hts.measurement.wanted import Wanted, without_objective
from hts.overrides import Override, nested, parsed
from hts.places import check_place
from hts.recordings.store import RecordingStore

if TYPE_CHECKING:
    from hts.contracts import Objective, RobotSpec, Settings
    from hts.contracts.measurement_model import Progress
    from hts.plugins import Registry
    from hts.recordings.recording import Recording


@dataclass
class FitResult:
    """A fitted model, and a report of plain JSON values."""

    model: MeasurementModel
    report: dict[str, Any] = field(default_factory=dict)


def new_model(
    objective: Objective,
    recording: Recording,
    settings: Settings | None = None,
    registry: Registry | None = None,
    physics_steps: int | None = None,
) -> MeasurementModel:
    """The objective's model, unfitted, for the channels as the recording has them.

    settings: what stands under `objectives.NAME`, of which `model` chooses;
    registry: None, everything that is installed; physics_steps: see `candidates.context_of`.
    """
    if registry is None:
        from hts import plugins

        registry = plugins.load()
    choice = chosen_model(objective, settings)
    context = context_of(objective, recording, registry, physics_steps)
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
    physics_steps: int | None = None,
) -> FitResult:
    """Split, fit on the larger part, check on the rest, and fit again to everything. The report is plain JSON values:

    model: name and settings; fit: see the model's `fit`; held_out: see `checks.check`; training: ids fitted to;
    held_out_r2, rank_correlation: the two numbers of `summary.json` (None where they mean nothing, such as the first
    with one recording); split: how it was split; same_session: how many of those held out
    are of sessions that were fitted to, too; masked: samples left out as no machine makes them, see `outliers`, the
    same ones in both fits, since a range is that of all these recordings together; drift: see `drift.Drift`, None where
    none can be seen;
    refit: the same as fit, of the model that is returned, which has seen what was held out too (None where
    `config.refit` says no).
    settings, registry, physics_steps: see `new_model`; keep: hashes of policies never held out whole.
    """
    config = config or MeasurementConfig()
    parts = Split(*split(recordings, config.held_out, config.seed, keep), AUTOMATIC)

    def fitting(turn: int) -> FitSettings:
        """Of the first or second fit; each has half of the progress."""

        def share(epoch: int, epochs: int, error: float) -> None:
            if progress is not None:
                progress(turn * epochs + epoch, 2 * epochs, error)

        report = share if config.refit else progress
        return FitSettings(config.seed, config.epochs, config.max_seconds, report, warm_start)

    model = new_model(objective, parts.training[0], settings, registry, physics_steps)
    checked = fit_split(objective, model, parts, fitting(0), registry=registry)
    if not config.refit:
        return FitResult(model, {**checked.report, "refit": None})
    model = new_model(objective, recordings[0], settings, registry, physics_steps)
    everything, _, _ = masked_split(recordings, (), (*objective.inputs, objective.target.name), None)
    return FitResult(model, {**checked.report, "refit": fit_model(model, everything, fitting(1), registry)})


def fit_split(
    objective: Objective,
    model: MeasurementModel,
    parts: Split,
    how: FitSettings,
    spec: RobotSpec | None = None,
    registry: Registry | None = None,
) -> FitResult:
    """Fit an unfitted model to one side of a split and check it on the other; see `fit_and_check`. spec: of the robot,
    whose limits tell what cannot be; None where it is not known. registry: for messages, which package a model is of.
    Raises PluginError for a model that fails."""
    channels = (*objective.inputs, objective.target.name)
    training, held_out, masked = masked_split(parts.training, parts.held_out, channels, spec)
    fitted = fit_model(model, training, how, registry)
    slow = drift([*training, *held_out], objective.target.name)
    checked = guarded(f"{called(model, registry)}: its check", partial(check, objective, model, held_out, training))
    report = {
        "objective": objective.name,
        "model": {"name": model.name, **model.settings},
        "target": objective.target.name,
        "inputs": list(objective.inputs),
        "held_out_r2": checked["r2"],
        "rank_correlation": checked["rank_correlation"],
        "held_out": checked,
        "training": [recording.id for recording in training],
        "split": parts.how,
        "same_session": {"held_out": of_fitted_sessions(parts.training, parts.held_out), "of": len(parts.held_out)},
        "masked": asdict(masked),
        "drift": None if slow is None else asdict(slow),
        "fit": fitted,
    }
    return FitResult(model, report)


@dataclass(frozen=True)
class FitChecks:
    """What a fit is held against.

    test: a store that is held out, in place of a part of the first one; split: how the first one is split;
    models: names of further models for the table; best: keep the one that cross-validation inside the training finds
    best, of those and the chosen one; keep_shared: fit also to samples that are held out at the same time.
    """

    test: Path | None = None
    split: SplitRule | None = None
    models: tuple[str, ...] = ()
    best: bool = False
    keep_shared: bool = False


def fit_store(
    objective_name: str | None,
    store_path: Path,
    out: Path,
    *,
    overrides: Sequence[str | Override] = (),
    progress: Progress | None = None,
    checks: FitChecks | None = None,
    wanted: Wanted | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Path:
    """Fit the objective's model to all recordings of a store that have its channels; returns the path of fit.json.

    overrides: KEY=VALUE, the key `measurement.…` or `objectives.NAME.…` as in a run's config; say: told what is being
    done. Recordings, those of the test store too, without one of the channels are left out and listed in fit.json
    under `left_out`.
    Raises RunError if `out` holds a fit already; RecordingError if nothing can be fitted, or where recordings are of
    several robots, rates, joints or units.
    """
    from hts import plugins

    checks, wanted = checks or FitChecks(), wanted or Wanted()
    name = wanted.name(objective_name)
    settings, registry = _settings(overrides, name), plugins.load()
    config = _measurement_config(settings["measurement"])
    _refuse_existing(Path(out))
    store = RecordingStore(store_path)
    objective: Objective = (
        without_objective(store, wanted)
        if objective_name is None
        else registry.make_objective(objective_name, settings["objectives"])
    )
    recordings, left_out = _usable(store, objective, wanted.robot)
    recorded_signals(objective, recordings[0])  # what is wrong with these two is told before anything is fitted
    proxy_along(objective, recordings[0])
    for line in told_of_copies(recordings, (*objective.inputs, objective.target.name)):
        say(f"note: {line}")
    dataset = store.dataset([one.id for one in recordings])
    parts, shared, untested = _split(objective, recordings, checks, config, wanted.robot)
    candidates = Candidates(objective, settings["objectives"], registry, parts.training[0], config, progress)
    robot = recordings[0].robot  # of all of them
    spec = registry.make_robot(robot).spec if robot in registry.robots else None
    choice, rows, tried = compared(candidates, parts, checks.models, checks.best, spec, say)
    say(f"fitting {choice.name}")
    how = replace(candidates.how, progress=progress)
    result = fit_split(objective, candidates.made(choice), parts, how, spec, registry)
    report = {
        **result.report,
        "shared": asdict(shared),
        "best_of": tried,
        "dataset": dataset.sha256,
        "left_out": {**untested, **left_out},
        "store": str(store_path),
        "test": None if checks.test is None else str(checks.test),
    }
    report["compared"] = table_rows(report, rows)
    first = recordings[0]
    notes = {
        "objective": objective.name,
        "dataset": dataset.sha256,
        "robot": first.robot,
        "joint_names": list(first.joint_names),
    }
    return _written(result.model, report, Path(out), notes)


# ------------------------------------------------------------------------------------------------- what is written

WRITTEN = ("fit.json", "model.json", "model.safetensors")


def _refuse_existing(out: Path) -> None:
    check_place(out, "--out DIR")
    for name in WRITTEN:
        if (out / name).exists():
            raise RunError(f"{out / name} exists: nothing is overwritten. Choose another folder with --out.")


def _written(model: MeasurementModel, report: Mapping[str, Any], out: Path, notes: Mapping[str, Any]) -> Path:
    """All files of the fit, or none of them; the path of fit.json. Raises RunError."""
    text = json.dumps(report, indent=2, allow_nan=False) + "\n"  # what cannot be text stops it before the first file
    try:
        files.save(model, out / "model", notes)
        return atomic_write(out / "fit.json", text)
    except OSError as error:
        for name in WRITTEN:
            with contextlib.suppress(OSError):  # why nothing was written matters more
                (out / name).unlink(missing_ok=True)
        raise RunError(f"{out}: cannot be written ({error.strerror}). Choose another folder with --out.") from error


# ------------------------------------------------------------------------------------------------- what is read


def _usable(store: RecordingStore, objective: Objective, robot: str | None) -> tuple[list[Recording], dict[str, str]]:
    """Recordings that have all channels, and what tells of the time between samples where they have it; why the others
    were left out. Raises RecordingError."""
    channels = (*objective.inputs, objective.target.name)
    usable, left_out = [], {}
    for recording_id in store.ids():
        attributes = store.attributes(recording_id)
        missing = [name for name in channels if name not in attributes["arrays"]]
        if robot is not None and attributes["robot"] != robot:
            left_out[recording_id] = f"is of robot '{attributes['robot']}'"
        elif missing:
            left_out[recording_id] = f"has no channel '{missing[0]}'"
        else:
            usable.append(recording_id)
    if not usable:
        why = f" Left out: {next(iter(left_out))} {next(iter(left_out.values()))}." if left_out else ""
        raise RecordingError(
            f"{store.path}: none of its {len(left_out)} recordings has all of {', '.join(channels)}.{why} "
            f"`hts data show` lists their channels; import logs that hold these."
        )
    asked = {i: [name for name in NEEDED if name in store.attributes(i)["arrays"]] for i in usable}
    return [store.read(i, tuple(dict.fromkeys((*channels, *asked[i])))) for i in usable], left_out


def _split(
    objective: Objective,
    recordings: Sequence[Recording],
    checks: FitChecks,
    config: MeasurementConfig,
    robot: str | None,
) -> tuple[Split, Shared, dict[str, str]]:
    """Who is fitted to and who is held out, whether they have samples in common, and why recordings of the test store
    were left out."""
    channels = (*objective.inputs, objective.target.name)
    untested: dict[str, str] = {}
    if checks.test is None:
        check_alike(recordings, channels)
        parts = split_by(checks.split, recordings, config.held_out, config.seed)
    else:
        if checks.split is not None:
            raise ConfigError("--test and --split both say what is held out: give one of them.")
        test, left_out = _usable(RecordingStore(checks.test), objective, robot)
        untested = {recording_id: f"of the {TEST_STORE}, {why}" for recording_id, why in left_out.items()}
        check_alike([*recordings, *test], channels)
        parts = Split(list(recordings), test, f"{TEST_STORE} {checks.test}")
    if checks.keep_shared:
        _, marked = shared_samples(parts.training, parts.held_out, channels)
        count = int(sum(one.sum() for one in marked))
        return parts, Shared(count, sum(one.num_samples for one in parts.held_out)), untested
    training, shared = without_shared(parts.training, parts.held_out, channels)
    if not training:
        raise RecordingError(
            "Everything that is to be fitted to is held out too: the same logs are on both sides. Import others, or "
            "split one store with --split chronological=0.7."
        )
    return replace(parts, training=training), shared, untested


# --------------------------------------------------------------------------------------------------- settings


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
