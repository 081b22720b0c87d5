"""From a network as another library made it to one that observes and acts as our robot does: the same function.

With o what our env shows and z what the source's network is given, each of its entries is z = alpha o + beta; with a_s
its action and a_r ours, both mean the same joint target,

    default_s + scale_s a_s = default_r + scale_r a_r.

All of this is linear, so it goes into normaliser, first and last layer, and changes nothing of what the policy does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from hts.contracts import RobotSpec
from hts.errors import PolicyError, unknown_name
from hts.policies.contract import Contract, known_joints, per_joint
from hts.policies.layout import Layout, Seen
from hts.policies.terms import ABSOLUTE, our_name
from hts.rl.population import CLIP

# What may reach a policy, in our units: up to there a source without a clip must not meet ours.
REACH = {
    "angular_velocity": 20.0,  # rad/s
    "projected_gravity": 1.2,
    "command": 5.0,  # m/s, rad/s
    "joint_position_offset": 2 * math.pi,  # rad
    "last_action": 20.0,
}
VELOCITY_REACH = 1.5  # times a joint's limit


@dataclass(frozen=True)
class Network:
    """A source's actor: layers [(weight, bias)] with ELU between, normaliser mean and spread (I,), clip of normalised
    entries (None: none), log sigma (A,) or None. All in the source's order and units."""

    layers: Sequence[tuple[torch.Tensor, torch.Tensor]]
    mean: torch.Tensor
    spread: torch.Tensor
    clip: float | None = None
    log_std: torch.Tensor | None = None


@dataclass(frozen=True)
class Translation:
    """The maps between source and robot. I source entries, O of ours, A actions.

    entry (I,) int: ours that a source entry is made of, -1: a constant; alpha, beta (I,): z = alpha o + beta; own (I,)
    bool: false where a part of ours only stands in; factor (I,): the layout's scale; joints (A,): for each of our
    joints the source's action; gain, shift (A,), in our order: a_r = gain a_s + shift; parts: (our name or the
    source's, first entry, size).
    """

    entry: torch.Tensor
    alpha: torch.Tensor
    beta: torch.Tensor
    own: torch.Tensor
    factor: torch.Tensor
    joints: torch.Tensor
    gain: torch.Tensor
    shift: torch.Tensor
    parts: tuple[tuple[str, int, int], ...]

    def to_ours(self, given: torch.Tensor, size: int) -> torch.Tensor:
        """(n, O) of what the source's network was given (n, I), double; zeros where it says nothing."""
        ours = torch.zeros(len(given), size, dtype=torch.float64)
        ours[:, self.entry[self.own]] = ((given.double() - self.beta) / self.alpha)[:, self.own]
        return ours

    def action_to_source(self, actions: torch.Tensor) -> torch.Tensor:
        """(n, A) in the source's order and units of ours, double."""
        found = torch.zeros_like(actions, dtype=torch.float64)
        found[:, self.joints] = (actions.double() - self.shift.double()) / self.gain.double()
        return found


def translation(path: Path, robot: RobotSpec, layout: Layout, seen: Seen, contract: Contract) -> Translation:
    """The maps that a layout and a contract mean. Raises PolicyError for parts or joints that the robot has not."""
    names = known_joints(path, contract, robot)
    joints = torch.tensor([names.index(name) for name in robot.joint_names])
    whole = contract.of_robot(robot)
    assert whole.default_pose is not None and whole.action_scale is not None
    pose = _in_our_order(per_joint(path, "default_pose", whole.default_pose, names), joints)
    scale = _in_our_order(per_joint(path, "action_scale", whole.action_scale, names), joints)
    if bool((scale == 0).any()):
        raise PolicyError(f"{path}: action_scale is 0 for a joint. State what an action unit is, rad.")
    own_pose, own_scale = (torch.tensor(x, dtype=torch.float64) for x in (robot.default_pose, robot.action_scale))
    gain, shift = scale / own_scale, (pose - own_pose) / own_scale
    starts, first = {}, 0
    for part in seen.parts:
        starts[str(part["name"])] = (first, int(part["size"]))
        first += int(part["size"])
    rows, parts, at = [], [], 0  # of each part entry, alpha, beta, own, factor
    for part in layout.observation:
        name, size = our_name(str(part["name"])), int(part["size"])
        factor = one = _scales(path, part, size)
        zero = torch.zeros(size, dtype=torch.float64)
        parts.append((name, at, size))
        at += size
        if name not in starts and name != ABSOLUTE:
            kept, a, b = _in_its_place(path, part, starts, size)
            rows.append((kept, factor * a, factor * b, torch.zeros(size, dtype=torch.bool), factor))
            continue
        begin, width = starts.get("joint_position_offset" if name == ABSOLUTE else name, (0, -1))
        if width != size:
            raise PolicyError(
                f"{path}: its part '{part['name']}' has {size} numbers, "
                f"{'none is' if width < 0 else f'{width} are'} seen of it in the env of robot '{robot.name}'."
            )
        of_joints = size == robot.num_joints and (name.startswith("joint_") or name == "last_action")
        place = torch.empty(size, dtype=torch.long)  # of each source entry, ours
        place[joints if of_joints else torch.arange(size)] = torch.arange(size)
        if name == "joint_position_offset" and of_joints:
            zero = (own_pose - pose)[place] * factor
        elif name == ABSOLUTE:
            zero = own_pose[place] * factor
        elif name == "last_action" and of_joints:
            zero = (-shift / gain)[place] * factor
            one = (1 / gain)[place] * factor
        rows.append((begin + place, one, zero, torch.ones(size, dtype=torch.bool), factor))
    entry, alpha, beta, own, factors = (torch.cat(column) for column in zip(*rows, strict=True))
    if len(entry[own].unique()) != len(entry[own]):
        raise PolicyError(f"{path}: its layout names a part of the observation twice.")
    return Translation(entry, alpha, beta, own, factors, joints, gain, shift, tuple(parts))


def _scales(path: Path, part: Mapping[str, Any], size: int) -> torch.Tensor:
    """(size,) what a part is multiplied by, from one number or one for each of its entries."""
    given = part.get("scale", 1.0)
    values = list(given) if isinstance(given, list | tuple) else [given] * size
    if len(values) != size or not all(isinstance(one, int | float) and math.isfinite(one) and one for one in values):
        raise PolicyError(f"{path}: the scale of '{part['name']}' is {str(given)[:60]}, expected 1 or {size} numbers.")
    return torch.tensor(values, dtype=torch.float64)


def _in_our_order(values: Sequence[float], joints: torch.Tensor) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)[joints]


def _in_its_place(
    path: Path, part: Mapping[str, Any], starts: Mapping[str, tuple[int, int]], size: int
) -> tuple[torch.Tensor, float, float]:
    """Entries, factor and constant for a part that the env does not show."""
    if part.get("hold") is not None:
        return torch.full((size,), -1), 1.0, float(part["hold"])
    if part.get("stand_in") is not None:
        other = our_name(str(part["stand_in"]))
        if other not in starts or starts[other][1] < 1:
            raise PolicyError(f"{path}: stand_in: " + unknown_name("observation", other, starts))
        begin, width = starts[other]
        kept = begin + torch.arange(size)
        if other == "command":  # vx, vy, yaw rate: the third is no velocity along z
            width = 2
        return torch.where(torch.arange(size) < width, kept, -1), 1.0, 0.0
    raise PolicyError(
        f"{path}: it observes what this task does not give. "
        + unknown_name("observation", our_name(str(part["name"])), [*starts, ABSOLUTE])
        + " Train it again without, or give the part a constant that it was trained to walk with (hold: in the layout)."
    )


def translated(
    path: Path, robot: RobotSpec, network: Network, maps: Translation, seen: Seen, headroom: float
) -> dict[str, torch.Tensor]:
    """Tensors of our actor with its normaliser (and log_std, if the source has sigmas). headroom: least factor by which
    our clip lies farther out than it would, where the source has none."""
    size = sum(int(part["size"]) for part in seen.parts)
    entry, own = maps.entry, maps.own
    mean, spread = torch.zeros(size, dtype=torch.float64), torch.ones(size, dtype=torch.float64)
    mean[entry[own]] = ((network.mean.double() - maps.beta) / maps.alpha)[own]
    spread[entry[own]] = (network.spread.double() / maps.alpha.abs())[own]
    if network.clip is None:
        factor = torch.full((size,), headroom, dtype=torch.float64)
        wanted = (_reach(robot, seen) + mean.abs()) / (CLIP * spread)
        factor = torch.maximum(factor, 2 ** wanted.clamp(min=1.0).log2().ceil())  # a power of two rounds nothing
    else:
        if not bool(own.all()):
            raise PolicyError(f"{path}: it clips what it observes, so nothing can stand in for a part of it.")
        factor = torch.full((size,), network.clip / CLIP, dtype=torch.float64)
    spread = spread * factor
    weight, bias = (value.double() for value in network.layers[0])
    used = (entry >= 0).nonzero().flatten()
    slope = maps.alpha[used] / network.spread.double()[used]  # of each normalised source entry in ours
    level = (maps.beta - network.mean.double()) / network.spread.double()
    level[used] += slope * mean[entry[used]]
    first = torch.zeros(len(weight), size, dtype=torch.float64)
    first.index_add_(1, entry[used], weight[:, used] * (slope * spread[entry[used]]))
    level[own] = 0.0  # exactly: the mean is the source's
    layers = [(first, bias + weight @ level), *((w.double(), b.double()) for w, b in network.layers[1:])]
    weight, bias = layers[-1]
    layers[-1] = weight[maps.joints] * maps.gain[:, None], bias[maps.joints] * maps.gain + maps.shift
    tensors = {"observation_mean": mean.float(), "observation_std": spread.float()}
    for index, (weight, bias) in enumerate(layers):
        tensors |= {f"actor.{index}.weight": weight.float().contiguous(), f"actor.{index}.bias": bias.float()}
    if network.log_std is not None:
        tensors["log_std"] = (network.log_std.double()[maps.joints] + maps.gain.abs().log()).float()
    return tensors


def _reach(robot: RobotSpec, seen: Seen) -> torch.Tensor:
    """What may reach the policy, per entry of ours; 0 where we do not know."""
    reach = {**REACH, "joint_velocity": VELOCITY_REACH * max(robot.velocity_limit, default=0.0)}
    parts = [torch.full((int(part["size"]),), reach.get(str(part["name"]), 0.0)) for part in seen.parts]
    return torch.cat(parts).double()
