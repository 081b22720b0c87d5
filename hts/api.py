"""The commands from Python: `run`, `fit`, `evaluate`, `load` for what a run left behind, `robot` for a robot by name.

    from hts import api

    folder = api.run("OBJECTIVE", robot="ROBOT", preset="smoke", out="runs/first")
    print(api.load(folder).summary["final"])

Every function raises the errors of `hts.errors`, whose text is what the command line prints.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hts.overrides import Override
from hts.places import PRETRAINING, existing_run

if TYPE_CHECKING:
    from hts.config import RunConfig
    from hts.contracts import Robot
    from hts.policies.files import Policy


def run(
    objectives: str | Sequence[str],
    robot: str,
    *,
    out: Path | str,
    preset: str | None = None,
    world: str | None = None,
    engine: str | None = None,
    seed: int | None = None,
    config: Path | str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Path:
    """Algorithm 1 into the new folder `out`; returns it. Like `hts run`.

    objectives: one name or several; config: a YAML file; settings: dotted key -> value, as --set takes them.

        api.run("OBJECTIVE", "ROBOT", out="runs/first", preset="smoke", settings={"finetune.num_envs": 16})

    A run that was interrupted goes on with `resume(folder)`.
    """
    from hts.config_loading import load_config
    from hts.plugins import load as load_plugins
    from hts.run import start_run

    names = [objectives] if isinstance(objectives, str) else list(objectives)
    overrides = _overrides(settings)
    registry = load_plugins()
    resolved = load_config(
        preset=preset,
        file=Path(config) if config else None,
        objectives=names,
        robot=robot,
        world=world,
        engine=engine,
        seed=seed,
        overrides=overrides,
        registry=registry,
    )
    return start_run(resolved, Path(out), registry=registry)


def resume(folder: Path | str) -> Path:
    """Go on with a run where it stopped; returns its folder, or of a pretraining its policy. Like `hts resume`.

    For example `api.resume("runs/first")`.
    """
    from hts.config_loading import read_config

    if (Path(folder) / PRETRAINING).is_file():
        from hts.training.pretrain import resume_pretraining

        return resume_pretraining(Path(folder))
    place = existing_run(Path(folder))
    if read_config(place / "config.yaml").reward_source == "oracle":
        from hts.oracle import resume_oracle

        return resume_oracle(place)
    from hts.run import resume_run

    return resume_run(place)


def fit(
    objective: str,
    data: Path | str,
    out: Path | str,
    settings: Mapping[str, Any] | None = None,
    *,
    test: Path | str | None = None,
    split: str | None = None,
    models: Sequence[str] = (),
    best: bool = False,
) -> dict[str, Any]:
    """Fit one measurement model to a recording store; returns what OUT/fit.json holds. Like `hts fit`.

    test: a store that is held out; split: how the first one is split otherwise, such as "chronological=0.7"; models:
    others to put beside it; best: keep the best by cross-validation inside what is fitted to.

    For example `api.fit("OBJECTIVE", "walks.zarr", "fits/first", {"measurement.epochs": 40})["held_out_r2"]`.
    """
    from hts.measurement.fit_command import FitChecks, fit_store
    from hts.measurement.split_rule import SplitRule

    overrides = _overrides(settings)
    checks = FitChecks(
        test=None if test is None else Path(test),
        split=None if split is None else SplitRule.parsed(split),
        models=tuple(models),
        best=best,
    )
    written = fit_store(objective, Path(data), Path(out), overrides=overrides, checks=checks)
    return json.loads(written.read_text(encoding="utf-8"))


def evaluate(
    folder: Path | str,
    speeds: Sequence[float] | None = None,
    *,
    policy: str | Path = "best",
    world: str | None = None,
    seed: int | None = None,
    sessions: int | None = None,
    settings: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Head-to-head of a run's policy against its pretrained one; returns what evaluation.json holds.
    Like `hts evaluate`.

    settings: dotted key of `evaluation.` or `world.` -> value, laid over the run's for this once, as --set takes them.
    What is to be known of the recordings, such as that a log ends early, goes to stderr, a line each.

    For example `api.evaluate("runs/first", [0.8])["objectives"]["OBJECTIVE"]["speeds"]["0.8"]["improvement"]`.
    """
    from hts.config_loading import read_config
    from hts.evaluation.evaluate import evaluate_run
    from hts.plugins import load as load_plugins
    from hts.run.provenance import TO_EVALUATE, check_config

    run_folder, registry = existing_run(Path(folder)), load_plugins()
    check_config(run_folder, read_config(run_folder / "config.yaml"), registry, TO_EVALUATE)
    return evaluate_run(
        run_folder,
        speeds=speeds,
        policy=policy,
        world=world,
        seed=seed,
        registry=registry,
        sessions=sessions,
        overrides=_overrides(settings),
        say=lambda line: print(line, file=sys.stderr),
    )


def robot(name: str, settings: Mapping[str, Any] | None = None) -> Robot:
    """An installed robot: its numbers (`spec`), its env (`make_env`) and its starting policy (`pretrained_policy`).

    settings: its own, by key. Raises ConfigError with the names there are, or with what is wrong in its settings.

        api.robot("ROBOT").make_env("mujoco", num_candidates=1, num_envs=32, config=EnvConfig())
    """
    from hts.plugins import load as load_plugins

    return load_plugins().make_robot(name, settings or {})


@dataclass(frozen=True)
class Run:
    """What a run left behind.

    folder: where it lies; config: as it was resolved; summary: what `summary.json` holds, None if it is not finished.
    """

    folder: Path
    config: RunConfig
    summary: dict[str, Any] | None

    def policy(self, name: str = "best") -> Policy:
        """Tensors and card of "best", "pretrained" or a candidate. Raises PolicyError with the names there are."""
        from hts.policies.export_command import find_policy
        from hts.policies.files import load_policy

        return load_policy(find_policy(self.folder, name))


def load(folder: Path | str) -> Run:
    """A run, finished or not. Raises RunError where there is none, or a summary.json that no run wrote.

    For example `api.load("runs/first").policy("best").card.policy_hash`.
    """
    from hts.config_loading import read_config
    from hts.report.data import read_summary

    place = existing_run(Path(folder))
    return Run(place, read_config(place / "config.yaml"), read_summary(place) or None)


def _overrides(settings: Mapping[str, Any] | None) -> list[Override]:
    return [Override.of(key, value) for key, value in (settings or {}).items()]
