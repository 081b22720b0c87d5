"""Step times, missed deadlines, memory and times to a safe command on this computer, against a made-up robot."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import IO, Any

import numpy as np

from hts_go1_runtime.bundle import load_bundle
from hts_go1_runtime.errors import RuntimeFault, Stopped
from hts_go1_runtime.fake import FAULTS
from hts_go1_runtime.figures import figures
from hts_go1_runtime.link import Command, State
from hts_go1_runtime.log import CHANNELS, RowLog, samples
from hts_go1_runtime.loop import Loop, without_collection
from hts_go1_runtime.machine import Limits
from hts_go1_runtime.operator_key import StopFile, listen, signals
from hts_go1_runtime.policy import Policy
from hts_go1_runtime.udp import UdpLink

COMMAND = np.array([0.8, 0.0, 0.0])
LATE = "late loop"
HANG = 0.15  # s that a step hangs
PATIENT = 5.0  # s
TRIES = 4  # of one measurement, where something else stopped the robot first
REASONS = {"stale states": "lost link", **{f"operator {how}": "operator" for how in ("file", "signal", "key")}}
"""Reason that a stop gives for a fault that has another name than it."""
FORBIDDEN = ("hts", "torch", "mujoco", "onnx", "scipy")


class Unmeasured(Exception):
    """Something else stopped the robot first, or nothing did: this computer was too busy just then."""


def bench(folder: Path, seconds: float, stops: int) -> int:
    """Print figures as JSON lines. seconds: of steps, 0: none; stops: how often each reason is tried.

    Exit code 0; 1 if something could not be measured because the computer was too busy: the line says so, and the
    others are measured all the same.
    """
    policy = next(iter(load_bundle(folder).policies.values()))
    if seconds:
        print(json.dumps({"loop": measured(policy, seconds)}), flush=True)
    found = {}
    for fault in (*FAULTS[1:], LATE) if stops else ():
        found[fault] = tried(policy, fault, stops)
        print(json.dumps({fault: found[fault]}), flush=True)
    unmeasured = [fault for fault, one in found.items() if "could_not_measure" in one]
    if found:
        worst = max((one["worst_ms"] for one in found.values() if one["ms"]), default=None)
        print(json.dumps({"stops": {"worst_ms": worst, "could_not_measure": unmeasured}}), flush=True)
    return 1 if unmeasured else 0


def tried(policy: Policy, fault: str, stops: int) -> dict[str, Any]:
    """Times from a fault to the safe command, ms; as many as this computer lets us measure."""
    times: list[float] = []
    why = ""
    for number in range(stops):
        for _ in range(TRIES):
            try:
                times.append(round(1e3 * stopped(policy, fault, 0.5 + 0.0037 * number), 1))
                break
            except (Unmeasured, RuntimeFault) as error:
                why = str(error)
        else:
            break
    found = {"reason": REASONS.get(fault, fault), "ms": times, "worst_ms": max(times, default=None)}
    if len(times) == stops:
        return found
    return {**found, "could_not_measure": f"{len(times)} of {stops} measured; {TRIES} tries of the next: {why}"}


def measured(policy: Policy, seconds: float) -> dict[str, Any]:
    """Figures of so many seconds of walking with a log."""
    with tempfile.TemporaryDirectory() as place:
        patient = Limits(silence=PATIENT, stale=PATIENT, late=PATIENT)  # what is measured is not to end the measuring
        robot, loop = _robot(["--seconds", str(seconds + 30)], Path(place), limits=patient)
        log = RowLog(Path(place), "00", list(CHANNELS))
        try:
            with without_collection():
                loop.start()
                loop.resume()
                for _ in range(round(seconds / loop.period)):
                    _step(loop, policy, log)
            log.closing().wait()
            found = figures(loop)
        finally:
            _end(robot, loop)
    return {**found, "imported": sorted(set(FORBIDDEN) & set(sys.modules))}


def stopped(policy: Policy, fault: str, at: float) -> float:
    """Seconds from a fault until the robot had the damping command. Raises Unmeasured."""
    reading, writing = os.pipe()
    with tempfile.TemporaryDirectory() as place, os.fdopen(reading) as keys:
        kind = "none" if fault == LATE else fault
        options = ["--fault", kind, "--at", str(at), "--stop-file", str(Path(place) / "STOP")]
        options += ["--process", str(os.getpid()), "--key", str(writing), "--seconds", "4"]
        robot, loop = _robot(options, Path(place), (writing,))
        hung = None
        try:
            with without_collection(), signals(loop.brake):
                listen(loop.brake, keys)
                loop.start()
                loop.resume()
                for number in range(200):
                    hangs = fault == LATE and number == round(at / loop.period)
                    due = _step(loop, policy, None, HANG if hangs else 0.0)
                    hung = due if hangs else hung
        except Stopped as error:
            hung = loop.due if fault == LATE else hung
            reason = error.reason
        else:
            reason = ""
        finally:
            os.close(writing)
            said = _end(robot, loop)
        failed, damped = hung if fault == LATE else said.get("failed"), said.get("damped")
        if not reason:
            raise Unmeasured("the robot was not stopped within 4 s")
        if failed is None or reason != REASONS.get(fault, fault):
            when = "before" if failed is None else "after"
            raise Unmeasured(f"stopped for '{reason}' {when} the fault came; this computer is too busy")
        if damped is None:
            raise Unmeasured("the robot did not hear the damping command in time")
        return damped - failed


def _step(loop: Loop, policy: Policy, log: RowLog | None, hang: float = 0.0) -> float:
    given: dict[str, Command] = {}

    def make(state: State) -> Command:
        if hang:
            time.sleep(hang)
        given["command"] = Command(policy.targets(state, COMMAND), policy.kp, policy.kd)
        return given["command"]

    state = loop.tick(make)
    if log is not None:
        log.write(loop.link.now(), samples(state, COMMAND, given["command"]), (state.stamp, 0.0, 0.0, 0.0, 0, 0))
    return loop.due


def _robot(
    options: list[str], place: Path, shared: tuple[int, ...] = (), limits: Limits | None = None
) -> tuple[subprocess.Popen[str], Loop]:
    """A made-up robot in a process of its own, and a loop on the line to it."""
    command = [sys.executable, "-m", "hts_go1_runtime.fake", *options]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(part for part in sys.path if part)}
    robot = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment, pass_fds=shared)
    port = int(_line(robot.stdout))
    return robot, Loop(UdpLink(f"udp://127.0.0.1:{port}"), 0.02, limits or Limits(), StopFile(place / "STOP"))


def _end(robot: subprocess.Popen[str], loop: Loop) -> dict[str, float]:
    """What the robot noted; {} if it was ended before it said so."""
    loop.close()
    loop.link.close()
    try:
        robot.wait(5.0 if loop.stopped_at is not None else 0.0)
        return json.loads(_line(robot.stdout))
    except subprocess.TimeoutExpired:
        robot.kill()
        robot.wait()
        return {}
    finally:
        if robot.stdout is not None:
            robot.stdout.close()


def _line(stream: IO[str] | None) -> str:
    assert stream is not None
    return stream.readline()
