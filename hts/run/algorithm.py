"""Algorithm 1 (arXiv 2502.10956), stage by stage. Killed anywhere, it goes on from the last finished stage.

    Π_0 = {π_pretrained}
    for i = 0, 1, 2, …
        roll out π ∈ Π_i in the real world, D_i ← all recordings so far    collect (i = 0), later the tests of i - 1
        f_i ← 𝒜(D_i)                                                       fit
        for π_anchor, w, c ∈ {π_best, π_pretrained} × W × C: fine-tune     finetune
        Π_{i+1} ← top K in simulation                                      simulate
        π_best ← best of Π_{i+1} in the real world                         test
    π_best against π_pretrained at every speed                             final, summary
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hts.config import RunConfig
from hts.config_loading import check_names, dump_config, read_config
from hts.errors import RunError
from hts.plugins import load
from hts.report import write_report
from hts.report.table import print_table
from hts.run.job import Job
from hts.run.learning import finetune, fit, simulate
from hts.run.progress import Progress
from hts.run.reality import collect, final, test
from hts.run.stages import Stages
from hts.run.summary import summarise

STAGES_PER_ITERATION = 4


def start_run(config: RunConfig, out: Path, *, dry_run: bool = False) -> Path:
    """Run into the new folder `out`; returns it. dry_run: only say what it would cost.

    Raises RunError if the folder holds something already; nothing is ever overwritten.
    """
    registry = load()
    check_names(config, registry)
    if dry_run:
        from hts.run.cost import estimate, print_estimate

        print_estimate(estimate(config, registry))
        return out
    out = Path(out)
    if out.exists() and any(out.iterdir()):
        raise RunError(f"{out}: is not empty. Go on with `hts resume {out}`, or choose another --out.")
    out.mkdir(parents=True, exist_ok=True)
    temporary = out / ".config.yaml.tmp"
    temporary.write_text(dump_config(config))
    temporary.replace(out / "config.yaml")
    return _run(config, out)


def resume_run(folder: Path) -> Path:
    """Go on where a run stopped; a finished run only prints its table again."""
    return _run(read_config(Path(folder) / "config.yaml"), Path(folder))


def _run(config: RunConfig, folder: Path) -> Path:
    progress = Progress(total=5 + STAGES_PER_ITERATION * config.iterations)
    stages = Stages(folder, progress)
    job = Job(config, folder, load(), stages)
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
    if config.reward_source == "model":
        job.do("collect", "collect real data of the pretrained policy", lambda report: collect(job, report))
    else:
        job.stages.progress.skip(1)
    best = "pretrained"
    for i in range(config.iterations):
        name = f"iterations/{i:02d}"
        about = f"iteration {i + 1} of {config.iterations}"
        if config.reward_source == "model":
            job.do(f"{name}/fit", f"{about}: fit measurement models", lambda report, i=i: fit(job, i, report))
        else:
            job.stages.progress.skip(1)
        job.do(f"{name}/finetune", f"{about}: fine-tune candidates", lambda report, i=i, b=best: finetune(job, i, b, report))
        job.do(f"{name}/simulate", f"{about}: judge candidates in simulation", lambda report, i=i: simulate(job, i, report))
        tested = job.do(f"{name}/test", f"{about}: try elites in world '{config.world.name}'", lambda report, i=i, b=best: test(job, i, b, report))
        best = tested["best_so_far"]
    job.do("final", f"final head-to-head in world '{config.world.name}'", lambda report: final(job, best, report))
    return finish(job)


def finish(job: Job) -> dict[str, Any]:
    """summary.json, then the report, which reads it."""
    result = job.do("summary", "summary", lambda report: summarise(job))
    if not (job.folder / "report.html").exists():
        with job.stages.progress.stage("report"):
            write_report(job.folder)
    return result
