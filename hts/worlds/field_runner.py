"""What the bundle's README says of the program that does its rows: the runtime that the robot's package brings, or all
that a runner of somebody's own has to do."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from hts.contracts import RobotSpec
from hts.evaluation.segments import SETTLE_SECONDS
from hts.worlds.field_places import CHECKSUMS

Entry = Mapping[str, Any]
LOOP = ("joint_names", "default_pose", "action_scale", "kp", "kd", "control_rate_hz", "observation", "history")
"""Of the manifest's entry of a policy: what its loop is made from."""


def who_does_the_rows(robot: str, commands: Sequence[str], metres: float | None) -> str:
    """The beginning of the page: what to do with a runtime, in short steps. commands: `Robot.bundle_commands`; metres:
    how far the rows walk in all, None where nobody walks."""
    if not commands:
        return (
            f"The package of the robot '{robot}' brings no runtime, so nothing of hts moves it: these rows are done by "
            "a program of your own, and *What your runner has to do*, below, says what it needs."
        )
    typed = "\n".join(f"       {command}" for command in commands)
    way = (
        "Keep everybody and everything away from the robot."
        if metres is None
        else f"Clear the way. The rows and what comes before them are about {metres:.0f} m, straight on where they "
        "command no turn and without a pause (a `--rows` of some is less). The robot sees nothing that is in its way."
    )
    rests = "where it cannot fall" if metres is None else "lay it down with its limbs folded, or hang it up"
    return f"""\
## Step by step, with the runtime

A runtime that comes with the package of the robot '{robot}' does the rows by itself, and writes `logs/` and what
describes them.

1. Copy this whole folder to the robot's computer. There, type `sha256sum -c {CHECKSUMS}`: has it arrived whole?
2. {way}
3. Let the robot rest: {rests}. One person looks at the robot only, with the stop key in the hand
   (*What to watch* and *When to stop*, below).
4. Type in this folder, one after the other. Read each question before you answer it: it says what begins, what stops
   the robot, and what there is to know.

{typed}

5. It ended early? Read the last line, look at the robot, do what the line says, and type the last command again. Rows
   that have a log are not done again. To do one again, move its log out of `logs/`.
6. Copy all of `logs/`, `logs/mappings/` too, back into this folder beside the run.
7. Go on with *Then*, below: its step 3 is done, and of step 2 at most the weight is left (`mass_kg`), which the runtime
   may have been told."""


def runner(spec: RobotSpec, entries: Sequence[Entry], first: Mapping[str, float], walks: bool, own_env: bool) -> str:
    """A section for robots whose package brings no runtime. entries: of the manifest's policies; first: `first_runs`;
    walks: whether it follows a velocity; own_env: whether it is trained in an env of its package."""
    groups: dict[str, list[Entry]] = {}
    for entry in entries:
        groups.setdefault(json.dumps([entry[key] for key in LOOP]), []).append(entry)
    return "\n".join(
        [
            "## What your runner has to do",
            "",
            (
                "The numbers are those of `manifest.json`, where a program finds them unrounded. Look for yourself "
                "whether they are those of your machine: nobody has tried this loop on it."
            ),
            "",
            *(line for group in groups.values() for line in _loop(spec, group, len(groups) == 1, own_env)),
            *_care(first, walks),
        ]
    )


def _loop(spec: RobotSpec, group: Sequence[Entry], alone: bool, own_env: bool) -> Iterator[str]:
    """Of policies that are run in the same way."""
    one = group[0]
    rate, width = float(one["control_rate_hz"]), sum(int(part["size"]) for part in one["observation"])
    if not alone:
        yield from ("### " + ", ".join(f"`{entry['file']}`" for entry in group), "")
    yield (
        f"**Loop.** {rate:g} times a second, each {1000 / rate:.4g} ms, at fixed instants: read the sensors, fill "
        f"`observation`, run the graph, send what it asks for to the drives. A graph takes `observation`, float32 "
        f"(1, {width * int(one['history'])}), and gives `action`, float32 (1, {len(one['joint_names'])})."
    )
    stacked = ""
    if int(one["history"]) > 1:
        stacked = (
            f" The last {one['history']} of them lie one behind the other, the newest last, zeros before there are "
            "so many."
        )
    yield from (
        "",
        f"**Observation**, as measured (mean and standard deviation are in the graph), in this order.{stacked}",
        "",
        "| from | to | part | unit | what |",
        "|---|---|---|---|---|",
    )
    place = 0
    for part in one["observation"]:
        size = int(part["size"])
        meaning = part["meaning"] or "as the robot's env in its package writes it"
        yield f"| {place} | {place + size - 1} | {part['name']} | {part['unit'] or 'see there'} | {meaning} |"
        place += size
    yield from ("", _targets(own_env), "", "Joints in this order, in observation, action and log:", "")
    yield from (
        (
            "| joint | default_pose, rad | action_scale, rad | kp, N·m/rad | kd, N·m·s/rad | range, rad | speed, rad/s "
            "| torque, N·m |"
        ),
        "|---|---|---|---|---|---|---|---|",
    )
    limits = zip(spec.position_limit, spec.velocity_limit, spec.torque_limit, strict=True)
    limits_of = dict(zip(spec.joint_names, limits, strict=True))
    for name, *own in zip(*(one[key] for key in LOOP[:5]), strict=True):
        cells = [name, *(f"{value:.6g}" for value in own)]
        if name in limits_of:
            (low, high), speed, torque = limits_of[name]
            cells += [f"{low:.6g} to {high:.6g}", f"{speed:.6g}", f"{torque:.6g}"]
        else:  # a policy file of another machine's
            cells += ["not known"] * 3
        yield "| " + " | ".join(cells) + " |"
    yield ""


def _targets(own_env: bool) -> str:
    """What becomes of an action."""
    means = "An action moves the joints' targets"
    if own_env:
        means = (
            "What an action does is what the env in the robot's package makes of it, so read it there. If it moves no "
            "joint's target, `control.target` of the manifest does not hold; else"
        )
    return (
        f"**Actions.** {means}: joint target, rad = default_pose + action_scale · action, torque = kp (target − q) − "
        "kd q̇. No action is clipped, and the action as it came from the graph is the next step's `last_action`, where "
        "that is observed."
    )


def _care(first: Mapping[str, float], walks: bool) -> Iterator[str]:
    """What it must look at before and while the robot moves, and what it leaves behind."""
    trunk = "the trunk leans too far, " if walks else ""
    share, scale, seconds = first["torque_scale"], first["speed_scale"], first["seconds"]
    yield (
        "**Before it moves anything**: compare the checksums; joint order, gains and limits with the drives' own; "
        "refuse a `schema_version` above 1, a graph whose sizes are not those of the manifest, and a policy whose "
        "`gate` says `passed: false`, unless a person vouches for it; ask the person whether it may move."
    )
    yield ""
    yield (
        "**In each step**: no target beyond a joint's range, no torque beyond its limit (in a first run of a policy "
        f"{share:.0%} of it, at {scale:.0%} of the command, for {seconds:g} s). Go over to damping, kp = 0, at once "
        "and for good where a state or a target is not finite, a joint leaves its range or its speed, "
        f"{trunk}a motor or the supply leaves its limits, no state has come for about a step, a step is late by more "
        "than one, a sensor repeats its last number while the robot moves (`frozen`), or the person says so: a key "
        "that works whatever else hangs."
    )
    yield ""
    yield (
        "**Its log**: a row each step, with a time on one clock, of every channel of `manifest.json`'s `channels` "
        "(real: also its level with idle motors): the state that the action was computed from, and the target that "
        "was sent. A row of the plan is one log, of the row's length; policies are swapped without a pause."
    )
    if walks:
        yield ""
        yield (
            "**Where the floor is shorter than a row** it may turn round and go on, if the same turn is commanded to "
            "every policy, and if each row still has its seconds of straight walking (`turns` of the manifest): a "
            f"column `phase` is 0 in those, and another number while it turns and for {SETTLE_SECONDS:g} s of settling "
            "at the row's command after that. Write `only: {column: phase}` into the mapping: the others are left out."
        )
