"""Algorithm 1 (arXiv 2502.10956), stage by stage. Killed anywhere, it goes on from the last finished stage.

Π_0 = {π_pretrained}
for i = 0, 1, 2, …
    roll out π ∈ Π_i in the real world, D_i ← all recordings so far    collect (i = 0), later the tests of i - 1
    f_i ← 𝒜(D_i)                                                       fit
    for π_anchor, w, c ∈ {π_best, π_pretrained} × W × C: fine-tune     finetune
    Π_{i+1} ← top K in simulation                                      simulate, gate
    π_best ← best of Π_{i+1} in the real world                         test
π_best against π_pretrained at every speed                             final, summary
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from hts.config import RunConfig
from hts.evaluation.final import task_entry
from hts.plugins import Registry
from hts.report import write_report
from hts.report.outcome import nobody_chosen
from hts.report.table import print_table
from hts.report.task_words import TaskWords
from hts.run.gate import gate, gate_refused
from hts.run.job import Job
from hts.run.learning import finetune, fit, simulate
from hts.run.progress import Progress
from hts.run.reality import collect, final
from hts.run.stages import Stages
from hts.run.summary import summarise
from hts.run.testing_elites import test

STAGES_PER_ITERATION = 4  # and the gate, where it is not switched off
STAGES_AROUND = 4  # collect, final, summary, report


def run(config: RunConfig, folder: Path, registry: Registry) -> Path:
    """Do what is not done yet of the run in `folder`; returns it. Raises RunError if another process works there."""
    each = STAGES_PER_ITERATION + config.gate.enabled
    progress = Progress(total=STAGES_AROUND + each * config.iterations)
    stages = Stages(folder, progress)
    job = Job(config, folder, registry, stages)
    try:
        summary = algorithm_1(job)
    finally:
        job.close()
        stages.close()
    print_table(summary, progress.console)
    progress.say(f"report: {folder / 'report.html'}")
    return folder


def algorithm_1(job: Job) -> dict[str, Any]:
    """The stages in the order of the paper; returns the summary."""
    config = job.config
    job.prepare()
    if config.records_first:
        job.do("collect", "collect real data of the pretrained policy", partial(collect, job))
    else:
        job.stages.progress.skip(1)
    best = "pretrained"
    for i in range(config.iterations):
        name = f"iterations/{i:02d}"
        about = f"iteration {i:02d} ({i + 1} of {config.iterations})"  # the number is that of its folder
        if config.reward_source == "model":
            job.do(f"{name}/fit", f"{about}: fit measurement models", partial(fit, job, i))
        else:
            job.stages.progress.skip(1)
        job.do(f"{name}/finetune", f"{about}: fine-tune candidates", partial(finetune, job, i, best))
        job.do(f"{name}/simulate", f"{about}: judge candidates in simulation", partial(simulate, job, i))
        if config.gate.enabled and not (job.folder / f"{name}/test.json").exists():  # of a run of before: none
            job.do(f"{name}/gate", f"{about}: try elites over varied dynamics", partial(gate, job, i))
        elif config.gate.enabled:
            job.stages.progress.skip(1)
        trying = f"{about}: try elites in world '{config.world.name}'"
        tested = job.do(f"{name}/test", trying, partial(test, job, i, best))
        if tested["best"] is None:
            rows = [tested["results"][one] for one in tested["elites"]]
            task = TaskWords(**task_entry(job.robot.task()))
            job.stages.progress.say(f"{about}: {nobody_chosen(rows, task, refused=gate_refused(job, i))}")
        best = tested["best_so_far"]
    job.do("final", f"final head-to-head in world '{config.world.name}'", partial(final, job, best))
    return finish(job)


def finish(job: Job) -> dict[str, Any]:
    """summary.json, then the report, which reads it."""
    result = job.do("summary", "summary", lambda report: summarise(job))
    if not (job.folder / "report.html").exists():
        with job.stages.progress.stage("report"):
            write_report(job.folder)
    return result
