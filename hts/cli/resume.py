"""`hts resume`: go on where a run stopped."""

from __future__ import annotations

from hts.cli import options


def command(folder: options.RunFolder) -> None:
    """Go on with a run where it stopped; finished stages are not done again."""
    from hts.cli.one_line import resumable
    from hts.cli.run_folder import existing_run

    existing_run(folder)
    from hts.run import resume_run

    with resumable(folder):
        resume_run(folder)
