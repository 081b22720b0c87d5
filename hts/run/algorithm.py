"""Algorithm 1 (arXiv 2502.10956), stage by stage. Killed anywhere, it goes on from the last finished stage.

Π_0 = {π_pretrained}
for i = 0, 1, 2, …
    roll out π ∈ Π_i in the real world, D_i ← all recordings so far    collect (i = 0), later the tests of i - 1
    f_i ← 𝒜(D_i)                                                       fit
    for π_anchor, w, c ∈ {π_best, π_pretrained} × W × C: fine-tune     finetune
    Π_{i+1} ← top K in simulation                                      simulate, gate, nearer
    π_best ← best of Π_{i+1} in the real world                         test
the best few of all iterations once more                               confirm (not in the paper)
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
from hts.run.belonging import check_confirmed, check_final, check_fitted, check_iteration, check_summary
from hts.run.confirming import confirm, finalists
from hts.run.finals import final
from hts.run.gate import gate
from hts.run.iteration import gate_refused
from hts.run.job import Job
from hts.run.judging import simulate
from hts.run.learning import finetune, fit
from hts.run.nearer import is_due, may_go_nearer, nearer
from hts.run.passed_over import passed_over
from hts.run.progress import Progress
from hts.run.provenance import check_config
from hts.run.reality import best_so_far, collect
from hts.run.stage_files import has_gate, read_stage
from hts.run.stages import ENDED_EARLY, Stages, write_json
from hts.run.summary import summarise
from hts.run.testing_elites import test


def stages_around(config: RunConfig) -> int:
    """Final, summary, report; and what this configuration has of collect and confirm."""
    return 3 + config.records_first + bool(config.selection.confirm)


def stages_per_iteration(config: RunConfig) -> int:
    """Fine-tune, judge, test; and what this configuration has of the others. `nearer` may turn out not to be due."""
    return 3 + config.fits_models + config.evaluation.each_iteration + config.gate.enabled + may_go_nearer(config)


def run(config: RunConfig, folder: Path, registry: Registry, kind: type[Job] = Job) -> Path:
    """Do what is not done yet of the run in `folder`, and say so where nothing was; returns the folder. Raises RunError
    if another process works there.

    kind: what its stages work with; an oracle's is another one.
    """
    progress = Progress(total=stages_around(config) + stages_per_iteration(config) * config.iterations)
    stages = Stages(folder, progress, read_stage)
    try:
        check_config(folder, config, registry)  # before anything is made of what it says
        job = kind(config, folder, registry, stages)
        try:
            summary = algorithm_1(job)
        except Exception as error:
            stages.check_there(error)
            raise
        finally:
            job.close()
    finally:
        stages.close()
    if not progress.begun:
        progress.say(f"{folder}: this run was finished already, nothing was left to do. Its result again:")
    print_table(summary, progress.console)
    progress.say(f"report: {folder / 'report.html'}")
    return folder


def algorithm_1(job: Job) -> dict[str, Any]:
    """The stages in the order of the paper; returns the summary."""
    config = job.config
    job.prepare()
    if config.records_first:
        job.do("collect", "collect real data of the pretrained policy", partial(collect, job))
    best = job.first
    for i in range(config.iterations):
        name = f"iterations/{i:02d}"
        if not goes_on(job, i):
            job.say(cap_reached(job, i))
            job.stages.progress.leave_out(stages_per_iteration(config) * (config.iterations - i))
            break
        about = f"iteration {i:02d} ({i + 1} of {config.iterations})"  # the number is that of its folder
        if config.fits_models:
            job.do(f"{name}/fit", f"{about}: fit measurement models", partial(fit, job, i))
            check_fitted(job, i)
        job.do(f"{name}/finetune", f"{about}: fine-tune candidates", partial(finetune, job, i, best))
        job.do(f"{name}/simulate", f"{about}: judge candidates in simulation", partial(simulate, job, i))
        check_iteration(job, i)
        if has_gate(config, job.folder / name):
            job.do(f"{name}/gate", f"{about}: try elites over varied dynamics", partial(gate, job, i))
        elif config.gate.enabled:
            job.stages.progress.leave_out(1)
        if may_go_nearer(config):
            if is_due(job, i) or (job.folder / name / "nearer.json").exists():
                title = f"{about}: judge candidates closer to their anchors"
                job.do(f"{name}/nearer", title, partial(nearer, job, i, best))
            else:
                job.stages.progress.leave_out(1)
        trying = f"{about}: try elites in world '{config.world.name}'"
        tested = job.do(f"{name}/test", trying, partial(test, job, i, best))
        if tested["best"] is None:
            rows = [tested["results"][one] for one in tested["elites"]]
            task = TaskWords(**task_entry(job.robot.task()))
            why = nobody_chosen(rows, task, gate_refused(job, i), passed_over(job, i))
            job.say(f"{about}: {why}")
        best = tested["best_so_far"]
        if config.evaluation.each_iteration:
            job.do(f"{name}/best", f"{about}: measure the best so far", partial(best_so_far, job, i, best))
    if config.selection.confirm:
        best = job.do("confirm", "try the best of all iterations again", partial(confirm, job, best))["best"]
        check_confirmed(job)
    about = f"final head-to-head in world '{config.world.name}'"
    job.do("final", about, partial(final, job, finalists(job, best)))
    check_final(job)
    return finish(job)


def goes_on(job: Job, iteration: int) -> bool:
    """Whether real samples are left for an iteration; keeps ENDED_EARLY as it is to be.

    Where a run went on to its final from here already it stays ended: earlier versions planned no test again.
    """
    path, ended = job.folder / ENDED_EARLY, {"done": iteration, "of": job.config.iterations}
    here = path.exists() and read_stage(path) == ended
    final = any((job.folder / f"{stage}.json").exists() for stage in ("confirm", "final"))
    on = not (here and final) and job.elites(iteration) > 0
    if not on and not here:  # else nothing is to be written, as on a read-only medium
        write_json(path, ended)
    if on and here:
        path.unlink()
    return on


def cap_reached(job: Job, iteration: int) -> str:
    """Why the iterations end here, in one line."""
    spent, most = job.spent(iteration), job.config.max_real_samples
    assert most is not None  # else they end with the last one
    why = f"and the test of another elite takes about {job.budget.each:,}"
    if spent + job.budget.each <= most:
        why = f"less than was planned for {sum(job.budget.elites)} tests of elites, and the plan has no more of them"
    return (
        f"{iteration} of {job.config.iterations} iterations: {spent:,} of at most {most:,} real samples are spent, "
        f"{why}. What follows is the final head-to-head, which is not counted."
    )


def finish(job: Job) -> dict[str, Any]:
    """summary.json, then the report, which reads it."""
    result = job.do("summary", "summary", lambda report: summarise(job))
    check_summary(job)
    if not (job.folder / "report.html").exists():
        with job.stages.progress.stage("report"):
            write_report(job.folder)
    return result
