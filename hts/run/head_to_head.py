"""A policy and the pretrained one walk in turns at every speed: the final, and the best so far after an iteration.

And what a run says that ends because the pretrained one cannot be judged.
"""

from __future__ import annotations

from collections.abc import Sequence

from hts.contracts import HoldSpeed, World
from hts.evaluation.asked import asked, complete
from hts.evaluation.final import speeds_missed
from hts.evaluation.held import NotComparable, ask_to_hold
from hts.evaluation.walked_again import walked_again
from hts.policy_ids import PRETRAINED
from hts.recordings.recording import Recording
from hts.run.job import Job


def held_head_to_head(job: Job, policy: str, hold: HoldSpeed) -> tuple[list[Recording], list[Recording]]:
    """With the speed held; and what was recorded in vain, see `walked_again`. The world goes on holding as it did last.

    policy: name that it was exported by.
    """
    config, task, objective = job.config.evaluation, job.robot.task(), next(iter(job.objectives.values()))

    def missed(recordings: Sequence[Recording]) -> list[float]:
        return speeds_missed(objective, recordings, config, job.seed("interval", "final"), task)

    def ask(hold: HoldSpeed, speeds: Sequence[float] = ()) -> list[Recording]:
        ask_to_hold(job.world, hold)
        return head_to_head(job, policy, speeds)

    return walked_again(ask(hold), hold, config.trims_again, missed, ask)


def head_to_head(job: Job, policy: str, speeds: Sequence[float] = ()) -> list[Recording]:
    """As the world does it now, in as many sessions as the final has.

    policy: name that it was exported by; speeds: none, all.
    """
    config = job.config.evaluation
    speeds, pair = speeds or config.speeds, (job.exported(policy), job.exported(PRETRAINED))
    if config.sessions > 1:
        found = asked(job.world, "head_to_head_sessions", *pair, speeds, config.sessions)
        if found is not None:
            return complete(job.world, "head_to_head_sessions", found, speeds, job.check_recordings)
        job.say(f"World '{job.config.world.name}' makes a head-to-head once: one session, not {config.sessions}.")
    found = asked(job.world, "head_to_head", *pair, speeds)
    return complete(job.world, "head_to_head", found, speeds, job.check_recordings)


def ends_the_run(why: NotComparable, world: World) -> NotComparable:
    """What to raise where the reference is why nothing can be compared. A simulated world gives the same session for
    the same request, so there going on helps nobody, and the error says so."""
    if not world.simulated:
        return why
    return type(why)(
        f"{why} `hts resume` would simulate the same session and end the same: begin a new run, with another --seed, "
        "setting or policy.",
        why.role,
        why.numbers,
    )
