"""Policy files: tensors in safetensors, everything else in a JSON card beside them. Loading never runs code."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from safetensors.torch import save as dump_tensors

from hts.atomic import atomic_write
from hts.contracts import Robot, RobotSpec
from hts.errors import ConfigError, PolicyError
from hts.policies.card_checks import check_card
from hts.rl.population import Sizes

FORMAT = 1
ELSEWHERE = (".onnx", ".pt", ".pth", ".ts", ".jit", ".torchscript")  # endings of what other libraries write


@dataclass(frozen=True)
class PolicyCard:
    """What a computer on a robot must know of a policy beside its numbers.

    robot: name of the machine; joint_names: J, in the order of every tuple here; default_pose: rad; action_scale: rad
    per action unit, joint target = default_pose + action_scale x action; kp: N·m/rad; kd: N·m·s/rad;
    control_rate_hz: how often it is asked, Hz; critic_observation_size: numbers that the critic sees; hidden: widths of
    the hidden layers of actor and critic; policy_hash: see `hash_tensors`; made: how it was made; format: version of
    this file; observation: parts in order, [{name, size}];
    history: how many observations are stacked, newest last (1: none);
    exploration_std: normal noise added to each action when it runs, action units (empty: none, the mean action).
    """

    robot: str
    joint_names: tuple[str, ...]
    default_pose: tuple[float, ...]
    action_scale: tuple[float, ...]
    kp: tuple[float, ...]
    kd: tuple[float, ...]
    control_rate_hz: float
    observation: tuple[Mapping[str, Any], ...]
    critic_observation_size: int
    hidden: tuple[int, ...]
    history: int = 1
    policy_hash: str = ""
    exploration_std: tuple[float, ...] = ()
    made: Mapping[str, Any] = field(default_factory=dict)
    format: int = FORMAT

    @property
    def observation_size(self) -> int:
        return sum(int(part["size"]) for part in self.observation) * self.history

    def sizes(self) -> Sizes:
        return Sizes(self.observation_size, self.critic_observation_size, len(self.joint_names), tuple(self.hidden))


@dataclass(frozen=True)
class Policy:
    """One policy.

    tensors: by name, see `Sizes.shapes`, plus the normalisers; card: what a robot must know beside them.
    """

    tensors: Mapping[str, torch.Tensor]
    card: PolicyCard


def hash_tensors(tensors: Mapping[str, torch.Tensor]) -> str:
    """SHA-256 over names, shapes and float32 values, in order of name."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        value = tensors[name].detach().cpu().float().contiguous()
        digest.update(f"{name}{tuple(value.shape)}".encode())
        digest.update(value.numpy().tobytes())
    return digest.hexdigest()


def check_finite(what: Path | str, tensors: Mapping[str, torch.Tensor]) -> None:
    """Raises PolicyError unless every tensor that a policy holds is finite as float32; what: named in the error."""
    for name, value in tensors.items():
        if not bool(torch.isfinite(value.float()).all()):
            raise PolicyError(f"{what}: '{name}' holds numbers that are not finite. Use an earlier policy.")


def make_card(
    spec: RobotSpec, tensors: Mapping[str, torch.Tensor], observation: list[dict[str, Any]], sizes: Sizes, **made: Any
) -> PolicyCard:
    """The card of a policy for a robot; `made` records how it was made."""
    return PolicyCard(
        robot=spec.name,
        joint_names=spec.joint_names,
        default_pose=spec.default_pose,
        action_scale=spec.action_scale,
        kp=spec.kp,
        kd=spec.kd,
        control_rate_hz=spec.control_rate_hz,
        observation=tuple(observation),
        critic_observation_size=sizes.critic_observation,
        hidden=tuple(sizes.hidden),
        policy_hash=hash_tensors(tensors),
        made=made,
    )


def tensor_path(path: Path | str) -> Path:
    """The .safetensors of a policy named with or without it; dots in the name are part of it (`best-0.5`)."""
    path = Path(path)
    return (
        path.with_suffix(".safetensors")
        if path.suffix in (".safetensors", ".json")
        else path.with_name(f"{path.name}.safetensors")
    )


def _seen_from(path: Path) -> str:
    """Of a relative path that is not there: where it was looked for, which is not beside a config file."""
    if path.is_absolute():
        return ""
    return (
        f" A relative path counts from the folder where hts is typed, here {Path.cwd()}, also one that stands in a "
        "config file."
    )


def save_policy(path: Path | str, policy: Policy) -> Path:
    """Write `path` (.safetensors) and its .json, each in one move: no reader ever sees half a file. Raises PolicyError,
    and writes nothing, for numbers that are not finite."""
    path = tensor_path(path)
    check_finite(path, policy.tensors)
    tensors = dump_tensors({name: value.contiguous() for name, value in policy.tensors.items()})
    atomic_write(path.with_suffix(".json"), json.dumps(asdict(policy.card), indent=1) + "\n")
    return atomic_write(path, tensors)


def pretrained_file(robot: Robot) -> Path:
    """Of the policy to start from. Raises ConfigError, with the ways to one, for a robot that names none."""
    source = robot.pretrained_policy()
    if source is None:
        raise ConfigError(
            f"Robot '{robot.spec.name}' has no pretrained policy. Make one with `hts pretrain`, or bring one from "
            "elsewhere with `hts policy import`; then name it: --set robot.policy=FILE.safetensors, or in the robot's "
            "pretrained_policy()."
        )
    return Path(source)


def load_policy(path: Path | str, robot: RobotSpec | None = None) -> Policy:
    """Read a policy back. Raises PolicyError if a file is missing, damaged, not finite, or made for another robot."""
    named, path = Path(path), tensor_path(path)
    if named.suffix.lower() in ELSEWHERE and named.is_file() and not path.exists():
        raise PolicyError(
            f"{named}: expected a .safetensors with its .json beside it, as hts writes them. A policy of another "
            f"library comes in by: hts policy import {named} --robot {robot.name if robot else 'NAME'} "
            "--to FILE.safetensors"
        )
    try:
        card = read_card(path.with_suffix(".json"))
        tensors = load_file(path)
    except FileNotFoundError as error:
        raise PolicyError(
            f"{error.filename or path}: no such file; a policy is a .safetensors and a .json of one name."
            f"{_seen_from(path)}"
        ) from error
    except OSError as error:
        raise PolicyError(
            f"{error.filename or path}: cannot be read ({error.strerror or error}). Check the file and its rights."
        ) from error
    except SafetensorError as error:
        raise PolicyError(f"{path}: not a whole safetensors file ({error}). Copy or export it again.") from error
    expected = {**card.sizes().shapes(), **card.sizes().normalisers()}
    for name, shape in expected.items():
        found = tuple(tensors[name].shape) if name in tensors else None
        if found != shape:
            what = f"has shape {found}" if found else "is missing"
            raise PolicyError(
                f"{path}: tensor '{name}' {what}, its card says {shape}. File and card belong to different policies."
            )
    if hash_tensors(tensors) != card.policy_hash:
        raise PolicyError(
            f"{path}: its numbers do not match the hash in {path.with_suffix('.json').name}. Copy both files again."
        )
    check_finite(path, tensors)
    if robot is not None:
        check_robot(path, card, robot)
    return Policy(tensors, card)


def read_card(path: Path) -> PolicyCard:
    """A policy's JSON card. Raises PolicyError if it is damaged or of an unknown format."""
    try:
        text = Path(path).read_text()
    except UnicodeDecodeError as error:
        raise PolicyError(f"{path}: not a policy card ({error}). Copy or export the policy again.") from error
    return parse_card(text, path)


def parse_card(text: str, path: Path) -> PolicyCard:
    """A card from its JSON; `path` is named in errors. Raises PolicyError."""
    try:
        data = json.loads(text)
        if not isinstance(data, dict):
            raise TypeError(f"it holds a {type(data).__name__}")
        if data.get("format") != FORMAT:
            raise PolicyError(
                f"{path}: policy format {data.get('format')}, this version reads {FORMAT}. Export the policy again."
            )
        check_card(data, path)
        lists = {key: tuple(value) for key, value in data.items() if isinstance(value, list)}
        return PolicyCard(**{**data, **lists})
    except (ValueError, TypeError, RecursionError) as error:
        raise PolicyError(f"{path}: not a policy card ({error}). Copy or export the policy again.") from error


def check_robot(path: Path, card: PolicyCard, robot: RobotSpec) -> None:
    """Raises PolicyError unless the policy was made for this robot with these joints, gains and rate."""
    for what, of_policy, of_robot in (
        ("robot", card.robot, robot.name),
        ("joint order", card.joint_names, robot.joint_names),
        ("default pose", card.default_pose, robot.default_pose),
        ("action scale", card.action_scale, robot.action_scale),
        ("kp", card.kp, robot.kp),
        ("kd", card.kd, robot.kd),
        ("control rate", card.control_rate_hz, robot.control_rate_hz),
    ):
        if of_policy != of_robot:
            raise PolicyError(
                f"{path}: made for {what} {of_policy}, robot '{robot.name}' has {of_robot}. "
                "Use a policy of this robot, or run with the robot it was made for."
            )
