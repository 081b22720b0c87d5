"""The control loop: absolute deadlines, every state looked at as it arrives, and one way to stop.

A step is due at t0 + k T. Until then the line is watched; then the newest state becomes a command. A stop sends the
damping command at once, from whichever thread sees the reason, and from then on nothing else is sent: neither a step
that is still being computed nor a late one can undo it. In real time a thread watches the steps themselves, so a step
that hangs is answered too (a whole process that hangs is the business of the robot's own firmware).
"""

from __future__ import annotations

import contextlib
import gc
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np

from hts_go1_runtime.errors import RuntimeFault, Stopped
from hts_go1_runtime.link import DAMPING, Command, Link, State
from hts_go1_runtime.machine import Limits
from hts_go1_runtime.safety import Guard

FIRST_STATE = 10.0  # s to wait for a robot that says nothing yet
AFRESH = 0.1  # s of states that are looked at anew once the states that waited on the line are let go
LOOKS = 10  # times AFRESH at most, until there is a state
CLOSE = 1e-6  # s: a simulation's clock and the deadlines are sums of different floats
KEPT_TIMES = 200_000  # steps whose times are kept: more than an hour

Make = Callable[[State], Command]


class Loop:
    """Steps of `period` s on a link. pressed: asked often, says what an operator's key wants, None if nothing."""

    def __init__(
        self, link: Link, period: float, limits: Limits, pressed: Callable[[], str | None] = lambda: None
    ) -> None:
        self.link, self.period, self.limits = link, period, limits
        self._guard, self._pressed = Guard(limits), pressed
        self._lock = threading.RLock()  # a signal's handler may come while it is held
        self._stopped: Stopped | None = None
        self.stopped_at: float | None = None
        self.due = 0.0  # when the current step is, or was
        self._alarm = np.inf
        self._over = threading.Event()
        self._watch: threading.Thread | None = None
        self.step_seconds: list[float] = []  # from the deadline's wake-up until the command was sent
        self.late_seconds: list[float] = []  # from the deadline until the command was sent
        self.state: State

    def start(self) -> State:
        """Wait for the robot's first state; from then on it is watched. Raises RuntimeFault if none comes."""
        end = time.monotonic() + FIRST_STATE
        states: list[State] = []
        while not states:
            self.heed()
            if time.monotonic() > end:
                raise RuntimeFault(
                    f"No state came from the robot for {FIRST_STATE:g} s ({self.link.counts.broken} broken packets). "
                    "Check the address, the cable, that the robot's side runs, and that no runtime of another computer "
                    "commands it."
                )
            self.link.hello()
            states = self.link.wait(self.link.now() + self.period)
        self.state = states[-1]
        self.due = self.link.now()
        if not self.link.simulated:
            self._watch = threading.Thread(target=self._watchdog, daemon=True)
            self._watch.start()
        return self.state

    def tick(self, make: Make) -> State:
        """One step: wait until it is due, turn the newest state into a command, send it. Returns that state.

        Raises Stopped once the robot was stopped, by whom ever.
        """
        self.due += self.period
        self._alarm = self.due + self.limits.late
        if not self.link.simulated and self.link.now() >= self.due - CLOSE:  # late: no reason not to look
            self.look(self.link.now())
        while self.link.now() < self.due - CLOSE:
            self.look(self.due)
        began, clock = time.perf_counter(), self.link.now()
        if clock - self.due > self.limits.late:
            self.stop("late loop", f"a step began {1e3 * (clock - self.due):.0f} ms after it was due")
        state = self.state
        command = make(state)
        if not all(np.isfinite(values).all() for values in (command.q, command.kp, command.kd)):
            self.stop("not finite", "the policy gives a joint target that is no number")
        self._send(command)
        if len(self.step_seconds) < KEPT_TIMES:
            self.step_seconds.append(time.perf_counter() - began)
            self.late_seconds.append(self.link.now() - self.due)
        return state

    def watch(self, seconds: float) -> list[State]:
        """What the robot says for so long, oldest first, while no step is due. Raises Stopped."""
        end, seen = self.link.now() + seconds, []
        while self.link.now() < end:
            self.heed()
            for state in self.link.wait(end):
                self.state = state
                seen.append(state)
        return seen

    def look_over(self, state: State) -> tuple[str, str] | None:
        """What is wrong with a state, None if nothing: asked before the robot moves."""
        return self._guard.state(state)

    def look(self, until: float) -> None:
        """Look at the line once. Raises Stopped."""
        states = self.link.wait(until)
        fault = None
        for state in states:
            fault = fault or self._guard.state(state)
            self.state = state
        fault = fault or self._guard.silence(self.state, self.link.now())
        if fault is None:
            key = self._pressed()
            fault = ("operator", key) if key else None
        if fault is not None:
            self.stop(*fault)
        if self._stopped is not None:
            raise self._stopped

    def heed(self) -> None:
        """Raise Stopped if the robot was stopped, or the operator's key wants it: asked while no step is due."""
        key = self._pressed()
        if key:
            self.stop("operator", key)
        if self._stopped is not None:
            raise self._stopped

    def stop(self, reason: str, detail: str) -> None:
        """Send the damping command now and for good. Raises Stopped."""
        self.brake(reason, detail)
        assert self._stopped is not None
        raise self._stopped

    def brake(self, reason: str, detail: str) -> None:
        """`stop` for other threads and signals: raises nothing; the loop finds out at its next look. A line that
        refuses the damping command undoes no stop: `damp` goes on trying."""
        with self._lock:
            if self._stopped is None:
                self._stopped = Stopped(reason, detail)
                with contextlib.suppress(OSError):
                    self.link.send(DAMPING)
                self.stopped_at = self.link.now()

    def damp(self, seconds: float) -> None:
        """Repeat the damping command, whatever the states say."""
        self._alarm = np.inf
        end = self.link.now() + seconds
        while self.link.now() < end:
            with self._lock, contextlib.suppress(OSError):
                self.link.send(DAMPING)
            due = self.link.now() + self.period
            while self.link.now() < due:
                for state in self.link.wait(due):
                    self.state = state

    def pause(self) -> None:
        """No step is due for a while; the last command holds."""
        self._alarm = np.inf

    def resume(self) -> list[State]:
        """The next step is due one period from now. What waited on the line meanwhile is old: it is let go; what comes
        from now on is returned, oldest first. Raises Stopped."""
        if not self.link.simulated:  # a simulation has waited
            self.link.wait(self.link.now())
        seen: list[State] = []
        for _ in range(LOOKS):
            seen = seen or self.watch(AFRESH)  # once, unless this process was kept from looking, or nobody speaks
        self._guard = Guard(self.limits)
        self.due = self.link.now()
        return seen

    def close(self) -> None:
        """End the watching thread."""
        self._over.set()
        if self._watch is not None:
            self._watch.join()

    def _send(self, command: Command) -> None:
        with self._lock:
            if self._stopped is not None:
                raise self._stopped
            try:
                self.link.send(command)
                self._guard.sent(command, self.link.now())
            except OSError as error:
                self.stop("lost link", f"a command could not be sent ({error.strerror or error})")
            self._damp_again()

    def _damp_again(self) -> None:
        """A signal's handler, which no lock of its own thread keeps out, may have stopped the robot while a command was
        being sent: then that command came last. Raises Stopped."""
        if self._stopped is not None:
            with contextlib.suppress(OSError):
                self.link.send(DAMPING)
            raise self._stopped

    def _watchdog(self) -> None:
        """Brakes if a step is not done long after it was due."""
        while not self._over.is_set():
            now = self.link.now()  # first: the other way round, a step done between the two would seem late
            alarm = self._alarm
            if now >= alarm:
                self.brake("late loop", f"a step was not done {1e3 * self.limits.late:.0f} ms after it was due")
                return
            self._over.wait(max(min(alarm - now, 0.02), 0.0005))


@contextlib.contextmanager
def without_collection() -> Iterator[None]:
    """No garbage collection inside: a loop makes no cycles, and a collection costs milliseconds."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()
