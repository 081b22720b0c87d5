"""`hts policy`: policies made elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hts.cli import options

if TYPE_CHECKING:
    from hts.policies.files import Policy

app = options.group("Policies made elsewhere: import.")


@app.callback()
def group() -> None:
    """Policies made elsewhere: import."""


@app.command("import")
def import_(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="model_N.pt of rsl_rl, .onnx (ours, or a plain network), .safetensors."),
    ],
    robot: Annotated[str, typer.Option(help="The robot that it moves, by name.")],
    to: Annotated[Path, typer.Option(metavar="FILE", help="The .safetensors to write; a .json goes beside it.")],
    layout: Annotated[
        Path | None,
        typer.Option(metavar="L.yaml", help="What it observes, its joint order, and what its actions mean."),
    ] = None,
    params: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder with env.yaml and agent.yaml, if not params/ beside it.")
    ] = None,
    std: Annotated[float, typer.Option(min=1e-3, max=10.0, help="Sigma of exploration where the file has none.")] = 0.2,
    log: Annotated[
        Path | None, typer.Option(metavar="LOG", help="A log of the original to replay: .npz, or a store.")
    ] = None,
    mapping: Annotated[
        Path | None, typer.Option(metavar="M.yaml", help="What the arrays of the .npz are called there.")
    ] = None,
    accept: Annotated[
        list[str] | None, typer.Option(metavar="ITEM", help="What you vouch for where no log proves it; repeatable.")
    ] = None,
    by: Annotated[str, typer.Option(metavar="NAME", help="Who vouches; stands in the policy's card.")] = "",
    trial: Annotated[bool, typer.Option(help="Let it stand and walk in simulation for a few seconds.")] = True,
) -> None:
    """A policy of another library as one to start from. Nothing in the file is run."""
    from dataclasses import replace

    from hts.errors import RunError
    from hts.places import check_place
    from hts.plugins import load
    from hts.policies import proof
    from hts.policies.files import ELSEWHERE, Policy, save_policy, tensor_path
    from hts.policies.importing import import_whole
    from hts.policies.layout import load_layout, seen_by
    from hts.policies.replay import replay
    from hts.policies.replay_log import read_log
    from hts.policies.with_critic import NEW_CRITIC

    if to.suffix.lower() in ELSEWHERE:
        raise RunError(
            f"--to {to}: expected a name that ends in .safetensors; that is what is written. `hts export --policy` "
            "makes an ONNX or TorchScript file of it."
        )
    machine = load().make_robot(robot)
    target = tensor_path(to)
    check_place(target, "--to FILE", file=True)
    for path in (target, target.with_suffix(".json")):
        if path.exists():
            raise RunError(f"{path}: exists already. Choose another file with --to.")
    given = None if layout is None else load_layout(layout, machine.spec)
    imported = import_whole(file, machine.spec, given, std, seen_by(machine), params, strict=True)
    policy = imported.policy
    states = proof.of_card(policy.card.made)
    if log is not None:
        states = replay(file, imported, read_log(log, mapping), machine.spec)
    if states or accept:
        states = proof.accepted(states, accept or (), by)
        made = {**policy.card.made, "proof": proof.as_card(states)}
        if log is not None:
            made["log"] = log.name
        policy = Policy(policy.tensors, replace(policy.card, made=made))
    written = save_policy(target, policy)
    typer.echo(f"{written}: {_summary(policy)}")
    for item, one in states.items():
        typer.echo(f"  {item.replace('_', ' ')}: {one.state}{f' by {one.by}' if one.by else ''} ({one.why})")
    _what_is_open(proof.unproven(policy.card))
    if policy.card.made.get("critic") == NEW_CRITIC:
        typer.echo("its critic is new: let it learn first with --set finetune.ppo.warmup_batches=20")
    if trial and states and machine.mjcf() is not None:
        from hts.cli.policy_trial import trial_lines

        for line in trial_lines(machine, policy):
            typer.echo(line)


def _summary(policy: Policy) -> str:
    sizes = (policy.card.observation_size, *policy.card.hidden, len(policy.card.joint_names))
    text = f"{'-'.join(map(str, sizes))} for robot {policy.card.robot}"
    made = policy.card.made
    if "replayed" in made:
        text += f", {made['replayed']} actions replayed, off by at most {made['largest_difference']:.1g}"
    return text


def _what_is_open(items: list[str]) -> None:
    if items:
        typer.echo(
            f"not shown: {', '.join(items)}. For simulation that is enough; for a robot replay a log (--log), or vouch "
            "for it: --accept ITEM --by NAME"
        )
