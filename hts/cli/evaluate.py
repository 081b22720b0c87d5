"""`hts evaluate`: a run's policy against the pretrained one."""

from __future__ import annotations

from typing import Annotated

import typer

from hts.cli import options


def command(
    folder: options.RunFolder,
    speed: Annotated[
        list[float] | None, typer.Option(help="m/s; repeat for several. Default: those of the run.")
    ] = None,
    policy: Annotated[str, typer.Option(help=f"{options.POLICIES}, or a file: .onnx or .safetensors.")] = "best",
    world: Annotated[str | None, typer.Option(metavar="NAME", help="Another world than that of the run.")] = None,
    seed: options.Seed = None,
    sessions: Annotated[
        int | None, typer.Option(min=1, help="Do it so often, each time anew; the interval is then over sessions.")
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Of evaluation. and world., for this once; repeat for several."
        ),
    ] = None,
) -> None:
    """Head-to-head against the pretrained policy, written to DIR/evaluation.json."""
    from hts.cli.printable import say
    from hts.places import existing_run

    existing_run(folder)
    from hts.config_loading import read_config
    from hts.evaluation.evaluate import evaluate_run
    from hts.plugins import load
    from hts.report.table import print_evaluation
    from hts.run.provenance import TO_EVALUATE, check_config

    config, registry = read_config(folder / "config.yaml"), load()
    check_config(folder, config, registry, TO_EVALUATE)
    if config.reward_source == "oracle":
        from hts.oracle import note_of

        typer.echo(note_of(config))
    found = evaluate_run(
        folder,
        speeds=speed or None,
        policy=policy,
        world=world,
        seed=seed,
        registry=registry,
        sessions=sessions,
        overrides=set_ or (),
        say=lambda line: say(line, err=True),
    )
    print_evaluation(found)
    typer.echo(str(folder / "evaluation.json"))
