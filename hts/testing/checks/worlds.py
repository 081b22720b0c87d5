"""Worlds: what they cost and what they record, tried with the kit's own robot and objective.

A world that refuses these (it has one kind of machine) is tried with a robot of its own package and an objective of
that package, of the kit, or of any other.
"""

from __future__ import annotations

import copy
import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hts.config import ScheduleConfig
from hts.contracts import HoldSpeed, World, WorldContext
from hts.errors import ConfigError, WaitingForRobot
from hts.plugins import Entry, Registry
from hts.recordings.recording import Recording
from hts.testing.checks.ensure import ensure, listed, same
from hts.testing.checks.made_up import Case, case_for
from hts.testing.packages import kit_installed

SPEEDS = (0.5, 0.8)
"""m/s, for a robot that follows a velocity; another task is tried at its own set-points."""
ORDERS = [["reference", "policy", "policy", "reference"], ["policy", "reference", "reference", "policy"]]
SHORT = {"block_seconds": 2.0, "warmup_seconds": 1.0}
"""Settings that many worlds have; given to those that take them, so that a check is short."""


def costs_nothing_yet(entry: Entry, registry: Registry) -> None:
    """Making it writes nothing and changes nothing it is given; it knows its name and its cost, and closes twice."""
    with tempfile.TemporaryDirectory() as folder:
        given = case_for(entry, registry).context(Path(folder))
        before = copy.deepcopy(given)
        with kit_installed():
            world = entry.factory({}, given)
            ensure(isinstance(world, World), f"is a {type(world).__name__}, not a hts.contracts.World")
            ensure("name" in dir(world), f'does not say its name: add `name = "{entry.name}"` to its class')
            ensure(world.name == entry.name, f"calls itself '{world.name}'")
            ensure(
                world.simulated is not None,
                "does not say whether it is simulated: add `simulated = True` (or False, where a machine moves)",
            )
            ensure(given == before, "changes its context in place")
            ensure(not list(Path(folder).iterdir()), "writes files when it is made")
            cost = dict(world.cost(60.0))
            ensure(cost.get("robot_minutes") == 1.0, f"says that 60 s of walking cost {cost}")
            ensure(
                all(math.isfinite(value) for value in cost.values()), f"cost holds numbers that are not finite: {cost}"
            )
            world.close()
            world.close()


def gives_recordings(entry: Entry, registry: Registry) -> None:
    """collect gives one whole recording per policy, in order, the same again; or it waits for a person in one line."""
    with _world(entry, registry) as (world, case, policy, folder):
        task = case.robot.task()
        schedule = ScheduleConfig(commands=tuple(task.command(point, 1.5) for point in _set_points(case)))
        try:
            recordings = world.collect([policy, policy], schedule)
        except WaitingForRobot as waiting:
            ensure("\n" not in str(waiting), f"waits in several lines: {waiting}")
            return
        _several("collect", recordings)
        ensure(len(recordings) == 2, f"gives {len(recordings)} recordings for 2 policies")
        idle = world.idle()
        ensure(all(math.isfinite(level) for level in idle.values()), f"idle levels are {dict(idle)}")
        for recording in recordings:
            _whole(recording, case, entry.name, schedule.seconds, folder)
            target = case.objective.target.name
            ensure(target in recording.idle, f"recordings have no idle level of '{target}'")
        again = world.collect([policy, policy], schedule)
        for first, second in zip(recordings, again, strict=True):
            for name in first.channels:
                ensure(same(first.values(name), second.values(name)), f"'{name}' is another one when asked again")


def compares_on_one_machine(entry: Entry, registry: Registry) -> None:
    """head_to_head gives blocks A-B-B-A, of one session per speed or set-point, with their roles; or it waits."""
    with _world(entry, registry) as (world, case, policy, folder):
        points = _set_points(case)
        try:
            recordings = world.head_to_head(policy, policy, points)
        except WaitingForRobot:
            return
        _several("head_to_head", recordings)
        wanted = 4 * len(points)
        ensure(
            len(recordings) == wanted, f"gives {len(recordings)} recordings for {len(points)} speeds, not 4 blocks each"
        )
        for blocks in (recordings[first : first + 4] for first in range(0, wanted, 4)):
            roles = [recording.role for recording in blocks]
            ensure(roles in ORDERS, f"roles of its blocks are {roles}")
            ensure(len({recording.session for recording in blocks}) == 1, "blocks of one speed are of several sessions")
            speeds = {command.commanded for recording in blocks for command in recording.schedule.commands}
            ensure(len(speeds) == 1, f"blocks of one session have commanded speeds of {sorted(speeds)}")
            for recording in blocks:
                _whole(recording, case, entry.name, recording.schedule.seconds, folder)
        sessions = {recording.session for recording in recordings}
        ensure(
            len(sessions) == len(points),
            f"{len(points)} speeds are {len(sessions)} session(s), so their blocks would be mixed",
        )


def _set_points(case: Case) -> tuple[float, ...]:
    """What it is tried at: two at most."""
    return case.robot.task().defaults[:2] or SPEEDS


def holds_the_speed_that_it_says(entry: Entry, registry: Registry) -> None:
    """A world that holds a speed freezes one command per policy, sends it, and writes it down; others say that they
    cannot."""
    hold = HoldSpeed((0.1, 1.5), seconds=4.0)
    with _world(entry, registry) as (world, case, policy, _):
        if not case.robot.task().can_hold:
            return
        if not world.hold_speed(hold):
            return
        try:
            recordings = world.head_to_head(policy, policy, (0.8,))
        except WaitingForRobot:
            return
        for recording in recordings:
            asked = {command.vx for command in recording.schedule.commands}
            ensure(asked == {0.8}, f"was asked to hold 0.8 m/s and its schedule says {sorted(asked)}")
            lacking = {"held_command", "held_saturated"} - set(recording.notes)
            ensure(not lacking, f"says that it holds the speed, and its recordings have no note {listed(lacking)}")
            command = float(recording.notes["held_command"])
            ensure(0.1 <= command <= 1.5, f"sent {command:g} m/s, where 0.1 to 1.5 were allowed")
            if "command" in recording.channels:
                sent = recording.values("command")[:, 0]
                steady = abs(sent - command).max() < 1e-3
                ensure(steady, f"noted a command of {command:g} m/s and sent {sent.min():g} to {sent.max():g}")
        for role in ("policy", "reference"):
            found = {recording.notes["held_command"] for recording in recordings if recording.role == role}
            ensure(len(found) == 1, f"sent the {role} {len(found)} commands in one head-to-head, not a frozen one")
        ensure(world.hold_speed(None) is False, "still holds the speed after hold_speed(None)")


def _several(method: str, found: object) -> None:
    """What a world gave is a list of recordings."""
    ensure(isinstance(found, list | tuple), f"{method} gives a {type(found).__name__}, expected a list of recordings")
    wrong = [type(one).__name__ for one in found if not isinstance(one, Recording)]  # type: ignore[attr-defined]
    ensure(not wrong, f"{method} gives a {wrong[0] if wrong else ''} among its recordings")


def _whole(recording: Recording, case: Case, world: str, seconds: float, folder: Path) -> None:
    """What the store and the rest of a run need of a recording."""
    from hts.recordings.store import RecordingStore

    ensure(
        (recording.robot, recording.world) == (case.names[0], world),
        f"its recordings are of {recording.robot} in {recording.world}",
    )
    ensure(bool(recording.policy_hash), "its recordings do not say which policy ran")
    ensure(
        abs(recording.seconds - seconds) < 0.1 * seconds,
        f"{seconds:g} s were asked for, {recording.seconds:g} s are recorded",
    )
    measured = {channel.name: channel for channel in case.objective.real_channels}
    wanted = {**case.robot.channels(), **measured}
    lacking = set(wanted) - set(recording.channels)
    ensure(not lacking, f"its recordings lack {listed(lacking)}")
    for name, channel in wanted.items():
        found = recording.channels[name].channel
        ensure(
            (found.unit, found.shape) == (channel.unit, channel.shape),
            f"'{name}' is {found.unit} {found.shape}, not {channel.unit} {channel.shape}",
        )
    RecordingStore(folder / "data.zarr", create=True).write(recording)  # refuses NaN, wrong shapes and times


@contextmanager
def _world(entry: Entry, registry: Registry) -> Iterator[tuple[World, Case, Path, Path]]:
    """The world, whom it is for, an exported policy, and a folder; all gone afterwards."""
    from hts.policies.export import to_onnx
    from hts.policies.files import load_policy

    with tempfile.TemporaryDirectory() as name, kit_installed():
        case, folder = case_for(entry, registry), Path(name)
        source = case.robot.pretrained_policy()
        ensure(source is not None, f"takes no robot with a policy to try, only '{case.names[0]}'")
        assert source is not None
        policy = to_onnx(load_policy(source, case.robot.spec), folder / "policy.onnx")
        given = case.context(folder / "world")
        world = entry.factory(_short(entry, given), given)
        try:
            yield world, case, policy, folder
        finally:
            world.close()


def _short(entry: Entry, given: WorldContext) -> dict[str, float]:
    """Those of SHORT that the world takes."""
    taken = {}
    for key, value in SHORT.items():
        try:
            entry.factory({key: value}, given).close()
        except (ConfigError, ValueError):  # ValueError: what pydantic raises
            continue
        taken[key] = value
    return taken


CHECKS = (costs_nothing_yet, gives_recordings, compares_on_one_machine, holds_the_speed_that_it_says)
