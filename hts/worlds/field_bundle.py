"""What a person beside a robot needs: policies, what to do with them, and how to name the logs."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.contracts import FollowVelocity, Requests, RobotSpec, Task
from hts.errors import WorldError
from hts.evaluation.segments import SETTLE_SECONDS
from hts.policies.deploy import DeployedPolicy
from hts.policies.exploring import mean_of, seed_of, with_noise
from hts.policies.gate_notes import refusal
from hts.policies.proof import unproven
from hts.recordings.partial import publish
from hts.worlds.field_holding import instructions as holding
from hts.worlds.field_manifest import (
    WARMUP_SECONDS,
    Facts,
    first_runs,
    gate_of,
    manifest,
    policy_entry,
)
from hts.worlds.field_places import CHECKSUMS, PAGE, into, renew, then_type
from hts.worlds.field_runner import runner, who_does_the_rows


@dataclass(frozen=True)
class Order:
    """One log to be recorded: `name` of its files, the policy (ONNX file), and what becomes part of the recording.

    trim: its policy's command is trimmed before it.
    """

    name: str
    policy: Path
    schedule: ScheduleConfig
    session: str
    block: int
    role: str
    trim: bool = False


def mapping_template(spec: RobotSpec, sim: Mapping[str, Channel], real: Sequence[Channel]) -> str:
    """A mapping to fill in, as YAML: every channel that is wanted, with made-up column names."""

    def columns(channel: Channel) -> Any:
        if channel.name.startswith("joint_"):
            return "{joint}_" + channel.name.removeprefix("joint_")
        return channel.name if channel.shape == () else [f"{channel.name}_{i}" for i in range(channel.shape[0])]

    content = {
        "reader": "csv",
        "time": {"column": "time", "unit": "s"},
        "rate_hz": spec.control_rate_hz,
        "joints": {name: name for name in spec.joint_names},
        "channels": {
            **{name: {"columns": columns(channel), "unit": channel.unit} for name, channel in sim.items()},
            **{c.name: {"columns": columns(c), "unit": c.unit, "sign": 1, "idle": None} for c in real},
        },
        "recording": {"mass_kg": None},
    }
    head = (
        "# Which column of your logs is which channel. Change the column names on the right to those of your logs.\n"
        "# idle: the level with electronics on and motors idle; measure it today, on this robot, in this state of\n"
        "# charge, in this room. sign: -1 where the log counts the other way. mass_kg: weigh the robot as it walks.\n"
    )
    return head + yaml.safe_dump(content, sort_keys=False, width=110)


def instructions(
    orders: Sequence[Order], mapping: Path, command: str, facts: Facts, entries: Sequence[Mapping[str, Any]]
) -> str:
    """README of the bundle. entries: of the manifest's policies."""
    first, task = first_runs(facts.run), facts.task
    rows = [
        f"| {order.name} | {order.session} | {order.block} | {order.role} | policies/{order.policy.name} | "
        + ", then ".join(_asked(task, one) for one in order.schedule.commands)
        + (", *trim first*" if order.trim else "")
        + " |"
        for order in orders
    ]
    walks = isinstance(task, FollowVelocity)
    asked = ("speed" if facts.hold else "commanded speed") if walks else "set-point"
    compared = any(order.role != "collection" for order in orders)
    session = (
        "Logs of one session are recorded on one robot, one after the other, without a pause: "
        + ("policies are swapped " if facts.commands else "swap the policy ")
        + f"while it {'walks' if walks else 'moves'}{'' if facts.commands else ', or as fast as you can'}; the first "
        f"{SETTLE_SECONDS:g} s after a swap are left out later. "
        + (_by_itself(walks, compared) if facts.commands else _by_yourself(walks, compared))
    )
    policies = (
        "Each policy is an ONNX file: input `observation`, output `action`"
        + ("" if facts.own_env else "; joint target = default_pose + action_scale * action")
        + ". Its `.json` states joint order, default pose, gains, rate and the parts of the observation."
    )
    if not facts.commands:
        policies += "\n\n" + runner(facts.spec, entries, first, walks, facts.own_env)
    idle = "Before or after, with electronics on and motors idle, read off the idle level of each measured channel."
    lines = [
        "# What to record",
        "",
        _BEFORE,
        "",
        who_does_the_rows(facts.spec.name, facts.commands, metres(orders, facts) if walks else None),
        "",
        "## The rows",
        "",
        _EXPLORING,
        "",
        session,
        "",
        f"| log | session | block | role | policy | {asked} |",
        "|---|---|---|---|---|---|",
        *rows,
        "",
        policies,
        "",
        *(holding(facts.hold, bool(facts.commands)) if facts.hold else ["## Then", ""]),
        f"1. {idle}",
        into(mapping),
        "3. Save the log of row 00 as `logs/00.csv` (or several files in a folder `logs/00/`), and so on.",
        then_type(command),
        "",
        _watch(first, task, _gates(entries)),
        "",
    ]
    return "\n".join(lines)


_BEFORE = f"""\
Everything for one visit to the robot is in this folder: the policies, `manifest.json` (what a robot's computer must
know of them), `plan.json`, this page. `sha256sum -c {CHECKSUMS}` in this folder says whether it arrived whole."""

_EXPLORING = """\
A policy that explores has its noise inside its graph: run it as any other, add none. Each exploring row has a graph of
its own, so that no two repeat one noise; what it would have done without is in `policies/mean/`."""


def metres(orders: Sequence[Order], facts: Facts) -> float:
    """How far a bundle's rows walk, m, with the warming up before comparisons and what is trimmed."""
    walks = [one for order in orders for one in order.schedule.commands]
    far = sum(one.seconds * math.hypot(one.vx, one.vy) for one in walks)
    compared = [order.schedule.commands[0] for order in orders if order.role != "collection"]
    far += sum(WARMUP_SECONDS * math.hypot(one.vx, one.vy) for one in compared[:1])
    trimmed = [order.schedule.commands[0] for order in orders if order.trim] if facts.hold else []
    return far + sum(facts.hold.seconds * math.hypot(one.vx, one.vy) for one in trimmed if facts.hold)


def _by_yourself(walks: bool, compared: bool) -> str:
    """What is left to a person between the rows. compared: whether policies are; then the robot is warmed up before, as
    the manifest's `warmup_seconds` says; first data need none."""
    doing = "walking" if walks else "letting it do its task"
    warm_up = f"Warm the robot up first, by {doing} for {WARMUP_SECONDS / 60:g} minutes. " if compared else ""
    return warm_up + (
        "Keep the heading by hand. If it falls, look it over, stand it up and go on."
        if walks
        else "If it fails, begin it again."
    )


def _by_itself(walks: bool, compared: bool) -> str:
    """The same where a runtime does the rows, as the contract's `bundle_commands` says of it."""
    warm_up = f"first warms the robot up for {WARMUP_SECONDS / 60:g} minutes" if compared else ""
    does = " and ".join(part for part in (warm_up, "keeps the heading" if walks else "") if part)
    fails = "If it falls, look it over" if walks else "If it fails, look why"
    return (f"The runtime {does}. " if does else "") + f"{fails}, and type the command again."


def _gates(entries: Sequence[Mapping[str, Any]]) -> str:
    """What the gate found of the policies, in sentences, a line each."""
    failed = [entry for entry in entries if entry["gate"] is not None and not entry["gate"]["passed"]]
    untried = [entry for entry in entries if entry["gate"] is None]
    lines = [f"- `{one['file']}` **failed the gate**: {refusal(one['gate'], one['file'])}." for one in failed]
    if untried:
        files = ", ".join(f"`{entry['file']}`" for entry in untried)
        lines.append(f"- **No gate is known to have tried** {files}.")
    return "\n".join(lines) or "- All policies of this bundle passed it."


def _watch(first: Mapping[str, float], task: Task, gates: str) -> str:
    walks = isinstance(task, FollowVelocity)
    rests = "lay it down with its limbs folded and keep a hand on it" if walks else "let it rest where it cannot fall"
    watched, struck, after = "", "a joint strikes", "look at joints and plugs"
    if walks:
        watched, after = " slipping feet, a gait that becomes uneven,", "look at legs, feet and plugs"
        struck = "the trunk leans and does not come back, a leg strikes"
    does, go, holds = ("walks", "Walk", "stands") if walks else ("moves", "Run", "holds itself up")
    return f"""\
## Before a policy {does} for the first time on this machine

Hang the robot, or {rests}: its motors may idle at first, and drop one
that {holds}. {go} each new policy for {first["seconds"]:g} s at
{first["speed_scale"]:.0%} of the {"speed" if walks else "set-point"} with the torque limited to
{first["torque_scale"]:.0%}, record nothing, and look whether it {does} as in simulation.
The gate tries policies over many simulated machines before a real one (`gate` of each in `manifest.json`; null: it was
not asked):

{gates}

## What to watch

Motor temperatures and their rise, supply voltage,{watched} noise from a gear, people
and cables near the {"legs" if walks else "robot"}. One person looks at the robot only, with the stop key in the hand.

## When to stop

At once, by the stop key: {struck} an end stop, a motor smells or passes
its temperature limit, the link or the log stutters, anybody is unsure. A row that was stopped is recorded again from
its start; rows that are done stay. After a {"fall" if walks else "stop"} {after} before going on."""


def _asked(task: Task, command: Command) -> str:
    """What is commanded in a stretch, and for how long."""
    what = f"{command.commanded:g} {task.unit}" if task.at(command.commanded) else "the task"
    return f"{what} for {command.seconds:g} s"


def write_bundle(folder: Path, orders: Sequence[Order], mapping: Path, command: str, facts: Facts) -> None:
    """Write policies, cards, manifest, plan, instructions and checksums; complete or not at all, on the disk when this
    returns. A bundle that is there stays as it is, so half of one that a crash left would stay too; only the places
    that its page names are those of now, see `renew`."""
    if folder.exists():
        renew(folder, mapping, command)
        return
    temporary = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(temporary, ignore_errors=True)
    try:
        _fill(temporary, orders, mapping, command, facts)
        publish(temporary, folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _fill(temporary: Path, orders: Sequence[Order], mapping: Path, command: str, facts: Facts) -> None:
    """Everything of a bundle into an empty folder."""
    (temporary / "policies").mkdir(parents=True)
    (temporary / "logs").mkdir()
    shown, entries = _write_policies(temporary, orders, facts)
    plan: list[dict[str, Any]] = [
        {
            "log": o.name,
            "policy": f"policies/{o.policy.name}",
            "schedule": o.schedule.model_dump(mode="json"),
            "session": o.session,
            "block": o.block,
            "role": o.role,
            **({"trim": o.trim} if facts.hold else {}),
        }
        for o in shown
    ]
    hashes = {entry["file"]: entry["policy_hash"] for entry in entries}
    rows = [{**row, "trim": row.get("trim", False), "policy_hash": hashes[row["policy"]]} for row in plan]
    _write_json(temporary / "plan.json", plan)
    _write_json(temporary / "manifest.json", manifest(facts, entries, rows))
    (temporary / PAGE).write_text(instructions(shown, mapping, command, facts, entries), encoding="utf-8")
    (temporary / CHECKSUMS).write_text(checksums(temporary), encoding="utf-8")


def visits(requests: Requests) -> str:
    """What so many requests ask of a person beside the robot."""
    more, compared = requests.at_most_more, requests.comparisons
    minutes = WARMUP_SECONDS / 60
    unless = ", where nobody is refused" if not more else ""
    why = ", ".join(f"up to {count} {reason}" for reason, count in requests.more.items() if count)
    return (
        f"Beside the robot: {_range(requests.least, more)} deploy bundles, a visit each{unless}; "
        f"{_range(compared, more)} of them compare policies and begin with {minutes:g} minutes of warming up, "
        f"{_range(compared * minutes, more * minutes)} in all. "
        + (f"More than {requests.least}: {why}. " if more else "")
        + "Fewer where the gate keeps all of an iteration out, or nobody is good enough for a final. The minutes of "
        "walking do not hold the warming up, nor first runs of new policies, nor rows that are recorded again."
    )


def _range(least: float, more: float) -> str:
    """In words, "6 to 9"; one number where there is nothing more."""
    return f"{least:g} to {least + more:g}" if more else f"{least:g}"


def check_shown(policy: Path, card: Any) -> None:
    """Raise WorldError for an imported policy of which somebody has still to show or to vouch for something. card: the
    policy's, a PolicyCard or a mapping."""
    if still_open := unproven(card):
        raise WorldError(
            f"{policy}: comes from elsewhere, and nobody has shown or vouched for its "
            f"{', '.join(still_open)}. It is not bundled for a machine: import it with a log that shows them "
            "(hts policy import … --log LOG), or put your name to them (--accept ITEM --by NAME), and begin anew."
        )


def checksums(folder: Path) -> str:
    """Lines as `sha256sum` writes and checks them, of every file in a folder."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return "".join(
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(folder).as_posix()}\n" for path in files
    )


def _write_policies(folder: Path, orders: Sequence[Order], facts: Facts) -> tuple[list[Order], list[dict[str, Any]]]:
    """Graphs and cards into `folder`/policies: the orders with the paths of theirs, and what the manifest says.

    One graph a policy; one a row where it explores, each with a seed of its own, and the mean action once beside.
    """
    named: dict[tuple[Path, str], Path] = {}
    entries, shown = [], []
    for order in orders:
        card = DeployedPolicy(order.policy).card
        check_shown(order.policy, vars(card))
        gate = gate_of(order.policy, card, facts)
        explores = bool(card.exploration_std)
        key = (order.policy, order.name if explores else "")
        if key not in named:
            named[key] = target = folder / "policies" / f"{len(named):02d}-{order.policy.name}"
            content, seed, mean = order.policy.read_bytes(), None, None
            if explores:
                mean = folder / "policies" / "mean" / order.policy.name
                mean.parent.mkdir(exist_ok=True)
                mean.write_bytes(mean_of(content))
                seed = seed_of(order.session, order.name, card.policy_hash)
                content = with_noise(content, card.exploration_std, seed)
            target.write_bytes(content)
            _write_json(
                target.with_suffix(".json"), {**vars(card), **({"exploration": "in the graph"} if explores else {})}
            )
            inside = [None if path is None else path.relative_to(folder).as_posix() for path in (target, mean)]
            entries.append(policy_entry(card, str(inside[0]), inside[1], seed, gate, facts))
        shown.append(replace(order, policy=named[key]))
    return shown, entries


def _write_json(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
