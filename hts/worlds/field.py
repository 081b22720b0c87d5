"""The world `field`: a person with a robot.

A request for recordings writes a deploy bundle and ends the process (WaitingForRobot, exit code 75) with the one
command to type next. When the logs lie in the bundle, the same request reads them and goes on.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import Field

from hts.atomic import atomic_write
from hts.channels import Channel
from hts.config import Config, ScheduleConfig
from hts.contracts import HoldSpeed, Installed, Objective, Requests, Robot, Settings, World, WorldContext
from hts.envs.velocity_robot import VelocityRobot
from hts.errors import ConfigError, RecordingError, WaitingForRobot, WorldError
from hts.places import resume_command
from hts.plugins import load
from hts.recordings.needs import as_declared, check_mapping, in_units_of, levels_in_units_of
from hts.recordings.recording import Recording
from hts.worlds import field_holding, field_levels
from hts.worlds.base import ORDER, file_hash, request_id, round_order, shared_out
from hts.worlds.field_alike import with_alike_blocks
from hts.worlds.field_bundle import Order, check_shown, mapping_template, visits, write_bundle
from hts.worlds.field_commands import check_sent
from hts.worlds.field_files import LOOK_AGAIN_SECONDS, beside, check_still, log_files, may_be_cut, stamps, whole
from hts.worlds.field_logs import (
    FOLDER,
    check_judged,
    check_of_all,
    check_ran,
    check_row,
    check_sections,
    check_weighed,
    described,
    left_behind,
)
from hts.worlds.field_manifest import Facts, Frozen, run_configuration
from hts.worlds.field_once import check_once
from hts.worlds.field_pause import with_pauses
from hts.worlds.field_ran import check_whose
from hts.worlds.field_readings import check_readings


class FieldSettings(Config):
    """Settings of the world `field`."""

    mapping: Path | None = Field(
        None, description="which column of the logs is which channel; left out: one to fill in is written"
    )
    block_seconds: float = Field(80.0, gt=0, description="length of each of the four blocks of a head-to-head, s")
    frozen_seconds: float = Field(
        Frozen().seen_seconds,
        ge=0,
        le=600,
        description="for how long joints or IMU may repeat one number while the robot is moved; then the runtime stops "
        "it; 0: for ever, s",
    )
    frozen_real_seconds: float = Field(
        Frozen().real_seconds,
        ge=0,
        le=600,
        description="for how long a channel that only the robot gives may repeat one number in a row; then the runtime "
        "sits down, and a log is refused whose mapping says no other; 0: for ever, s",
    )


def make_field(settings: Settings, context: WorldContext) -> FieldWorld:
    """The world `field`."""
    return FieldWorld(FieldSettings.model_validate(dict(settings)), context)


class FieldWorld(World):
    """Deploy bundles out, logs in. A request is known by its content, so asking again after a restart finds its
    logs."""

    name = "field"
    simulated = False

    def __init__(self, settings: FieldSettings, context: WorldContext) -> None:
        self.settings, self._context = settings, context
        self._folder = Path(context.folder) / "field"
        self._hold: HoldSpeed | None = None

    def idle(self) -> Mapping[str, float]:
        """From the mapping, where the person wrote it."""
        levels = levels_in_units_of(self._objectives, self._mapping(), self._mapping_path())
        missing = [name for name, level in levels.items() if level is None]
        if missing or not levels:
            raise WaitingForRobot(
                f"The idle level of {', '.join(missing) or 'every measured channel'} is not known. With electronics on "
                f"and motors idle, read it off and write it into {self._mapping_path()}; then type: {self._command()}"
            )
        return {name: float(level) for name, level in levels.items() if level is not None}

    def beside(self, requests: Requests) -> str:
        return visits(requests)

    def check(self) -> None:
        """The policy to start from would be bundled: what an imported one needs has been shown, or somebody vouches for
        it. The mapping that the settings name can be read, by a reader that is there, and has every channel needed."""
        from hts.policies.files import load_policy
        from hts.recordings.reading import reader_name

        start = self._robot.pretrained_policy()
        if start is not None:
            check_shown(start, load_policy(start).card)
        if self.settings.mapping is None:
            self._template()
            return
        mapping = self._mapping()
        self._registry.make_log_reader(reader_name(mapping), {})
        self._check_channels(mapping, self._mapping_path())

    def _check_channels(self, mapping: Mapping[str, Any], where: Path) -> None:
        """Raise ConfigError if logs that are read so lack what the objectives' models read or what they score. where:
        of the mapping."""
        if self._hold is not None:
            field_holding.check_mapping(where, mapping)
        for objective in self._objectives:
            check_mapping(objective, mapping, where)

    def collect(self, policies: Sequence[Path], schedule: ScheduleConfig) -> list[Recording]:
        request = self._request("collect", policies, schedule.model_dump(mode="json"))
        orders = [
            Order(f"{number:02d}", Path(policy), schedule, request_id(request, number), 0, "collection")
            for number, policy in enumerate(policies)
        ]
        return self._recordings(request, orders)

    def hold_speed(self, hold: HoldSpeed | None) -> bool:
        """The person trims; needs a speed sensor, see `field_holding.SENSOR`, and a task that follows a velocity."""
        self._hold = hold if self._robot.task().can_hold else None
        return self._hold is not None

    def head_to_head_seconds(self) -> float:
        return self.head_to_head_session_seconds(1, None)

    def head_to_head_session_seconds(self, speeds: int, block_seconds: float | None) -> float:
        trimming = 2 * self._hold.seconds if self._hold is not None else 0.0
        return speeds * (len(ORDER) * (block_seconds or self.settings.block_seconds) + trimming)

    def head_to_head(self, policy: Path, reference: Path, speeds: Sequence[float]) -> list[Recording]:
        return self._heads("head to head", [policy], reference, speeds, self.settings.block_seconds)[0]

    def head_to_heads(
        self, policies: Sequence[Path], reference: Path, speeds: Sequence[float]
    ) -> list[list[Recording]]:
        """All of them in one bundle, so that one visit to the robot is enough; another one than `head_to_head` asks
        for, so a final is walked anew and no trial's logs stand for it."""
        return self._heads("head to heads", policies, reference, speeds, self.settings.block_seconds)

    def head_to_heads_in_session(
        self, policies: Sequence[Path], reference: Path, speeds: Sequence[float], block_seconds: float | None
    ) -> list[list[Recording]]:
        """The same; the bundle's rows follow each other speed by speed, so the robot stays warm."""
        seconds = block_seconds or self.settings.block_seconds
        return self._heads("session", policies, reference, speeds, seconds)

    def head_to_head_round(
        self,
        policies: Sequence[Path],
        reference: Path,
        speed: float | Sequence[float],
        number: int,
        block_seconds: float,
    ) -> list[list[Recording]]:
        """One bundle a round, its logs recorded in one go; the policies share the reference's blocks."""
        asked: float | list[float] = [float(v) for v in speed] if isinstance(speed, Sequence) else float(speed)
        rest = [asked, number, float(block_seconds), *self._holding()]
        request = self._request("round", [*policies, reference], rest)
        order = round_order(len(policies), number)
        walkers = [Path(reference if who is None else policies[who]) for who in order]
        orders: list[Order] = []
        speeds = asked if isinstance(asked, list) else [asked]
        for one in speeds:
            session = request_id(request, 0) if len(speeds) == 1 else request_id(request, 0, one)
            orders += self._orders(walkers, [w is None for w in order], one, block_seconds, session, len(orders))
        return shared_out(self._recordings(request, orders), order, len(policies))

    # ------------------------------------------------------------------------------------------ inside

    def _heads(
        self, what: str, policies: Sequence[Path], reference: Path, speeds: Sequence[float], seconds: float
    ) -> list[list[Recording]]:
        """A-B-B-A of each policy at each speed, in one bundle."""
        request = self._request(what, [*policies, reference], [*map(float, speeds), seconds, *self._holding()])
        orders: list[Order] = []
        for number, policy in enumerate(policies):
            walkers = [Path(policy if role == "policy" else reference) for role in ORDER]
            for speed in map(float, speeds):
                session = request_id(request, number, speed)
                own = [role == "reference" for role in ORDER]
                orders += self._orders(walkers, own, speed, seconds, session, len(orders))
        recordings = self._recordings(request, orders)
        width = len(ORDER) * len(speeds)
        return [recordings[i * width : (i + 1) * width] for i in range(len(policies))]

    def _orders(
        self,
        walkers: Sequence[Path],
        is_reference: Sequence[bool],
        speed: float,
        seconds: float,
        session: str,
        first: int,
    ) -> list[Order]:
        """Blocks of one session, in order; where the speed is held, who has not walked in it yet is trimmed first."""
        schedule = self._robot.task().schedule(speed, float(seconds))
        seen, orders = set[tuple[Path, bool]](), []
        for block, walker in enumerate(zip(walkers, is_reference, strict=True)):
            role = "reference" if walker[1] else "policy"
            trim = self._hold is not None and walker not in seen
            seen.add(walker)
            orders.append(Order(f"{first + block:02d}", walker[0], schedule, session, block, role, trim))
        return orders

    def _holding(self) -> list[Any]:
        """What a request's name says about holding the speed; nothing where it is not held."""
        return [self._hold.named()] if self._hold is not None else []

    def _held(self, orders: Sequence[Order]) -> HoldSpeed | None:
        """With the commands that may be sent for the speeds of these rows; None where they hold none."""
        if self._hold is None or orders[0].role == "collection":
            return None
        return replace(self._hold, commands=self._hold.within(*(order.schedule.commands[0].vx for order in orders)))

    def _recordings(self, request: str, orders: Sequence[Order]) -> list[Recording]:
        """What the logs of a bundle hold, in order; writes the bundle and waits if any is missing."""
        if not orders:
            return []
        bundle = self._folder / request
        hold = self._held(orders)
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._mapping()
            write_bundle(bundle, orders, self._mapping_path(), self._command(), self._facts(request, hold))
        except OSError as error:
            raise WorldError(f"{bundle}: the deploy bundle cannot be written ({error.strerror}).") from error
        files = {order.name: log_files(bundle / "logs", order.name) for order in orders}
        missing = [name for name, found in files.items() if not found]
        if missing:
            raise WaitingForRobot(
                f"Waiting for {len(missing)} of {len(orders)} logs from the robot ({bundle}/logs/{missing[0]}.csv and "
                f"so on). {beside(bundle / 'logs', missing)}What to record is in {bundle}/README.md; then type: "
                f"{self._command()}"
            )
        before = stamps(file for found in files.values() for file in found)
        recordings = []
        for order in orders:
            with whole(files[order.name], self._command()):
                recordings.append(self._read(files[order.name], order, bundle))
        if any(may_be_cut(recording) for recording in recordings):
            time.sleep(LOOK_AGAIN_SECONDS)
        check_still(before, self._command())
        firsts = [files[order.name][0] for order in orders]
        check_once(self._folder, self._run_folder() / "data.zarr", bundle, firsts, recordings)
        if isinstance(self._robot, VelocityRobot):
            check_readings(firsts, recordings, [order.policy for order in orders])
            check_whose(firsts, recordings, [order.policy for order in orders])
        if hold is not None:
            field_holding.check_one_command(recordings)
        said = [self._described(bundle, order) for order in orders]
        where = [path for _, path in said]
        recordings = field_levels.with_one_level(recordings, list(files), where, self._mapping_path())
        recordings = with_alike_blocks(recordings, list(files))
        return with_pauses(recordings, files, [mapping for mapping, _ in said])

    def _described(self, bundle: Path, order: Order) -> tuple[dict[str, Any], Path]:
        return described(bundle / "logs", order.name, self._mapping(), self._mapping_path())

    def _read(self, files: Sequence[Path], order: Order, bundle: Path) -> Recording:
        from hts.policies.deploy import DeployedPolicy
        from hts.recordings.mapping import load_mapping
        from hts.recordings.reading import read_log

        registry = self._registry
        card = DeployedPolicy(order.policy).card
        mapping, where = self._described(bundle, order)
        runtime = bool(self._robot.bundle_commands)
        left = left_behind(bundle / "logs", order.name) if runtime and where == self._mapping_path() else ""
        check_weighed(self._mapping_path(), mapping, left)
        self._check_channels(mapping, where)
        needed = field_levels.measured_from_idle(self._objectives, self._registry, self._robot)
        field_levels.check_stated(needed, mapping, where, self._mapping_path(), left)
        if order.role != "collection":
            check_judged(self._robot.task(), mapping, where)
        facts = {key: value for key, value in dict(mapping.get("recording") or {}).items() if value is not None}
        check_ran(where, facts, card, order.policy.name)
        asked = {
            "session": order.session,
            "schedule": order.schedule.model_dump(mode="json"),
            "block": order.block,
            "role": order.role,
        }
        if where != self._mapping_path():
            check_row(where, load_mapping(where).get("recording") or {}, asked)  # the run's own says no row
        facts |= {"world": self.name, "policy_hash": card.policy_hash, **asked}
        frozen = self.settings.model_dump(include={"frozen_real_seconds"}, exclude_defaults=True)
        declared = as_declared(self._objectives, mapping)
        try:
            recording = read_log(registry, files, {**frozen, **declared, "recording": facts}, self._robot)
        except ConfigError as error:
            raise ConfigError(f"Row {order.name}: {where}: {error}") from error
        recording = in_units_of(self._objectives, recording, self._robot.channels(), f"Row {order.name}: {where}")
        if order.role != "collection":
            field_holding.check_speed_read(files[0], recording, self._robot.task(), {**frozen, **mapping})
        longer = recording.seconds - order.schedule.seconds
        if abs(longer) > 0.1 * order.schedule.seconds and not (longer < 0 and recording.fell):
            raise RecordingError(
                f"{files[0]}: {recording.seconds:.1f} s long, but {order.schedule.seconds:g} s were to be recorded. "
                "If not all of it was copied, copy it again; cut the log to the block it belongs to, or record it "
                "again; if the robot fell there, say "
                f"recording.fell: true in the log's own mapping, logs/{FOLDER}/{order.name}.yaml."
            )
        if self._hold is not None and order.role != "collection":
            return field_holding.held(files, recording, self._hold, order.trim)
        check_sent(files[0], order.name, recording)
        return recording

    @cached_property
    def _registry(self) -> Installed:
        return self._context.registry or load()

    @cached_property
    def _objectives(self) -> list[Objective]:
        return [self._registry.make_objective(name, given) for name, given in self._context.objectives.items()]

    @cached_property
    def _robot(self) -> Robot:
        return self._registry.make_robot(self._context.robot, self._context.robot_settings)

    def _mapping_path(self) -> Path:
        return self.settings.mapping or self._folder / "mapping.yaml"

    def _mapping(self) -> dict[str, Any]:
        """The mapping; if it is the run's own and not there yet, one to fill in."""
        from hts.recordings.mapping import load_mapping

        path = self._mapping_path()
        if self.settings.mapping is None and not path.exists():
            atomic_write(path, self._template())
        if not path.exists():
            raise ConfigError(
                f"{path}: there is no such mapping of the log. Put it there, or where it lies into world.mapping, of a "
                "run that was begun in its config.yaml."
            )
        mapping = load_mapping(path)
        check_sections(path, mapping)
        check_of_all(path, mapping)
        return mapping

    def _template(self) -> str:
        """A mapping to fill in: the robot's channels, and what only the robot gives for the objectives."""
        return mapping_template(self._robot.spec, self._robot.channels(), self._real_channels())

    def _real_channels(self) -> list[Channel]:
        """What only the robot gives for the objectives."""
        return field_levels.real_channels(self._objectives, self._registry, self._robot)

    def _facts(self, request: str, hold: HoldSpeed | None) -> Facts:
        """What a bundle says of the robot and the run."""
        robot, run = self._robot, self._run_folder()
        return Facts(
            spec=robot.spec,
            request=request,
            hold=hold,
            sim=robot.channels(),
            real=self._real_channels(),
            run=run_configuration(run),
            folder=run,
            frozen=Frozen(self.settings.frozen_seconds, self.settings.frozen_real_seconds),
            commands=robot.bundle_commands,
            own_env=not isinstance(robot, VelocityRobot),
            task=robot.task(),
        )

    def _request(self, what: str, policies: Sequence[Path], rest: Any) -> str:
        try:
            return request_id(what, [file_hash(policy) for policy in policies], rest)
        except OSError as error:
            raise WorldError(f"{error.filename}: this policy cannot be read ({error.strerror}).") from error

    def _run_folder(self) -> Path:
        """The run that this world's folder belongs to."""
        folder = Path(self._context.folder)
        return next((place for place in (folder, *folder.parents) if (place / "config.yaml").exists()), folder)

    def _command(self) -> str:
        """What to type next, quoted for a shell: what asked says it; else the run goes on."""
        return self._context.command or resume_command(self._run_folder())
