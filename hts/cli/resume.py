"""`hts resume`: go on where a run stopped."""

from __future__ import annotations

import typer

from hts import api
from hts.cli import options


def command(folder: options.RunFolder) -> None:
    """Go on with a run, or a pretraining, where it stopped; finished stages are not done again, and a finished run
    only shows its result again."""
    from hts.cli.one_line import resumable
    from hts.places import PRETRAINING, check_text, existing_run

    check_text(folder, "Rename it, and resume it then: nothing is lost.")
    if (folder / PRETRAINING).is_file():
        from hts.cli.pretrain import tell
        from hts.training.pretrain import resume_pretraining

        with resumable(folder, PRETRAINING, option=""):
            typer.echo(str(resume_pretraining(folder, tell)))
        return
    existing_run(folder)
    with resumable(folder, option=""):
        api.resume(folder)
