"""Policies made elsewhere, or exported by us, as a `Policy` to start from. Loading never runs code.

    .safetensors + .json   one of our own
    .safetensors alone     plain layers and examples, written at home from another library's actor (`layers`)
    .onnx                  exported by us (`onnx_ours`), or a plain network of mjlab, mujoco_playground or anybody
                           (`onnx_layers`): its numbers are read, its graph is never run
    .pt                    an rsl_rl checkpoint, through torch.load(weights_only=True) (`rsl_rl`); what lies beside it
                           (`params`) says what it observes and what its actions mean
    TorchScript            refused: it is a program, and loading it runs it

Layers, ONNX files and rsl_rl checkpoints bring an actor. The critic of this task sees other things than theirs, so it
starts anew; give fine-tuning a few `warmup_batches`, in which only the critic learns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from hts.contracts import RobotSpec
from hts.errors import PolicyError
from hts.policies import proof
from hts.policies.contract import Contract, ask
from hts.policies.contract_checks import check_values
from hts.policies.files import Policy, load_policy, make_card
from hts.policies.layers import holds_layers, layers_of, replay_examples
from hts.policies.layout import Layout, Seen, seen_in_velocity_task
from hts.policies.onnx_layers import from_onnx
from hts.policies.params import source_beside
from hts.policies.rsl_rl import from_checkpoint
from hts.policies.source import Source, sized
from hts.policies.terms import refuse_unmeasured
from hts.policies.translate import Network, Translation, translated, translation
from hts.policies.with_critic import NEW_CRITIC, with_new_critic
from hts.rl.population import Sizes

# Without a normaliser, ours would clip raw observations at 10.
# This factor, exact in binary, moves that to 80 and changes no result.
HEADROOM = 8.0
MOST_WORDS = 1200  # characters of a message


@dataclass(frozen=True)
class Imported:
    """A policy, and how it came here. network, maps, contract: as the source has it; None for one of our own."""

    policy: Policy
    network: Network | None = None
    maps: Translation | None = None
    contract: Contract | None = None


def import_policy(
    path: Path, robot: RobotSpec, layout: Layout | None = None, std: float = 0.2, seen: Seen | None = None
) -> Policy:
    """The policy in a file, for a robot.

    layout: of a file of layers, a plain ONNX file or an rsl_rl checkpoint; none: what lies beside the file says, else
    our own observation, unscaled. std: sigma of exploration, action units, where the file has none. seen: what policies
    see in the robot's env; none: the velocity task. What the file does not say is taken to be the robot's own; its card
    lists that as not proven (`hts.policies.proof.unproven`). Raises PolicyError for a file of another kind, a damaged
    one, or one made for another robot.
    """
    return import_whole(path, robot, layout, std, seen).policy


def import_whole(
    path: Path,
    robot: RobotSpec,
    layout: Layout | None = None,
    std: float = 0.2,
    seen: Seen | None = None,
    params: Path | None = None,
    strict: bool = False,
) -> Imported:
    """`import_policy`, with what a replay needs. params: the folder with env.yaml and agent.yaml, if not beside the
    file; strict: ask (PolicyError) for what neither file nor layout says, instead of taking the robot's own."""
    try:
        return _import(Path(path), robot, layout, std, seen or seen_in_velocity_task(robot), params, strict)
    except PolicyError as error:  # it may quote the file, which may hold anything
        text = "".join(letter if letter.isprintable() else "?" for letter in " ".join(str(error).split()))
        raise PolicyError(text[:MOST_WORDS]) from error.__cause__


def _import(
    path: Path, robot: RobotSpec, layout: Layout | None, std: float, seen: Seen, params: Path | None, strict: bool
) -> Imported:
    if path.suffix == ".safetensors" and not path.with_suffix(".json").exists() and holds_layers(path):
        network, examples, made = layers_of(path, robot.num_joints)
        return _finished(path, robot, network, Source(), layout, seen, std, made, HEADROOM, strict, examples)
    if path.suffix in (".safetensors", ".json"):
        return Imported(load_policy(path, robot))
    if path.suffix == ".onnx":
        found = from_onnx(path, robot, std)
        if isinstance(found, Policy):
            return Imported(found)
        network, said = found
        source = said.over(source_beside(path, params)) if said.contract.missing() else said
        made = {"kind": "onnx"}
    elif path.suffix in (".pt", ".pth", ".jit", ".ts", ".torchscript"):
        network, made, normalised = from_checkpoint(path)
        source = source_beside(path, params)
        headroom = 1.0 if normalised else HEADROOM
        return _finished(path, robot, network, source, layout, seen, std, made, headroom, strict)
    else:
        raise PolicyError(
            f"{path}: policies are read from .safetensors (with its .json), .onnx and .pt (rsl_rl), "
            f"not '{path.suffix}'."
        )
    return _finished(path, robot, network, source, layout, seen, std, made, 1.0, strict)


def _finished(
    path: Path,
    robot: RobotSpec,
    network: Network,
    source: Source,
    given: Layout | None,
    seen: Seen,
    std: float,
    made: dict[str, Any],
    headroom: float,
    strict: bool = False,
    examples: tuple[torch.Tensor, torch.Tensor] | None = None,
) -> Imported:
    """A source's network as a policy of the robot."""
    source.check_activation(path)
    layout = given or Layout(())
    contract = replace(layout.contract, joint_names=layout.joint_names or layout.contract.joint_names)
    contract = contract.over(source.contract)
    if strict:
        ask(path, contract, bool(layout.observation or source.observation or layout.rest))
    observation = layout.observation or sized(source.observation, robot.num_joints) or tuple(seen.parts)
    for part in observation:
        if "hold" not in part and "stand_in" not in part:
            refuse_unmeasured(path, str(part["name"]))
    layout = replace(layout, observation=observation)
    inputs, outputs = network.layers[0][0].shape[1], network.layers[-1][0].shape[0]
    size = sum(int(part["size"]) for part in layout.observation)
    several = _history(inputs, layout.observation, robot.num_joints)
    if several:
        raise PolicyError(
            f"{path}: its actor takes {inputs} observations, a whole one has {size}{several}. Train it again with one."
        )
    if outputs == 2 * robot.num_joints and network.log_std is None:
        raise PolicyError(
            f"{path}: its actor gives {outputs} numbers for {robot.num_joints} joints: with a sigma that depends on "
            "what it sees (rsl_rl's state_dependent_std, HeteroscedasticGaussianDistribution), or a BetaDistribution? "
            "hts has one sigma for all states. Train it again with rsl_rl's GaussianDistribution."
        )
    if inputs != size and given is not None and given.observation:
        raise PolicyError(
            f"{path}: its actor takes {inputs} observations, the parts of the layout's `observation` have {size}. "
            "Add the parts that are missing, correct their sizes, or leave the key out if it observes what "
            f"'{robot.name}' does."
        )
    if inputs != size or outputs != robot.num_joints:
        raise PolicyError(
            f"{path}: its actor maps {inputs} observations to {outputs} actions, expected {size} to "
            f"{robot.num_joints} for robot '{robot.name}'. Say with a layout (--layout) what it observes, or "
            "use a policy of this robot."
        )
    check_values(path, contract, robot)
    maps = translation(path, robot, layout, seen, contract)
    proof.check_rate(path, contract, robot)
    tensors = translated(path, robot, network, maps, seen, headroom)
    hidden = tuple(weight.shape[0] for weight, _ in network.layers[:-1])
    sizes = Sizes(sum(int(part["size"]) for part in seen.parts), seen.critic, outputs, hidden)
    whole = with_new_critic(path, tensors, sizes, std)
    states = proof.before_replay(path, contract, robot)
    if made.get("kind") == "rsl_rl" and not source.activation:
        why = f"{states['actions'].why}; nothing says its activation, taken to be ELU"
        states["actions"] = proof.State(proof.NOT_PROVEN, why)
    if examples is not None:
        count = sum(int(part["size"]) for part in seen.parts)
        wanted = examples[1].double()[:, maps.joints] * maps.gain + maps.shift
        off = replay_examples(path, whole, len(network.layers), maps.to_ours(examples[0], count), wanted)
        made |= {"replayed": len(wanted), "largest_difference": off}
        states["actions"] = proof.State(proof.PROVEN, f"{len(wanted)} examples replayed, off by at most {off:.1g}")
    made = {"imported_from": path.name, **made, "critic": NEW_CRITIC}
    made |= {"source": proof.written(contract), "proof": proof.as_card(states)}
    card = make_card(robot, whole, [dict(part) for part in seen.parts], sizes, **made)
    return Imported(Policy(whole, card), network, maps, contract)


def _history(inputs: int, parts: Sequence[Mapping[str, Any]], joints: int) -> str:
    """In words, what a multiple of a whole observation probably is; empty for none."""
    size = sum(int(part["size"]) for part in parts)
    if inputs % size or inputs == size or all(int(part["size"]) != joints for part in parts):
        return ""
    return (
        f" ({inputs} = {inputs // size} x {size}: a history of several observations? hts shows a policy one at a time)"
    )
