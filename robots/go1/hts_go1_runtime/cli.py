"""Commands: check a bundle, run a session, measure the runtime on this computer."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from hts_go1_runtime.bundle import Bundle, load_bundle
from hts_go1_runtime.errors import RuntimeFault, Stopped
from hts_go1_runtime.figures import figures
from hts_go1_runtime.log import Events
from hts_go1_runtime.loop import Loop, without_collection
from hts_go1_runtime.machine import Limits
from hts_go1_runtime.operator_key import StopFile, listen, signals
from hts_go1_runtime.session import Options, Session
from hts_go1_runtime.udp import UdpLink

DONE, REFUSED, STOPPED = 0, 2, 3


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code: 0 done; 2 refused, nothing moved or the robot sits; 3 stopped, the robot is damped."""
    options = _parser().parse_args(arguments)
    try:
        if options.command == "bench":
            from hts_go1_runtime.bench import bench

            if options.priority:
                hurry(options.priority)
            return bench(options.bundle, options.seconds, options.stops)
        bundle = load_bundle(options.bundle)
        if options.command == "check":
            print(_described(bundle))
            return DONE
        return _run(bundle, options)
    except RuntimeFault as fault:
        print(f"refused: {fault}", file=sys.stderr)
        return REFUSED
    except Stopped as stopped:
        print(f"stopped: {stopped}. The robot is damped; look at it before you go on.", file=sys.stderr)
        return STOPPED


def _run(bundle: Bundle, options: argparse.Namespace) -> int:
    rows = tuple(options.rows.split(",")) if options.rows else ()
    asked = Options(rows, options.idle_seconds, options.warmup, options.first_run, options.mass)
    stop = bundle.folder / "STOP"
    if stop.exists():
        raise RuntimeFault(f"{stop}: is there and means stop. Remove it to begin.")
    link = UdpLink(options.link, options.lockstep)
    limits = Limits(current=options.most_current, temperature=options.most_temperature)
    loop = Loop(link, 1 / bundle.rate_hz, limits, StopFile(stop))
    events = Events(bundle.logs / "events.jsonl")
    session = Session(bundle, link, loop, asked, events)
    if options.priority and not options.lockstep and (why := hurry(options.priority)):
        events.say("no real-time priority", why=why)
    try:
        with signals(loop.brake), without_collection():
            session.run(lambda text: _confirm(text, options.yes, loop))
    finally:
        loop.close()
        if loop.step_seconds:
            events.say("figures", **figures(loop, link), limited_targets=session.limited_targets)
        link.close()
        events.say("ended", rows=session.done)
        events.close()
    return DONE


def _confirm(text: str, yes: bool, loop: Loop) -> None:
    """A person says that the robot may move; from then on the same key stops it."""
    print(text, flush=True)
    if not yes:
        loop.pause()
        print("Enter begins; after that, Enter stops.", flush=True)
        if not sys.stdin.readline():
            raise RuntimeFault("Nobody said that the robot may move. Start it from a terminal, or with --yes.")
    listen(loop.brake)


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
    for file, policy in bundle.policies.items():
        entry = policy.entry
        explores = "explores" if entry["exploration"] else "mean action"
        gate = "gate not tried" if entry["gate"] is None else "gate tried"
        lines.append(f"  {file}  {str(entry['policy_hash'])[:12]}  {explores}, {gate}")
    return "\n".join(lines)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="hts_go1_runtime", description="Policies of a deploy bundle on a Go1 or Go2.")
    commands = parser.add_subparsers(dest="command", required=True)
    check = commands.add_parser("check", help="check a bundle; nothing moves")
    check.add_argument("bundle", type=Path)
    run = commands.add_parser("run", help="record the rows of a bundle")
    run.add_argument("bundle", type=Path)
    run.add_argument("--link", required=True, help="udp://HOST:PORT of the robot's side")
    run.add_argument("--lockstep", action="store_true", help="the far side is a simulation that waits for us")
    run.add_argument("--rows", help="only these, such as 00,01 (default: all without a log)")
    run.add_argument("--idle-seconds", type=float, default=10.0, help="to measure the idle levels; 0: do not")
    run.add_argument("--warmup", type=float, help="s of walking before a head-to-head (default: the bundle's)")
    run.add_argument("--first-run", action="store_true", help="walk each policy slowly and weakly, record nothing")
    run.add_argument("--mass", type=float, help="kg of the robot as it walks, for the log")
    run.add_argument("--most-current", type=float, default=Limits.current, help="A from the pack, beyond: stop")
    run.add_argument("--most-temperature", type=float, default=Limits.temperature, help="degC of a motor, beyond: stop")
    run.add_argument("--yes", action="store_true", help="begin without asking")
    bench = commands.add_parser("bench", help="step times and stops on this computer, against a made-up robot")
    bench.add_argument("bundle", type=Path)
    bench.add_argument("--seconds", type=float, default=120.0, help="of walking; 0: stops only")
    bench.add_argument("--stops", type=int, default=3, help="how often to try each reason to stop")
    for one in (run, bench):
        one.add_argument("--priority", type=int, default=20, help="real-time, 1 to 99; 0: none")
    return parser
