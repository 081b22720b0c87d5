"""A session with a bundle: idle, stand up, warm up, rows with trimming and swaps, sit down; or a stop."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hts_go1_runtime import first_run
from hts_go1_runtime.bundle import Bundle
from hts_go1_runtime.errors import RuntimeFault, Stopped
from hts_go1_runtime.events import Events
from hts_go1_runtime.falls import WHILE_TRIMMED, Walked, fell
from hts_go1_runtime.first_run import FirstRun, walked_before
from hts_go1_runtime.frozen import Missing, RowSensors
from hts_go1_runtime.gated import vouched_for
from hts_go1_runtime.heading import STRAIGHT, Heading
from hts_go1_runtime.held import FILE, read_held, written
from hts_go1_runtime.idle import Readings, changed, check_read, levels, readings
from hts_go1_runtime.keeping import Keeper
from hts_go1_runtime.link import Command, Link, State
from hts_go1_runtime.log import RowLog, mapping, measured, samples
from hts_go1_runtime.loop import FIRST_STATE, Loop
from hts_go1_runtime.meeting import NEEDED, check_channels, check_draws, check_lies, meet
from hts_go1_runtime.nearing import Nearing
from hts_go1_runtime.options import Options
from hts_go1_runtime.policy import Policy
from hts_go1_runtime.poses import LETTING_GO, sit_down, stand_up
from hts_go1_runtime.question import question
from hts_go1_runtime.rest import Rest
from hts_go1_runtime.room import lane_for
from hts_go1_runtime.rows import Row, steps_of
from hts_go1_runtime.trained import over, ranges_of
from hts_go1_runtime.trimming import Trimming
from hts_go1_runtime.when import noted as noted_when

STILL = [(LETTING_GO, 0.0, 0.0, 0.0)]
DAMP_SECONDS = 1.0  # of repeated damping commands after a stop, in case some are lost


class Session:
    """One visit to the robot."""

    def __init__(self, bundle: Bundle, link: Link, loop: Loop, options: Options, events: Events) -> None:
        self.bundle, self.link, self.loop, self.options, self.events = bundle, link, loop, options, events
        self.rest = Rest(bundle.folder / "SIT")
        self.limited_targets = 0  # joint targets that left the joint's range and were sent as its end
        self._keeper = Keeper(events)
        self._nearing = Nearing(loop.limits, loop.period, options.frozen_real_seconds)
        self._channels: list[str] = []
        self._needed = Missing(())  # of what the robot measures, that by which it is stopped
        self._idle: dict[str, float] = {}
        self._when: dict[str, str] = {}  # the present row began
        self._torque_share = 1.0  # of what the joints may be told
        self.heading: Heading = Heading()
        self._held = read_held(bundle.logs, bundle.hold)
        self._vouched: dict[str, str] = {}

    @property
    def done(self) -> list[str]:
        """Names of the logs that were recorded."""
        return self._keeper.done

    def run(self, confirm: Callable[[str], None] = lambda text: None) -> list[str]:
        """Names of the logs that were recorded. confirm: asked before the robot moves. Raises Stopped, RuntimeFault."""
        rows = self._rows()
        self._vouched = vouched_for([row.policy for row in rows], self.bundle.policies, self.options.vouched)
        for file, why in self._vouched.items():
            self.events.say("vouched for", policy=file, gate=why)
        with self.events.stops():
            self._meet(rows)
            if self.options.straight is not None:
                self.heading = lane_for(
                    self.bundle, rows, self.options, self.loop.period, self._channels, self.events.say
                )
            confirm(self._question(rows))
            check_lies(self.loop.resume() or [self.loop.state])  # somebody may have thought for long
        try:
            self._visit_and_settle(rows)
        except RuntimeFault:  # the disk may be why, and rows of before it elsewhere by now
            self._keeper.check_kept()
            raise
        self._keeper.check_kept()
        return self.done

    def _visit_and_settle(self, rows: Sequence[Row]) -> None:
        """A visit, after which the robot is let go and what was recorded comes to rest somewhere."""
        try:
            with self.events.stops():
                self._visit(rows)
        finally:
            self.loop.damp(DAMP_SECONDS)
            self._keeper.wait()

    def _visit(self, rows: Sequence[Row]) -> None:
        """From lying to lying."""
        seen, self._idle = self._measure_idle("idle")
        check_read(seen)
        check_draws(self._idle.get("battery_current", self.loop.state.current))
        self.rest.check()
        self._stand_up()
        try:
            self._walk_rows(rows)
        except Stopped:
            raise
        except Exception as error:  # whatever it is, the robot is not left standing
            self.events.say("broken off, it sits down", why=" ".join(f"{type(error).__name__}: {error}".split()))
            self._sit_down()
            raise
        self._sit_down()
        self._idle_again()

    # ------------------------------------------------------------------------------------------ before walking

    def _rows(self) -> list[Row]:
        wanted = self.options.rows
        known = [row.log for row in self.bundle.rows]
        for name in wanted:
            if name not in known:
                raise RuntimeFault(f"--rows {name}: the bundle has rows {', '.join(known)}.")
        logs = self.bundle.logs
        rows = [
            row for row in self.bundle.rows if (row.log in wanted if wanted else not (logs / f"{row.log}.csv").exists())
        ]
        there = [row.log for row in rows if (logs / f"{row.log}.csv").exists() or (logs / row.log).exists()]
        if there:
            raise RuntimeFault(f"{logs}: has logs of {', '.join(there)} already. Move them away to record them again.")
        if not rows:
            raise RuntimeFault(f"{logs}: every row has its log. Nothing is left to record.")
        return rows

    def _meet(self, rows: Sequence[Row]) -> None:
        """First words with the robot: what it measures, and whether that is enough."""
        self.events.say("waiting for the robot's first state", at_most_s=FIRST_STATE)
        self._channels = measured(meet(self.loop))
        self._needed = Missing(name for name in self._channels if name in NEEDED)
        self._nearing.see(self.loop.state)
        if not self.options.first_run:
            check_channels(self.bundle.manifest["channels"], self._channels, self.options.external)
        if self.bundle.hold and any(row.trim for row in rows) and "base_velocity" not in self._channels:
            raise RuntimeFault(
                "The speed is to be held, but the link gives no speed of the trunk. Connect the speed sensor (motion "
                "capture or a camera)."
            )
        missing = [name for name in self.bundle.manifest["channels"] if name not in self._channels]
        if missing:
            self.events.say("not measured by this link", channels=missing)

    def _question(self, rows: Sequence[Row]) -> str:
        return question(
            self.bundle,
            rows,
            self.events,
            volts=self.loop.state.voltage,
            first_run=self.options.first_run,
            vouched=self._vouched,
            channels=self._channels,
            warmup=self._warmup_seconds(rows[0]),
            straight=self.options.straight,
        )

    def _measure_idle(self, what: str) -> tuple[Readings, dict[str, float]]:
        """What the battery monitor shows, and the levels."""
        seen = readings(self.loop, self._channels, self.options.idle_seconds)
        found = levels(seen)
        if found:
            self.events.say(what, **{name: round(level, 3) for name, level in found.items()})
        return seen, found

    def _idle_again(self) -> None:
        """The levels once more after a visit that recorded something: the logs state those of before it."""
        if self.options.first_run:
            return
        _, after = self._measure_idle("idle after")
        if changed(self._idle, after):
            self.events.say(
                "the idle current has changed: something else draws, find it and record again",
                before=round(self._idle["battery_current"], 3),
                after=round(after["battery_current"], 3),
            )

    def _stand_up(self) -> None:
        stand_up(self.loop, self.bundle.reach)
        self.events.say("standing")

    def _sit_down(self) -> None:
        sit_down(self.loop, self.bundle.reach)
        self.events.say("sat down")

    # ------------------------------------------------------------------------------------------ walking

    def _walk_rows(self, rows: Sequence[Row]) -> None:
        if self.options.first_run:
            self._first_runs(rows)
            return
        self._warm_up(rows[0])
        for row in rows:
            self._row(row)
        self._stroll(self.bundle.policies[rows[-1].policy], STILL)

    def _first_runs(self, rows: Sequence[Row]) -> None:
        """Each policy once, slowly and weakly, recording nothing."""
        first, walked = FirstRun.of(self.bundle.manifest), walked_before(self.bundle)
        self._torque_share = first.torque_scale
        for file in dict.fromkeys(row.policy for row in rows):
            commands = first.commands(rows, file)
            self.events.say("first run", policy=file, commands=[[round(v, 3) for v in one[1:]] for one in commands])
            self._stroll(self.bundle.policies[file], commands)
            walked.add(self.bundle.policies[file].entry["policy_hash"])
            self.events.keep(self.bundle.logs / first_run.FILE, first_run.written(walked))
        self._stroll(self.bundle.policies[rows[-1].policy], STILL)

    def _warmup_seconds(self, row: Row) -> float:
        """How long to walk before the first head-to-head, so that the motors are warm; the others follow without a
        pause."""
        asked = self.options.warmup_seconds
        seconds = float(self.bundle.manifest["warmup_seconds"]) if asked is None else asked
        return 0.0 if row.role == "collection" else seconds

    def _warm_up(self, row: Row) -> None:
        seconds = self._warmup_seconds(row)
        if seconds > 0:
            self.events.say("warming up", seconds=seconds)
            self._stroll(self.bundle.policies[row.policy], [(seconds, *row.commands[0][1:])])

    def _row(self, row: Row) -> None:
        """Record one row, trimmed first where the bundle says so."""
        policy = self.bundle.policies[row.policy]
        commands = steps_of(row.commands, self.bundle.rate_hz)
        self._when = noted_when(self.link.simulated)
        if self.bundle.hold and row.role != "collection":
            key = f"{row.session} {row.role} {row.policy_hash} {row.commands[0][1]:g}"
            if row.trim or key not in self._held:
                self._held[key] = self._trim(policy, row)
                self.events.keep(self.bundle.logs / FILE, written(self._held))
            commands[:, 0] = self._held[key][0]
        self.events.say("row", log=row.log, policy=row.policy, seconds=row.seconds)
        self._when = noted_when(self.link.simulated)
        log = RowLog(self.bundle.logs, row.log, self._channels, self._described(row))
        self.heading.begin()
        policy.start()
        sensors = self._sensors(row)

        def after(state: State) -> None:
            sensors.see(state)
            self._keeper.check(log)

        try:
            for command in commands:
                self._walk(policy, command, log, after)
        except Exception as ended:
            if fell(ended, row, log.rows):
                self._fallen(log, row)
            else:
                self._keeper.broken_off(log)
            raise
        log.closing()
        self._keeper.walked(log, row)

    def _sensors(self, row: Row) -> RowSensors:
        """What has to go on measuring in a row: the current where somebody asked for it, the speed where rows are
        compared; not what another sensor logs."""
        asked, external = self.options.frozen_real_seconds, self.options.external
        seconds = self.bundle.frozen.real if asked is None else asked
        current = "battery_current" in self.bundle.manifest["channels"] and "battery_current" not in external
        speed = row.role != "collection" and "base_velocity" not in external
        return RowSensors(self._channels, seconds if current else 0.0, seconds if speed else 0.0)

    def _trim(self, policy: Policy, row: Row) -> tuple[float, bool]:
        hold = self.bundle.hold
        assert hold is not None
        asked, vouched = row.commands[0][1], self.options.at_limit
        trimming = Trimming(asked, hold.commands, hold.seconds, self.loop.period, vouched)
        self.heading.begin()
        policy.start()
        walked = Walked(round(row.seconds / self.loop.period))
        try:
            for _ in range(round(hold.seconds / self.loop.period)):
                state = self._walk(policy, np.array([trimming.command, 0.0, 0.0]), walked)
                trimming.see(float(state.velocity[0]))
        except Stopped as stopped:
            if fell(stopped, row, len(walked)):
                log = RowLog(self.bundle.logs, row.log, self._channels, self._described(row))
                walked.into(log)
                self._fallen(log, row, **{WHILE_TRIMMED: "true"})
            raise
        command, saturated = trimming.found()
        self.events.say("trimmed", log=row.log, asked=asked, command=round(command, 4), at_limit=saturated)
        if over(ranges_of(policy), "vx", command):
            self.events.say("trimmed to more than was trained for", log=row.log, trained=ranges_of(policy)["vx"])
        trimming.check()
        return command, saturated

    def _fallen(self, log: RowLog, row: Row, **notes: str) -> None:
        """Keep what was walked until a fall as the row's log."""
        log.closing(described=self._described(row, fell=True, **notes))
        self._keeper.walked(log, row)
        self.events.say("fell: kept as this row's log; to walk the row again, move the log away", log=row.log)

    def _stroll(self, policy: Policy, commands: Sequence[tuple[float, float, float, float]]) -> None:
        """Walk without recording; turns are part of it, and no policy leaves half of one to the next."""
        self.heading.begin()
        policy.start()
        steps = steps_of(commands, self.bundle.rate_hz)
        for command in steps:
            self.heading.counts(command)
            self._step(policy, command, None)
        while self.heading.phase != STRAIGHT and not self.heading.counts(steps[-1]):
            self._step(policy, steps[-1], None)

    def _walk(
        self,
        policy: Policy,
        asked: np.ndarray,
        log: RowLog | Walked,
        after: Callable[[State], None] = lambda state: None,
    ) -> State:
        """A step of straight walking, whose state it returns; before it whole turns, where the straight is over. after:
        what is done after each step of them all."""
        while True:
            counts = self.heading.counts(asked)
            state = self._step(policy, asked, log)
            after(state)
            if counts:
                return state

    def _step(self, policy: Policy, asked: np.ndarray, log: RowLog | Walked | None) -> State:
        """One control step of a policy; recorded if there is a log."""
        given: dict[str, Any] = {}
        reach = self.bundle.reach

        def make(state: State) -> Command:
            given["began"] = time.perf_counter()
            given["sent"] = sent = self.heading.steered(policy, asked, state)
            targets = policy.targets(state, sent)
            if np.isfinite(targets).all():  # else the loop stops the robot: a limit would make a number of infinity
                if self._torque_share < 1 or reach.weaker:
                    targets = reach.weakened(targets, policy.kp, policy.kd, state, self._torque_share)
                kept = reach.inside(targets)
                self.limited_targets += int(np.count_nonzero(kept != targets))
                targets = kept
            given["command"] = command = Command(targets, policy.kp, policy.kd)
            return command

        state = self.loop.tick(make)
        self.rest.check()
        if log is not None:
            counts, now, took = self.link.counts, self.link.now(), time.perf_counter() - given["began"]
            noted = (state.stamp, 1e3 * (now - state.received), 1e3 * (now - self.loop.due), 1e3 * took)
            told = (*noted, counts.lost, counts.late, self.heading.phase)
            log.write(now, samples(state, given["sent"], given["command"]), told)
        self.heading.see(state, given["sent"])
        self._nearing.see(state)
        self._needed.see(state)
        return state

    # ------------------------------------------------------------------------------------------ the log

    def _described(self, row: Row, fell: bool = False, **notes: str) -> str:
        """The mapping beside a log."""
        policy = self.bundle.policies[row.policy]
        keys = ("seconds", "vx", "vy", "yaw_rate")
        facts: dict[str, Any] = {
            "clock": "simulated" if self.link.simulated else "monotonic",
            "policy_hash": row.policy_hash,
            "kp": policy.kp.tolist(),
            "kd": policy.kd.tolist(),
            "session": row.session,
            "block": row.block,
            "role": row.role,
            "schedule": {"commands": [dict(zip(keys, one, strict=True)) for one in row.commands]},
            "notes": {
                "unsteady_seconds": f"{self.bundle.manifest['control']['unsteady_seconds']:g}",
                "recorded_by": "hts_go1_runtime",
                **self._when,
                **notes,
            },
            **({"fell": True} if fell else {}),
        }
        if self.options.mass_kg is not None:
            facts["mass_kg"] = self.options.mass_kg
        frozen, straight = self.options.frozen_real_seconds, self.options.straight
        if straight is not None:
            facts["notes"]["straight"] = f"to and fro on {straight:g} m"
        only = None if straight is None else {"column": "phase", "number": STRAIGHT}
        return mapping(self._channels, self._idle, self.bundle.rate_hz, facts, frozen, only)
