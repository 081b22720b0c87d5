"""Commands: check a bundle, run a session, measure the runtime on this computer."""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from hts_go1_runtime.bundle import LONGEST_FROZEN, Bundle, load_bundle
from hts_go1_runtime.errors import RuntimeFault, Stopped
from hts_go1_runtime.events import Events
from hts_go1_runtime.figures import figures
from hts_go1_runtime.gated import LEAST_DIGITS, gate_in_words, vouched_for
from hts_go1_runtime.lane import keys_of
from hts_go1_runtime.lock import alone
from hts_go1_runtime.loop import Loop, without_collection
from hts_go1_runtime.machine import Limits
from hts_go1_runtime.operator_key import StopFile, ask, listen, signals
from hts_go1_runtime.options import Options
from hts_go1_runtime.room import LONGEST, SHORTEST
from hts_go1_runtime.rows import LONGEST_ROW
from hts_go1_runtime.session import Session
from hts_go1_runtime.terminal import that_may_go
from hts_go1_runtime.trained import beyond
from hts_go1_runtime.udp import UdpLink

DONE, REFUSED, STOPPED = 0, 2, 3
VOUCH = f"{LEAST_DIGITS} digits or more of the hash of a policy that failed the gate and that you want walked"
ROW_SENSORS = "the pack's current, or the trunk's speed while it walks,"
KEYS = (
    "Enter begins. After that: Enter stops at once (it sinks down); s, then Enter: it sits down and the visit ends; "
    "l or r, then Enter: it walks on 3 degrees further to the left or right; t, then Enter (with --straight): it turns "
    "round now. "
    "Anything else that is typed now ends this."
)
STRAIGHT = "m of floor on which it walks to and fro and turns round at the ends (default: straight on, without end)"
EXTERNAL = "a measured channel that the robot does not give, and that a sensor of its own logs meanwhile"


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code: 0 done; 2 refused, nothing moved or the robot sits; 3 stopped, the robot is damped."""
    with that_may_go():
        return _command(arguments)


def _command(arguments: Sequence[str] | None) -> int:
    options = _parser().parse_args(arguments)
    try:
        if options.command == "bench":
            from hts_go1_runtime.bench import bench

            if options.priority:
                hurry(options.priority)
            return bench(options.bundle, options.seconds, options.stops)
        bundle = load_bundle(options.bundle)
        if options.command == "check":
            print(_described(bundle), flush=True)
            vouched_for(bundle.policies, bundle.policies, options.vouch)
            return DONE
        return _run(bundle, options)
    except RuntimeFault as fault:
        print(f"refused: {fault}", file=sys.stderr, flush=True)
        return REFUSED
    except Stopped as stopped:
        print(f"stopped: {stopped}. The robot is damped; look at it before you go on.", file=sys.stderr, flush=True)
        return STOPPED


def _run(bundle: Bundle, options: argparse.Namespace) -> int:
    asked = Options(
        rows=tuple(options.rows.split(",")) if options.rows else (),
        idle_seconds=options.idle_seconds,
        warmup_seconds=options.warmup,
        first_run=options.first_run,
        mass_kg=options.mass,
        vouched=tuple(options.vouch),
        external=tuple(options.external),
        at_limit=options.at_limit,
        frozen_real_seconds=options.frozen_real_seconds,
        straight=options.straight,
    )
    stop = bundle.folder / "STOP"
    for path, means in ((stop, "stop"), (bundle.folder / "SIT", "sit down")):
        if path.exists():
            raise RuntimeFault(f"{path}: is there and means {means}. Remove it to begin.")
    limits = Limits(
        current=options.most_current,
        temperature=options.most_temperature,
        least_torque_share=options.least_torque_share,
        frozen=bundle.frozen.seen if options.frozen_seconds is None else options.frozen_seconds,
        velocity=tuple(bundle.reach.velocity.tolist()),
    )
    with alone(bundle.logs), contextlib.closing(UdpLink(options.link, options.lockstep)) as link:
        loop = Loop(link, 1 / bundle.rate_hz, limits, StopFile(stop))
        with signals(loop.brake), contextlib.closing(Events(bundle.logs / "events.jsonl")) as events:
            session = Session(bundle, link, loop, asked, events)
            if options.priority and not options.lockstep and (why := hurry(options.priority)):
                events.say("no real-time priority", why=why)
            try:
                with without_collection():
                    session.run(lambda text: _confirm(text, options.yes, session, events))
            except (RuntimeFault, Stopped):
                raise
            except Exception as error:  # of ours or of a library: by now the session has damped the robot
                raise _unexpected(error, bool(loop.step_seconds), events) from error
            finally:
                loop.close()
                if loop.step_seconds:
                    events.say("figures", **figures(loop), limited_targets=session.limited_targets)
                events.say("ended", rows=session.done)
    return DONE


def _unexpected(error: Exception, moved: bool, events: Events) -> RuntimeFault:
    """One line for an error that nothing here was written for. moved: whether the robot was told anything."""
    at = traceback.extract_tb(error.__traceback__)[-1]
    what = " ".join(f"{type(error).__name__}: {error}".split())
    events.say("unexpected error", error=what, file=at.filename, line=at.lineno)
    robot = "The robot is damped; look at it before you go on." if moved else "The robot was told nothing."
    return RuntimeFault(
        f"unexpected {what[:300]} ({Path(at.filename).name}, line {at.lineno}). {robot} Report this line."
    )


def _confirm(text: str, yes: bool, session: Session, events: Events) -> None:
    """A person says that the robot may move; from then on the same key stops it."""
    loop = session.loop
    if yes:
        print(text, flush=True)
    else:
        loop.pause()
        ask(f"{text}\n{KEYS}", loop.heed)
    listen(loop.brake, gone=events.say, rest=session.rest.ask, steering=keys_of(session.heading))


def hurry(priority: int) -> str:
    """Before other processes, where the system allows it; else why not."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        return str(error.strerror)
    return ""


def _described(bundle: Bundle) -> str:
    seconds = sum(row.seconds for row in bundle.rows)
    lines = [f"{bundle.folder}: whole. {len(bundle.rows)} rows, {seconds:.0f} s, {bundle.rate_hz:g} Hz."]
    if bundle.other_robot:
        lines.append(f"  made for the robot '{bundle.other_robot}', not for a Go1: go on only if it is one")
    for file, policy in bundle.policies.items():
        entry = policy.entry
        explores = "explores" if entry["exploration"] else "mean action"
        lines.append(f"  {file}  {str(entry['policy_hash'])[:12]}  {explores}, {gate_in_words(entry['gate'])}")
    lines += [f"  more than trained for: {what}" for what in beyond(bundle.rows, bundle.policies, bundle.fastest)]
    return "\n".join(lines)


class Parser(argparse.ArgumentParser):
    """Refuses in one line, as everything here does; `-h` shows the usage."""

    def error(self, message: str) -> NoReturn:
        self.exit(REFUSED, f"refused: {message}\n")


def _number(low: float, high: float) -> Callable[[str], float]:
    """Type of an option that is a number from low to high; nan is none."""

    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"'{text}', expected a number from {low:g} to {high:g}")
        return value

    return number


def whole(low: int, high: int) -> Callable[[str], int]:
    """Type of an option that is a whole number from low to high."""

    def number(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"'{text}', expected a whole number from {low} to {high}")
        return int(text)

    return number


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="hts_go1_runtime", description="Policies of a deploy bundle on a Go1 or Go2.")
    commands = parser.add_subparsers(dest="command", required=True)
    check = commands.add_parser("check", help="check a bundle; nothing moves")
    check.add_argument("bundle", type=Path)
    run = commands.add_parser("run", help="record the rows of a bundle")
    run.add_argument("bundle", type=Path)
    run.add_argument("--link", required=True, help="udp://HOST:PORT of the robot's side")
    run.add_argument("--lockstep", action="store_true", help="the far side is a simulation that waits for us")
    run.add_argument("--rows", help="only these, such as 00,01 (default: all without a log)")
    most_idle, most_warmup, seconds = _number(0, 600), _number(0, LONGEST_ROW), _number(0, 36000)
    run.add_argument("--idle-seconds", type=most_idle, default=10.0, help="to measure the idle levels; 0: do not")
    run.add_argument("--warmup", type=most_warmup, help="s of walking before a head-to-head (default: the bundle's)")
    run.add_argument("--first-run", action="store_true", help="walk each policy slowly and weakly, record nothing")
    run.add_argument("--at-limit", action="store_true", help="record rows whose trimmed command ended at a limit too")
    run.add_argument("--straight", type=_number(SHORTEST, LONGEST), metavar="METRES", help=STRAIGHT)
    run.add_argument("--mass", type=_number(1, 100), help="kg of the robot as it walks, for the log")
    run.add_argument("--external", action="append", default=[], metavar="CHANNEL", help=f"{EXTERNAL}; repeatable")
    current, temperature = Limits.current, Limits.temperature
    run.add_argument("--most-current", type=_number(1, 100), default=current, help="A from the pack, beyond: stop")
    run.add_argument(
        "--most-temperature", type=_number(20, 90), default=temperature, help="degC of a motor, beyond: stop"
    )
    run.add_argument(
        "--least-torque-share",
        type=_number(0, 1),
        default=Limits.least_torque_share,
        help="of the torque that joints are asked for, below: stop; 0: never",
    )
    frozen = _number(0, LONGEST_FROZEN)
    run.add_argument(
        "--frozen-seconds",
        type=frozen,
        help="for which joints or IMU may repeat themselves (default: the bundle's); 0: ever",
    )
    run.add_argument("--frozen-real-seconds", type=frozen, help=f"for which {ROW_SENSORS} may, in a row; 0: ever")
    run.add_argument("--yes", action="store_true", help="begin without asking")
    bench = commands.add_parser("bench", help="step times and stops on this computer, against a made-up robot")
    bench.add_argument("bundle", type=Path)
    bench.add_argument("--seconds", type=seconds, default=120.0, help="of walking; 0: stops only")
    bench.add_argument("--stops", type=whole(0, 1000), default=3, help="how often to try each reason to stop")
    for one in (run, bench):
        one.add_argument("--priority", type=whole(0, 99), default=20, help="real-time, 1 to 99; 0: none")
    for one in (run, check):
        one.add_argument("--vouch", action="append", default=[], metavar="HASH", help=f"{VOUCH}; repeatable")
    return parser
