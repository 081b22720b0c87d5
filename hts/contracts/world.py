"""A world: where policies run "for real"."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hts.contracts.installed import Installed
from hts.contracts.settings import Settings

if TYPE_CHECKING:
    from hts.config import ScheduleConfig
    from hts.recordings.recording import Recording


@dataclass(frozen=True)
class WorldContext:
    """What a world is given when it is made.

    robot: name as registered; robot_settings: its settings; objectives: name -> settings; seed: of everything random in
    it; folder: where it may write; registry: all that is installed, as the run loaded it; None: the world loads it
    itself if it needs it; command: what a person types to make the same requests again, quoted for a shell, for a world
    that ends the process to wait for one; empty: nobody said.
    """

    robot: str
    robot_settings: Settings
    objectives: Mapping[str, Settings]
    seed: int
    folder: Path
    registry: Installed | None = field(default=None, repr=False, compare=False)
    command: str = field(default="", compare=False)


@dataclass(frozen=True)
class HoldSpeed:
    """How a world holds the speed of head-to-heads: the command is trimmed by the measured speed, and then frozen.

    commands: lowest and highest command that was trained, m/s (see `within`); seconds: of trimming of each policy at
    each speed, its settling included; tolerance: largest difference of the two mean speeds that counts as one speed, as
    a share of it; again: how often the same was asked for before, in vain: what is recorded now is to be another
    session.
    """

    commands: tuple[float, float]
    seconds: float = 12.0
    tolerance: float = 0.01
    again: int = 0

    def within(self, *speeds: float) -> tuple[float, float]:
        """Lowest and highest command that may be sent for these asked speeds, m/s. Who is asked to walk forward is
        never told to walk backward, nor the other way round, whatever was trained."""
        low, high = self.commands
        if all(speed > 0 for speed in speeds):
            return max(low, 0.0), high
        if all(speed < 0 for speed in speeds):
            return low, min(high, 0.0)
        return low, high

    def named(self) -> dict[str, Any]:
        """Its part of a request's name, from which a session's names and noise follow: all of it, `again` where it is
        not 0 (so that logs which wait for an earlier version's request are still found)."""
        return {key: value for key, value in asdict(self).items() if key != "again" or value}


@dataclass(frozen=True)
class Requests:
    """How often a run asks its world for recordings, counted before it begins.

    least: where nobody is refused and every command is found at once; comparisons: how many of these are head-to-heads;
    more: why -> at most so many head-to-heads more.
    """

    least: int
    comparisons: int
    more: Mapping[str, int] = field(default_factory=dict)

    @property
    def at_most_more(self) -> int:
        """For all reasons together."""
        return sum(self.more.values())


class World(ABC):
    """Where policies run "for real". It gets exported policies and returns recordings, nothing else.

    name: as registered; simulated: True if its physics is computed, False if a machine moves; reports say which. None,
    the default: the world does not say, and reports say no more than its name.
    """

    name: str
    simulated: bool | None = None

    @abstractmethod
    def idle(self) -> Mapping[str, float]:
        """Measured level of each real channel with electronics on and motors idle."""

    @abstractmethod
    def collect(self, policies: Sequence[Path], schedule: ScheduleConfig) -> list[Recording]:
        """Run each exported policy (ONNX) under the schedule; one recording each, in order."""

    @abstractmethod
    def head_to_head(self, policy: Path, reference: Path, speeds: Sequence[float]) -> list[Recording]:
        """Policy against reference on one machine at each speed, blocks in the order A-B-B-A."""

    def head_to_heads(
        self, policies: Sequence[Path], reference: Path, speeds: Sequence[float]
    ) -> list[list[Recording]]:
        """`head_to_head` of several policies; a simulated world may run them side by side."""
        return [self.head_to_head(policy, reference, speeds) for policy in policies]

    def head_to_head_sessions(
        self, policy: Path, reference: Path, speeds: Sequence[float], sessions: int
    ) -> list[Recording] | None:
        """`head_to_head` so many times, at each speed in as many sessions of different names, each begun anew.

        None, the default: this world does a head-to-head once, and again gives what it gave before.
        """
        return None

    def hold_speed(self, hold: HoldSpeed | None) -> bool:
        """From now on head-to-heads hold the speed (None: send the asked speed as the command, as in the beginning).
        Returns whether it is held from now on; by default a world cannot. Only asked of a robot whose task can hold
        (`Task.can_hold`).

        Held: before its blocks at a speed each policy, the reference too, walks `hold.seconds` in which the command is
        trimmed until `base_velocity`, as the robot's sensors give it, is the asked speed on average. Then the command
        is frozen for all of its blocks. A recording's `schedule` keeps the asked speed, its channel `command` holds
        what was sent, and its notes say `held_command` (the frozen one, m/s), `held_saturated` (`true` where a limit of
        `hold.within(speed)` was reached, else `false`) and `unrecorded_seconds` (what the robot did before this block
        and after the last recorded one, s).
        """
        return False

    def head_to_heads_in_session(
        self, policies: Sequence[Path], reference: Path, speeds: Sequence[float], block_seconds: float | None
    ) -> list[list[Recording]] | None:
        """As `head_to_heads`, but one machine walks all speeds of a policy one after the other and warms up once.

        block_seconds: length of a block; None: the world's own. Each speed of a policy is a session by its name. None,
        the default: this world knows whole head-to-heads only.
        """
        return None

    def head_to_head_round(
        self,
        policies: Sequence[Path],
        reference: Path,
        speed: float | Sequence[float],
        number: int,
        block_seconds: float,
    ) -> list[list[Recording]] | None:
        """A short head-to-head of several policies at one speed, for selectors that ask for several rounds.

        speed: m/s; several: one machine walks a round at each, one after the other.

        number: 0, 1, ...; each round is recorded afresh, and asking for one again gives the same recordings.
        One list a policy: two blocks of it and two of the reference, of `block_seconds` each, in a balanced order such
        as A-B-B-A. Blocks of the reference may be shared between the lists. None, the default: this world knows
        whole head-to-heads only, and that is what elites then get.
        """
        return None

    def head_to_head_seconds(self) -> float:
        """Robot time of one head-to-head at one speed, s, for `--dry-run`.
        By default four blocks of 80 s, as in the paper. While speed is held, trimming counts too."""
        return 4 * 80.0

    def head_to_head_session_seconds(self, speeds: int, block_seconds: float | None) -> float:
        """Robot time of a policy's share of `head_to_heads_in_session` at so many speeds, s.
        By default as many head-to-heads."""
        return speeds * self.head_to_head_seconds()

    def on_progress(self, report: Callable[[float], None]) -> None:  # noqa: B027 - most have nothing to say
        """From now on call `report` with the share of the current request that is done, 0 to 1.
        By default nobody does."""

    def cost(self, robot_seconds: float) -> Mapping[str, float]:
        """What so many seconds of walking will cost here, e.g. {"robot_minutes": 5.3, "wall_seconds": 12.0}."""
        return {"robot_minutes": robot_seconds / 60.0}

    def beside(self, requests: Requests) -> str:
        """What a person has to do for a run that makes so many requests for recordings: one line for `--dry-run`. By
        default nothing is said: no person is needed."""
        return ""

    def check(self) -> None:  # noqa: B027 - most find out when they are made
        """Raise an HtsError, one line, if this world cannot serve the robot and the objectives of its context.

        Asked before anything is spent, also by `--dry-run`; it may take seconds, starts nothing that `close` does not
        end, and leaves nothing behind. UnfitWorldError if only another world can help. By default nothing is checked.
        """

    def identity(self) -> Mapping[str, str]:
        """Which machine it is, for provenance and reports, such as a serial number or the hash of a file: no more than
        somebody beside it could read off. A run is not resumed on another one; a `name` with a `name_sha256` beside
        it is a file, which may lie elsewhere by then. By default nobody knows."""
        return {}

    def close(self) -> None:  # noqa: B027 - most hold nothing
        """Let go of processes and files."""
