"""`hts policy`: policies made elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    help="Policies made elsewhere: import.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


@app.callback()
def group() -> None:
    """Policies made elsewhere: import."""


@app.command("import")
def import_(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help=".safetensors (layers, or ours), .onnx of `hts export`, .pt of rsl_rl."),
    ],
    robot: Annotated[str, typer.Option(help="The robot that it moves, by name.")],
    to: Annotated[Path, typer.Option(metavar="FILE", help="The .safetensors to write; a .json goes beside it.")],
    layout: Annotated[
        Path | None, typer.Option(metavar="L.yaml", help="What it observes, in which order, and its joint order.")
    ] = None,
    std: Annotated[float, typer.Option(min=1e-3, max=10.0, help="Sigma of exploration where the file has none.")] = 0.2,
) -> None:
    """A policy of another library as one to start from. Nothing in the file is run."""
    from hts.errors import RunError
    from hts.plugins import load
    from hts.policies.files import save_policy, tensor_path
    from hts.policies.importing import import_policy
    from hts.policies.layout import load_layout, seen_by
    from hts.policies.with_critic import NEW_CRITIC

    machine = load().make_robot(robot)
    target = tensor_path(to)
    for path in (target, target.with_suffix(".json")):
        if path.exists():
            raise RunError(f"{path}: exists already. Choose another file with --to.")
    given = None if layout is None else load_layout(layout)
    policy = import_policy(file, machine.spec, given, std, seen_by(machine))
    written = save_policy(target, policy)
    made = policy.card.made
    sizes = (policy.card.observation_size, *policy.card.hidden, len(policy.card.joint_names))
    proof = ""
    if "replayed" in made:
        proof = f", {made['replayed']} actions replayed, off by at most {made['largest_difference']:.1g}"
    typer.echo(f"{written}: {'-'.join(map(str, sizes))} for robot {robot}{proof}")
    if made.get("critic") == NEW_CRITIC:
        typer.echo("its critic is new: let it learn first with --set finetune.ppo.warmup_batches=20")
