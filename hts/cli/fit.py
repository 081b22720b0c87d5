"""`hts fit`: one measurement model from a recording store."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hts.cli import options


def command(
    data: Annotated[Path, typer.Option(help="Recording store.")],
    out: Annotated[Path, typer.Option(help="Folder for the model and fit.json.")],
    objective: Annotated[
        str | None, typer.Option(help="Whose measurement model. `hts plugins` lists them. Or --target and --input.")
    ] = None,
    target: options.Target = None,
    input_: options.Inputs = None,
    test: Annotated[
        Path | None, typer.Option(metavar="STORE", help="Held out: another store. Nothing of DATA is then held out.")
    ] = None,
    split: Annotated[
        str | None,
        typer.Option(
            metavar="HOW",
            help="What is held out: chronological=0.7 fits to the first 70 % of each recording; recording, file, "
            "session or policy, each =SHARE that is fitted to, or =NAME,NAME that are held out.",
        ),
    ] = None,
    models: Annotated[
        str | None, typer.Option(metavar="NAME,NAME", help="Further models in the table, on the same split.")
    ] = None,
    best: Annotated[
        bool, typer.Option("--best", help="Keep the model that is best by cross-validation within what is fitted to.")
    ] = False,
    keep_shared: Annotated[
        bool, typer.Option("--keep-shared", help="Fit also to samples that are held out at the same time.")
    ] = False,
    robot: Annotated[str | None, typer.Option(metavar="NAME", help="Only its recordings.")] = None,
    set_: options.Overrides = None,
) -> None:
    """Fit one measurement model, with its checks: OUT/fit.json says how well it predicts.

    No robot need be named: joints, channels, units and rate are those of the recordings in the store. The mean of the
    data, the analytic proxy with fitted coefficient, and `linear` are fitted beside it and scored on the same samples.
    """
    import json

    from hts.cli.fit_progress import FitProgress
    from hts.cli.printable import say
    from hts.measurement.fit_command import FitChecks, fit_store
    from hts.measurement.fit_report import cautions, doubts, heading, session_note, summary_line, table
    from hts.measurement.split_rule import SplitRule
    from hts.measurement.wanted import Wanted

    checks = FitChecks(
        test=test,
        split=None if split is None else SplitRule.parsed(split),
        models=tuple(name.strip() for name in (models or "").split(",") if name.strip()),
        best=best,
        keep_shared=keep_shared,
    )
    wanted = Wanted(target, tuple(input_ or ()), robot)
    with FitProgress() as shown:
        written = fit_store(
            objective, data, out, overrides=set_ or (), progress=shown, checks=checks, wanted=wanted, say=shown.say
        )
    report = json.loads(written.read_text(encoding="utf-8"))
    if report["held_out"]["recordings"]:
        for line in table(report):
            say(line)
    note = session_note(report)
    beside = [f"{heading(report)}: {note}. Whole sessions are held out by --split session."] if note else []
    for line in (summary_line(report), *beside, *doubts(report), *cautions(report)):
        say(line)
    typer.echo(str(written))
