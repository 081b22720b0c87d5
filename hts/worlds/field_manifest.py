"""manifest.json of a deploy bundle: everything that a robot's computer must know beside the graphs themselves.

Version 1. A reader refuses a higher `schema_version`; keys are added, never renamed.

    schema, schema_version, hts_version, request
    robot        name, joint_names, default_pose rad, position_limit rad, velocity_limit rad/s, torque_limit N*m
    control      rate_hz; target: how a joint target is made; action_clip: action units, null: never clipped;
                 unsteady_seconds: after a swap, left out later
    policies     one a graph: file, mean_file (the same without noise; null: this one has none), policy_hash,
                 joint_names, default_pose, action_scale, kp, kd, control_rate_hz, observation parts with unit and
                 meaning, history, normaliser (in the graph), exploration (null: none), trained (null: not known),
                 gate (null: not tried)
    rows         what to record, in order: log, policy, schedule, session, block, role, trim, policy_hash
    hold         commands m/s, seconds, tolerance; null: the command is the schedule's
    channels     what a log holds: unit, size (0: one number), real (only the robot gives it: it needs an idle level)
    warmup_seconds, first_runs      before a head-to-head; how to begin with policies that never ran on a machine
    frozen       for how long a sensor may repeat itself, s, 0: for ever. seen_seconds: what policies observe;
                 real_seconds: a real channel, in a row
    turns        where a row is longer than the floor, for a runner that turns round and goes on: column of the log that
                 says of each step whether it counts, counts (its number then), settle_seconds at the row's command
                 after a turn; null: nobody walks
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import yaml

import hts
from hts.channels import Channel
from hts.config_env import within_a_step
from hts.config_gate import FirstRunConfig
from hts.contracts import VELOCITY, FollowVelocity, HoldSpeed, RobotSpec, Task
from hts.envs.observation import observation_layout
from hts.errors import PolicyError, WorldError
from hts.evaluation.segments import SETTLE_SECONDS
from hts.policies.export import CLIP
from hts.policies.gate_notes import lost, note_of, place, refusal
from hts.recordings.unread import LONGEST_SECONDS

SCHEMA, SCHEMA_VERSION = "hts deploy bundle", 1
WARMUP_SECONDS = 600.0  # of walking before a head-to-head: windings take about that long
COMMAND = "command"
PARTS = {
    "angular_velocity": ("rad/s", "of the trunk, in the trunk frame"),
    "projected_gravity": ("1", "unit vector of gravity in the trunk frame; (0, 0, -1) upright"),
    COMMAND: ("m/s, m/s, rad/s", "vx, vy, yaw rate as sent"),
    "joint_position_offset": ("rad", "joint angle - default_pose"),
    "joint_velocity": ("rad/s", "joint speed"),
    "last_action": ("action units", "the action of the step before, noise included; 0 at the start"),
}


@dataclass(frozen=True)
class Frozen:
    """For how long a sensor may repeat its last number while the robot moves, s; 0: for ever. seen_seconds: one that
    policies observe, three times what a walking quadruped showed; real_seconds: one that only the robot has, while a
    row is recorded."""

    seen_seconds: float = 0.1
    real_seconds: float = LONGEST_SECONDS


@dataclass(frozen=True)
class Facts:
    """What a bundle says of the robot and the run. run: its resolved configuration, {} where there is none; folder: of
    the run, None where there is none; task: what the robot is commanded."""

    spec: RobotSpec
    request: str = ""
    hold: HoldSpeed | None = None
    sim: Mapping[str, Channel] = field(default_factory=dict)
    real: Sequence[Channel] = ()
    run: Mapping[str, Any] = field(default_factory=dict)
    folder: Path | None = None
    frozen: Frozen = field(default_factory=Frozen)
    commands: Sequence[str] = ()
    own_env: bool = False
    task: Task = VELOCITY


def run_configuration(folder: Path) -> Mapping[str, Any]:
    """The resolved configuration of the run in a folder; {} if there is none that can be read."""
    try:
        found = yaml.safe_load((folder / "config.yaml").read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError):
        return {}
    return found if isinstance(found, Mapping) else {}


def first_runs(run: Mapping[str, Any]) -> dict[str, float]:
    """How a policy that never ran on this machine is walked first, recording nothing: `gate.first_run` of the run."""
    said = _inside(run, "gate", "first_run")
    return FirstRunConfig.model_validate(said if isinstance(said, Mapping) else {}).model_dump()


def manifest(facts: Facts, policies: Sequence[Mapping[str, Any]], rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The whole manifest. policies: `policy_entry` of each graph; rows: the plan's."""
    spec = facts.spec
    compared, held = any(row["role"] != "collection" for row in rows), facts.hold
    real = {channel.name for channel in facts.real}
    return {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "hts_version": hts.__version__,
        "request": facts.request,
        "robot": {
            "name": spec.name,
            "joint_names": list(spec.joint_names),
            "default_pose": list(spec.default_pose),
            "position_limit": [list(pair) for pair in spec.position_limit],
            "velocity_limit": list(spec.velocity_limit),
            "torque_limit": list(spec.torque_limit),
        },
        "control": {
            "rate_hz": spec.control_rate_hz,
            "target": "default_pose + action_scale * action",
            "action_clip": None,
            "unsteady_seconds": SETTLE_SECONDS,
        },
        "policies": list(policies),
        "rows": list(rows),
        "hold": None
        if held is None
        else {"commands": list(held.commands), "seconds": held.seconds, "tolerance": held.tolerance},
        "channels": {
            channel.name: {
                "unit": channel.unit,
                "size": channel.shape[0] if channel.shape else 0,
                "real": channel.name in real,
            }
            for channel in (*facts.sim.values(), *facts.real)
        },
        "warmup_seconds": WARMUP_SECONDS if compared else 0.0,
        "first_runs": first_runs(facts.run),
        "frozen": asdict(facts.frozen),
        "turns": {"column": "phase", "counts": 0, "settle_seconds": SETTLE_SECONDS}
        if isinstance(facts.task, FollowVelocity)
        else None,
    }


def policy_entry(
    card: SimpleNamespace,
    file: str,
    mean_file: str | None,
    seed: int | None,
    gate: Mapping[str, Any] | None,
    facts: Facts,
) -> dict[str, Any]:
    """What the manifest says of one graph. card: of the policy; seed: of the noise in its graph, None without; gate:
    what the gate before hardware found of it."""
    exploration = None
    if seed is not None:
        exploration = {"where": "graph", "sigma": list(card.exploration_std), "seed": seed}
    return {
        "file": file,
        "mean_file": mean_file,
        "policy_hash": card.policy_hash,
        **{key: list(getattr(card, key)) for key in ("joint_names", "default_pose", "action_scale", "kp", "kd")},
        "control_rate_hz": card.control_rate_hz,
        "observation": [_part(part, facts.task, len(card.joint_names)) for part in card.observation],
        "history": card.history,
        "normaliser": {"where": "graph", "formula": "clip((observation - mean) / std)", "clip": CLIP},
        "exploration": exploration,
        "trained": _trained(card, facts),
        "gate": gate,
    }


def _part(part: Mapping[str, Any], task: Task, joints: int) -> dict[str, Any]:
    """A part with its unit and meaning; "" for both where only the robot's env knows, as of a part of another size than
    the one that is known by this name."""
    name, size = str(part["name"]), int(part["size"])
    known = {"name": name, "size": size} in observation_layout(joints)
    unit, meaning = PARTS[name] if known else ("", "")
    if name == COMMAND and not isinstance(task, FollowVelocity):
        commanded = task.set_points != () and size == 1
        unit, meaning = (task.unit, f"set-point as sent: the {task.quantity} that is wanted") if commanded else ("", "")
    return {"name": part["name"], "size": part["size"], "unit": unit, "meaning": meaning}


def _trained(card: SimpleNamespace, facts: Facts) -> dict[str, Any] | None:
    """What a policy was trained in, from its card where that says so, else from the run; None where nobody knows.
    delay_s: least and most delay of its targets, s; commands: ranges of vx, vy m/s and yaw rate rad/s; source: who says
    so."""
    made = vars(card).get("made")
    fine_tuned = _inside(made, "anchor") is not None  # what nobody did was not trained as this run trains
    for source, env in (
        ("card of the policy", _inside(made, "config", "env")),
        ("run that fine-tuned it", _inside(facts.run, "finetune", "env") if fine_tuned else None),
    ):
        steps, ranges = _inside(env, "randomisation", "delay_steps"), _inside(env, "commands")
        if steps is None or ranges is None:
            continue
        share = _inside(env, "randomisation", "delay_share")
        if share is not None:  # of a control step; it is what counts where both are said
            steps = [float(end) * facts.spec.substeps for end in share]
        else:
            steps = within_a_step((steps[0], steps[1]), facts.spec.substeps)
        delay = (float(steps[0]) * facts.spec.physics_dt, float(steps[1]) * facts.spec.physics_dt)
        commands = {key: list(ranges[key]) for key in ("vx", "vy", "yaw_rate") if key in ranges}
        return {"delay_s": delay, "commands": commands, "source": source}
    return None


def _inside(content: Any, *path: str) -> Any:
    """What lies at a path of keys; None where it is not there."""
    for key in path:
        content = content.get(key) if isinstance(content, Mapping) else None
    return content


def gate_of(source: Path, card: SimpleNamespace, facts: Facts) -> Mapping[str, Any] | None:
    """What the gate before hardware found of an exported policy, None where it was not tried. Raises WorldError for one
    that it refused, unless the run's `gate.strict: false` says that a machine may have it, and where nobody can tell
    what it found. One of another run that came without what was found there counts as refused, see `lost`; let through,
    the runtime asks for a person who vouches for it."""
    try:
        found = note_of(source, vars(card), facts.folder)
    except PolicyError as error:
        raise WorldError(str(error)) from error
    away = lost(source, vars(card), facts.folder) if found is None else None
    found = away or found
    refused = refusal(found, source.name)
    if refused and _inside(facts.run, "gate", "strict") is not False:
        remedy = "give a policy that passed"
        if away and place(source).exists():
            remedy = "export it from the folder of its run, which knows, or give a policy that passed"
        elif away:
            remedy = f"put {place(source).name} beside the policy that you named"
        raise WorldError(
            f"{source}: {refused}. It is not bundled for a machine: {remedy}. A run that lets a "
            "machine have who fails the gate is begun with --set gate.strict=false (docs/safety.md)."
        )
    return found
