"""What a person beside a robot needs: policies, what to do with them, and how to name the logs."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.contracts import VELOCITY, FollowVelocity, RobotSpec, Task
from hts.policies.deploy import DeployedPolicy

UNSTEADY_SECONDS = 2.0  # after a swap; evaluation leaves them out


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
    orders: Sequence[Order], mapping: Path, command: str, task: Task = VELOCITY, hold: Sequence[str] = ()
) -> str:
    """README of the bundle. hold: lines about holding the speed, where it is to be held."""
    rows = [
        f"| {order.name} | {order.session} | {order.block} | {order.role} | policies/{order.policy.name} | "
        + ", then ".join(_asked(task, one) for one in order.schedule.commands)
        + (", *trim first*" if order.trim else "")
        + " |"
        for order in orders
    ]
    walks = isinstance(task, FollowVelocity)
    asked = ("speed" if hold else "commanded speed") if walks else "set-point"
    session = (
        "Logs of one session are recorded on one robot, one after the other, without a pause: swap the policy "
        f"while it {'walks' if walks else 'moves'}, or as fast as you can. Warm the robot up first, by "
        f"{'walking' if walks else 'letting it do its task'} for ten minutes; the "
        f"first {UNSTEADY_SECONDS:g} s after a swap are left out later. "
        + ("Keep the heading by hand. If it falls, stand it up and go on." if walks else "If it fails, begin it again.")
    )
    policies = (
        "Each policy is an ONNX file: input `observation`, output `action`; joint target = default_pose + "
        "action_scale * action. Its `.json` states joint order, default pose, gains, rate and the parts of the "
        "observation."
    )
    idle = "Before or after, with electronics on and motors idle, read off the idle level of each measured channel."
    lines = [
        "# What to record",
        "",
        session,
        "",
        f"| log | session | block | role | policy | {asked} |",
        "|---|---|---|---|---|---|",
        *rows,
        "",
        policies,
        "",
        *hold,
        f"1. {idle}",
        f"2. Write it, and the names of your log's columns, into `{mapping}`.",
        "3. Save the log of row 00 as `logs/00.csv` (or several files in a folder `logs/00/`), and so on.",
        f"4. Type: `{command}`",
        "",
    ]
    return "\n".join(lines)


def _asked(task: Task, command: Command) -> str:
    """What is commanded in a stretch, and for how long."""
    what = f"{command.commanded:g} {task.unit}" if task.at(command.commanded) else "the task"
    return f"{what} for {command.seconds:g} s"


def write_bundle(
    folder: Path,
    orders: Sequence[Order],
    mapping: Path,
    command: str,
    task: Task = VELOCITY,
    hold: Sequence[str] = (),
) -> None:
    """Write policies, cards, plan and instructions; complete or not at all. A bundle that is there stays as it is."""
    if folder.exists():
        return
    temporary = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(temporary, ignore_errors=True)
    (temporary / "policies").mkdir(parents=True)
    (temporary / "logs").mkdir()
    named: dict[Path, Path] = {}
    for order in orders:
        if order.policy not in named:
            number = len(named)
            named[order.policy] = target = temporary / "policies" / f"{number:02d}-{order.policy.name}"
            shutil.copyfile(order.policy, target)
            card = vars(DeployedPolicy(target).card)
            target.with_suffix(".json").write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")
    shown = [replace(order, policy=named[order.policy]) for order in orders]
    plan = [
        {
            "log": o.name,
            "policy": f"policies/{o.policy.name}",
            "schedule": o.schedule.model_dump(mode="json"),
            "session": o.session,
            "block": o.block,
            "role": o.role,
            **({"trim": o.trim} if hold else {}),
        }
        for o in shown
    ]
    (temporary / "plan.json").write_text(json.dumps(plan, indent=1) + "\n", encoding="utf-8")
    (temporary / "README.md").write_text(instructions(shown, mapping, command, task, hold), encoding="utf-8")
    temporary.rename(folder)
