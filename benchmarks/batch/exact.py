"""Candidates of one iteration, judged in simulation by the reality's instruments: methods compared with less chance.

A whole run ends at a figure that one trained policy, its trials and its trims decide; two seeds of one method differ by
several points. Here a run is made as ever until an iteration's candidates are trained. Then the exact measurement takes
the place of whatever paid, as in `hts oracle --in-simulation`, and says what each of them saves at held speed in the
simulated worlds of the run's own judging. It sees inside, so nothing of it may choose what a run does; the same seed is
the same random numbers for every method. What a candidate loses in reality, and what later iterations make of it, it
does not say.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from batch.exact_lines import Exact, ExactLine, Judged, read_exact
from batch.lines import RunLine
from batch.methods import ORACLE, digest
from batch.methods import Job as BatchJob
from batch.queue import GRACE_SECONDS, HTS, Kind, dying_with_this
from hts import plugins
from hts.atomic import atomic_write
from hts.config import RunConfig
from hts.config_loading import load_config, read_config
from hts.errors import ConfigError, RunError
from hts.evaluation.final import speed_key
from hts.measurement import files
from hts.oracle.in_simulation import SimulatedOracleJob
from hts.run.judging import judge
from hts.run.learning import fit_one
from hts.run.progress import Progress
from hts.run.reality import collect
from hts.run.stages import Stages, read_json
from hts.worlds.oracle.simulated import Seeing, check_exact

RESULT = "exact.json"  # in a run's folder
POLL_SECONDS = 0.2


def program(iteration: int) -> tuple[str, ...]:
    """What `run_batch` calls for each run."""
    return (sys.executable, str(Path(__file__).parents[1] / "exact_candidates.py"), str(iteration))


def jobs_until(jobs: Sequence[BatchJob], iteration: int) -> list[BatchJob]:
    """The same runs as far as an iteration's candidates: other keys, so other lines and folders than whole runs."""
    return [replace(job, method_hash=digest([job.method_hash, "candidates", iteration])) for job in jobs]


def check(jobs: Sequence[BatchJob], iteration: int) -> None:
    """Raise what would end one of these runs after it was trained: ConfigError for an iteration that it does not have,
    UnfitWorldError for an objective that no instrument of its reality measures exactly."""
    registry = plugins.load()
    for job in {(one.method_hash, one.reality_hash): one for one in jobs}.values():
        config = _config_of(job, registry)
        if not 0 <= iteration < config.iterations:
            raise ConfigError(
                f"--iteration {iteration}: method '{job.method}' has {config.iterations} of them, 0 to "
                f"{config.iterations - 1}. Ask for one of these."
            )
        robot = registry.make_robot(config.robot.name, config.robot.settings)
        objectives = {name: registry.make_objective(name, given) for name, given in config.objectives.items()}
        check_exact(Seeing.of(robot, config.world.settings, config.objectives, registry), objectives)


def _config_of(job: BatchJob, registry: plugins.Registry) -> RunConfig:
    command, *options = job.arguments  # each has a value

    def given(name: str) -> list[str]:
        return [value for option, value in zip(options[::2], options[1::2], strict=True) if option == name]

    return load_config(
        preset=given("--preset")[0],
        objectives=given("--objective"),
        robot=given("--robot")[0],
        world=given("--world")[0],
        engine=next(iter(given("--engine")), None),
        baseline=command == "baseline",
        oracle=command == ORACLE,
        overrides=given("--set"),
        registry=registry,
    )


def kind(iteration: int) -> Kind:
    """What a batch keeps of them."""
    return Kind(
        lambda folder: (folder / RESULT).exists(), lambda folder: _read(folder, iteration), read_exact, ExactLine, _said
    )


def make(iteration: int, arguments: Sequence[str], hts: Sequence[str] = HTS) -> int:
    """Make or go on with the run that `arguments` of `hts` say, the folder last, until that iteration's candidates are
    trained; then judge them. Exit status: that of a run which ended before."""
    folder = Path(arguments[-1])
    stage = folder / f"iterations/{iteration:02d}/finetune.json"
    if not stage.exists():
        status = _until(stage, [*hts, *arguments])
        if not stage.exists():
            if status == 0:
                print(f"error: {folder.name} ended before iteration {iteration}. Ask for an earlier one.")
            return status or 1
    found = judged(folder, iteration)
    atomic_write(folder / RESULT, found.model_dump_json(indent=1) + "\n")
    return 0


def _until(stage: Path, command: Sequence[str]) -> int:
    """Run it until the file of a stage is there, then stop it: a run may be stopped anywhere."""
    process = subprocess.Popen(command, preexec_fn=dying_with_this())  # noqa: PLW1509 - no other thread here
    while process.poll() is None and not stage.exists():
        time.sleep(POLL_SECONDS)
    process.terminate()
    try:
        return process.wait(GRACE_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


def judged(folder: Path, iteration: int) -> Exact:
    """What the reality's instruments say of an iteration's candidates. Raises RunError for a folder without them, and
    UnfitWorldError where the world has no exact instruments."""
    registry = plugins.load()
    config = read_config(folder / "config.yaml").model_copy(update={"reward_source": "model"})
    stages = Stages(folder, Progress(total=1))
    job = SimulatedOracleJob(config, folder, registry, stages)
    begun = time.perf_counter()
    try:
        check_exact(Seeing.of(job.robot, config.world.settings, config.objectives, registry), job.objectives)
        tuned = job.read("finetune", iteration)
        job.do("collect", "collect real data of the pretrained policy", partial(collect, job))  # not each run does
        _fit_what_is_missing(job, iteration)
        found = judge(job, iteration, tuned, tuned["candidates"])
    finally:
        job.close()
        stages.close()
    return Exact(
        iteration=iteration,
        units={name: objective.unit for name, objective in job.objectives.items()},
        speeds=list(config.simulation_test.speeds),
        needed=config.evaluation.min_valid,
        candidates=[_judged(row, found) for row in tuned["candidates"]],
        pull=(tuned.get("pull") or {}).get("pull"),
        seconds={**stages.seconds(), "exact": round(time.perf_counter() - begun, 3)},
    )


def _judged(row: Mapping[str, Any], found: Mapping[str, Any]) -> Judged:
    name = row["id"]
    return Judged(
        id=name,
        share=row.get("share", 1.0),
        stopped=row["stopped"],
        weights=row["weights"],
        kl_bound=row["kl_bound"],
        kl=row["kl"],
        falls=found["falls"][name],
        saved={
            objective: {speed: one["improvement"] for speed, one in speeds.items()}
            for objective, speeds in found["predicted"].get(name, {}).items()
        },
        valid={speed_key(trial["speed"]): trial["valid"] for trial in found["trials"][name]},
    )


def _fit_what_is_missing(job: SimulatedOracleJob, iteration: int) -> None:
    """A run that is paid by a formula has no models; the exact measurement takes the scale of one."""
    recordings = job.recordings(job.known(iteration))
    for name in job.objectives:
        path = job.model_path(iteration, name)
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            files.save(fit_one(job, name, recordings).model, path, {"iteration": iteration})


def _read(folder: Path, iteration: int) -> Exact:
    found = Exact.model_validate(read_json(folder / RESULT))
    if found.iteration != iteration:
        raise RunError(f"{folder}: its {RESULT} is of iteration {found.iteration}, expected {iteration}. Delete it.")
    return found


def _said(line: RunLine) -> str:
    assert isinstance(line, ExactLine) and line.result is not None
    saved = {one.id: one.saved for one in line.result.ends}
    return f"{line.seconds_here:.0f} s, {json.dumps(saved)}"
