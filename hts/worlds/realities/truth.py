"""What a policy truly saves on a reality: without noise, at its true speed, over many sessions.

The yardstick for intervals, on twins alone. The robot, its physics and the programme are those of a held head-to-head;
what is measured is not: instruments tell their quantity as it is (`Instrument.exact`), the command is trimmed by the
trunk's true speed, and every piece counts that is not near a fall. Beside it stands what those pieces alone say that a
head-to-head would count, by their true speed: the difference is what that rule leaves out. Sessions are others than
those of any head-to-head.
No learning code comes here: `import-linter` keeps it out of hts.worlds, and a run never asks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hts import plugins
from hts.contracts import VELOCITY, HoldSpeed, Instrument, Objective
from hts.errors import ConfigError, EvaluationError, UnfitWorldError
from hts.evaluation.balance import mean_of_blocks
from hts.evaluation.final import speed_key
from hts.evaluation.head_to_head import ANY_SPEED, ROLES, by_speed
from hts.evaluation.segments import cut
from hts.evaluation.sessions import over_sessions
from hts.recordings.recording import Recording
from hts.worlds.base import file_hash, request_id, seed_sequence
from hts.worlds.realities.workers import worker_processes
from hts.worlds.twin.dynamics import Dynamics
from hts.worlds.twin.instruments import Wrapped, maker
from hts.worlds.twin.parameters import TwinSettings, resolved_settings
from hts.worlds.twin.programme import head_to_head
from hts.worlds.twin.sensors import Sensors
from hts.worlds.twin.session import Batch

DEFAULT = "default"
TOGETHER = 6  # sessions simulated together; part of the randomness, so no matter of the machine

Means = Mapping[str, Mapping[str, float]]
"""role -> quantity -> mean over a session's pieces; BESIDE the objective's own: m/s, and counts."""

BESIDE = ("speed", "falls", "saturated", "pieces")


@dataclass(frozen=True)
class Truth:
    """What is asked. policy, reference: exported files; reality: name, file or `default`; lengths in s as in a
    head-to-head; commands: lowest and highest, m/s; objective: name and settings; tolerance: relative, of the pieces
    that a head-to-head would count (`evaluation.speed_tolerance`)."""

    robot: str
    objective: str
    settings: Mapping[str, Any]
    policy: str
    reference: str
    reality: str
    speeds: tuple[float, ...]
    sessions: int = 50
    warmup: float = 20.0
    trimming: float = 20.0
    block: float = 20.0
    commands: tuple[float, float] = (0.2, 1.5)
    seed: int = 0
    tolerance: float = 0.1


Compared = Callable[[np.ndarray, np.ndarray], Any]


@dataclass(frozen=True)
class Walked:
    """One session at one speed. means: over all pieces; counted: of each role the means of the objective's quantities
    over the pieces that a head-to-head would count, in the order of `means`, (Q,), every block counting the same; empty
    without any; pieces: how many they are."""

    means: Means
    counted: Mapping[str, np.ndarray]
    pieces: Mapping[str, int]


class Exact(Wrapped):
    """An instrument that shows what is, and not what it would measure."""

    def __init__(self, name: str, instrument: Instrument) -> None:
        super().__init__(instrument)
        shown = set(instrument.exact())
        if not shown:
            raise UnfitWorldError(
                f"Instrument '{name}' does not tell its quantity without errors, so nothing can be held against the "
                "truth. Give its class the method `exact`."
            )
        self.channels = tuple(channel for channel in instrument.channels if channel.name in shown)

    def read(self) -> Mapping[str, np.ndarray]:
        return self._instrument.exact()

    def idle(self) -> Mapping[str, float]:
        return self._instrument.exact_idle()


class TrueSpeed:
    """Sensors whose base velocity is the trunk's own; what else the policy sees is as noisy as ever."""

    def __init__(self, sensors: Sensors, body: Dynamics) -> None:
        self._sensors, self._body = sensors, body

    def read(self, period: float) -> dict[str, np.ndarray]:
        """As `Sensors.read`."""
        velocity = np.matmul(self._body.rotation(), self._body.qvel[:, :3, None])[:, :, 0]
        return {**self._sensors.read(period), "base_velocity": velocity}


def truth(asked: Truth, processes: int = 1, tell: Callable[[int, int], None] | None = None) -> dict[str, Any]:
    """Unit, and at each speed improvement, its interval over sessions, metrics, mean speeds, falls, and how many
    commands reached the end of their range; `counted`: improvement, its interval and the share of each role's pieces,
    of the pieces that a head-to-head would count, None unless two sessions have some of both roles. The same for any
    number of processes. Raises EvaluationError for a speed at which nothing is left, ConfigError for fewer than two
    sessions."""
    if asked.sessions < 2:
        raise ConfigError(f"{asked.sessions} sessions: the truth is a mean over sessions. Expected two at least.")
    objective = _objective(asked)
    groups = [range(at, min(at + TOGETHER, asked.sessions)) for at in range(0, asked.sessions, TOGETHER)]
    found: dict[float, list[Walked]] = {}
    for number, rows in enumerate(_grouped(asked, groups, processes)):
        for speed, walked in rows:
            found.setdefault(speed, []).append(walked)
        if tell is not None:
            tell(number + 1, len(groups))
    return {
        "unit": objective.unit,
        "sessions": asked.sessions,
        "speeds": {speed_key(speed): _entry(objective, found[speed], speed) for speed in sorted(found)},
    }


def one_group(asked: Truth, group: range) -> list[tuple[float, Walked]]:
    """Sessions that are simulated together: each at each speed."""
    registry = plugins.load()
    robot, objective = registry.make_robot(asked.robot), _objective(asked)
    reference = {} if asked.reality == DEFAULT else {"reality": asked.reality}
    settings = resolved_settings(TwinSettings.model_validate(reference), asked.robot)
    made = maker(registry, robot, {asked.objective: asked.settings}, settings)()
    wanted = {channel.name for channel in objective.real_channels}
    exact = {name: Exact(name, one) if wanted & {c.name for c in one.channels} else one for name, one in made.items()}
    request = request_id("truth", file_hash(asked.policy), file_hash(asked.reference), settings.reality_sha256)
    batch = Batch(robot, settings, exact, len(group), seed_sequence(asked.seed, request, group.start))
    batch.sensors = TrueSpeed(batch.sensors, batch.body)  # type: ignore[assignment]
    hold = HoldSpeed(asked.commands, asked.trimming)
    lengths = (asked.warmup, asked.block)
    sessions = [
        head_to_head([asked.policy], asked.reference, asked.speeds, *lengths, request_id(request, number), hold=hold)
        for number in group
    ]
    try:
        rows = batch.run(sessions, "twin")
    finally:
        batch.close()
    found = [(speed, blocks) for row in rows for speed, blocks in by_speed(row).items()]
    return [(speed, _walked(objective, blocks, speed, asked.tolerance)) for speed, blocks in found]


def _grouped(asked: Truth, groups: Sequence[range], processes: int) -> Any:
    """Rows of each group, in order."""
    if processes == 1 or len(groups) == 1:
        yield from (one_group(asked, group) for group in groups)
        return
    with worker_processes(processes) as pool:
        yield from pool.map(one_group, [asked] * len(groups), groups)


def _walked(objective: Objective, recordings: Sequence[Recording], speed: float, tolerance: float) -> Walked:
    means: dict[str, dict[str, float]] = {}
    counted: dict[str, np.ndarray] = {}
    pieces: dict[str, int] = {}
    for role in ROLES:
        blocks = sorted((one for one in recordings if one.role == role), key=lambda one: one.block)
        segments = cut(blocks, ANY_SPEED)
        if not len(segments):
            raise EvaluationError(
                f"At {speed:g} m/s nothing is left of a session of the {role}: it fell {segments.falls} times. There "
                "is no truth to hold anything against."
            )
        at_limit = [one.notes.get("held_saturated") == "true" for one in blocks]
        scores = objective.score(segments)
        done = VELOCITY.done(segments.speed, segments.commanded, tolerance)
        table = np.stack(list(scores.values()), axis=1)[done]
        counted[role] = mean_of_blocks(table, segments.block[done]) if len(table) else table.ravel()
        pieces[role] = len(table)
        means[role] = {
            **{name: float(np.mean(values)) for name, values in scores.items()},
            "pieces": float(len(segments)),
            "speed": float(segments.speed.mean()),
            "falls": float(segments.falls),
            "saturated": float(any(at_limit)),
        }
    return Walked(means, counted, pieces)


def _entry(objective: Objective, walked: Sequence[Walked], speed: float) -> dict[str, Any]:
    """Every session counts alike."""
    sessions = [one.means for one in walked]
    names = [name for name in sessions[0]["policy"] if name not in BESIDE]

    def compared(policy: np.ndarray, reference: np.ndarray) -> Any:
        return objective.compare(*(dict(zip(names, map(float, one), strict=True)) for one in (policy, reference)))

    first, second = (np.array([[one[role][name] for name in names] for one in sessions]) for role in ROLES)
    whole, interval = _over_all(compared, first, second)

    def over(role: str, name: str) -> np.ndarray:
        return np.array([one[role][name] for one in sessions])

    return {
        "improvement": whole.improvement,
        "improvement_ci95": interval,
        "metrics": dict(whole.metrics),
        "sessions": len(sessions),
        "mean_speed": float(over("policy", "speed").mean()),
        "reference_speed": float(over("reference", "speed").mean()),
        "falls": int(over("policy", "falls").sum()),
        "reference_falls": int(over("reference", "falls").sum()),
        "at_limit": int((over("policy", "saturated") + over("reference", "saturated") > 0).sum()),
        "asked_speed": speed,
        "counted": _counted(compared, walked),
    }


def _over_all(compared: Compared, policy: np.ndarray, reference: np.ndarray) -> tuple[Any, list[float] | None]:
    """The comparison of the means of all sessions, (S, Q) each, and the interval of its improvement."""
    interval = over_sessions(lambda one, other: float(compared(one, other).improvement), policy, reference)
    return compared(policy.mean(axis=0), reference.mean(axis=0)), list(interval) if interval else None


def _counted(compared: Compared, walked: Sequence[Walked]) -> dict[str, Any] | None:
    """Of the pieces that a head-to-head would count, as it takes them: blocks and sessions count alike."""
    both = [one for one in walked if all(one.pieces[role] for role in ROLES)]
    if len(both) < 2:
        return None
    first, second = (np.array([one.counted[role] for one in both]) for role in ROLES)
    whole, interval = _over_all(compared, first, second)
    shares = [
        sum(one.pieces[role] for one in walked) / sum(one.means[role]["pieces"] for one in walked) for role in ROLES
    ]
    return {
        "improvement": whole.improvement,
        "improvement_ci95": interval,
        "valid": shares[0],
        "reference_valid": shares[1],
    }


def _objective(asked: Truth) -> Objective:
    return plugins.load().make_objective(asked.objective, asked.settings)
