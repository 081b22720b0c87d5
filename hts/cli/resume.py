"""`hts resume`: go on where a run stopped."""

from __future__ import annotations

from hts.cli import options


def command(folder: options.RunFolder) -> None:
    """Go on with a run where it stopped; finished stages are not done again."""
    from hts.cli.one_line import resumable
    from hts.cli.run_folder import existing_run

    existing_run(folder)
    from hts.config_loading import read_config

    with resumable(folder):
        if read_config(folder / "config.yaml").reward_source == "oracle":
            from hts.oracle import resume_oracle

            resume_oracle(folder)
        else:
            from hts.run import resume_run

            resume_run(folder)
