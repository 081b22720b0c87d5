"""What a plugin implements: Robot, Objective, Instrument, World, Selector, LogReader.

Interfaces only, a handful of methods each. Nothing here imports torch or mujoco, so that a
plugin's module loads in milliseconds; heavy imports belong inside the methods.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    import torch
    from torchrl.envs import EnvBase

    from hts.channels import Channel
    from hts.config import EnvConfig, ScheduleConfig
    from hts.evaluation.segments import Segments
    from hts.recordings.recording import Recording

Settings = Mapping[str, Any]


# ---------------------------------------------------------------------------------------------- robot


@dataclass(frozen=True)
class JointMotors:
    """Motor constants per joint, each a tuple of length J in joint order. Sources belong in the robot's module.

    torque_constant: N·m at the joint per q-axis peak ampere; gear_ratio: rotor turns per joint turn;
    phase_resistance_ohm: per phase at 25 °C.
    """

    torque_constant: tuple[float, ...]
    gear_ratio: tuple[float, ...]
    phase_resistance_ohm: tuple[float, ...]


@dataclass(frozen=True)
class RobotSpec:
    """Everything a controller must know of a machine. Tuples of length J follow `joint_names`.

    default_pose rad; kp N·m/rad; kd N·m·s/rad; action_scale rad per action unit
    (joint target = default_pose + action_scale · action); torque_limit N·m; velocity_limit rad/s;
    position_limit (low, high) rad; control_rate_hz: policy rate; physics_dt s and substeps: training
    simulation (physics_dt · substeps = 1 / control_rate_hz); base_height m: of the trunk in the default pose.
    trunk_body and foot_sites (length F) name things in the MJCF.
    """

    name: str
    joint_names: tuple[str, ...]
    default_pose: tuple[float, ...]
    kp: tuple[float, ...]
    kd: tuple[float, ...]
    action_scale: tuple[float, ...]
    torque_limit: tuple[float, ...]
    velocity_limit: tuple[float, ...]
    position_limit: tuple[tuple[float, float], ...]
    control_rate_hz: float
    physics_dt: float
    substeps: int
    base_height: float
    trunk_body: str = "trunk"
    foot_sites: tuple[str, ...] = ()
    endurance_minutes: float | None = None  # of walking on one charge, for the estimate of `--dry-run`
    motors: JointMotors | None = None

    @property
    def num_joints(self) -> int:
        return len(self.joint_names)


class Robot(ABC):
    """A machine: its model, its numbers, its channels, its first policy.

    A log-only robot has a spec and channels but neither model nor policy: `mjcf` and
    `pretrained_policy` return None; that is enough for import and fit. A robot whose `make_env` is its own may do
    without a model too: only the default env, the twin and `hts play` ask for one.
    """

    spec: RobotSpec

    @abstractmethod
    def mjcf(self) -> Any | None:
        """A fresh `dm_control.mjcf.RootElement` with floor, actuators and sensors; None if log-only."""

    @abstractmethod
    def channels(self) -> Mapping[str, Channel]:
        """Sim channels that this robot gives, by name."""

    @abstractmethod
    def pretrained_policy(self) -> Path | None:
        """Path of the starting policy's `.safetensors` (its `.json` lies beside it); None if log-only."""

    def make_env(
        self, engine: str, num_candidates: int, num_envs: int, config: EnvConfig,
        channels: Sequence[str] = (), seeds: Sequence[int] | None = None,
    ) -> EnvBase:  # fmt: skip
        """A TorchRL env of batch size [num_candidates, num_envs] that writes ("channels", name).

        channels: names to write, all if empty; seeds: one per candidate, so that a candidate's random numbers
        do not depend on its neighbours. The default is the velocity task of `hts.envs`; `hts.envs.folded` helps to
        bring another. The env has `dt`, s per control step, and may have `observation_layout` (for the card of a policy
        that is pretrained in it), `full_state` and `load_full_state` (to go on from a checkpoint), and `engine`.
        """
        from hts.envs.velocity import make_velocity_env

        return make_velocity_env(self, engine, num_candidates, num_envs, config, channels, seeds)


# ------------------------------------------------------------------------------------------ objective


@dataclass(frozen=True)
class Comparison:
    """A policy against a reference.

    improvement: the objective's primary score, larger is better, in `Objective.unit`;
    selection_score: what `hierarchical` ranks by (same unit); metrics: anything else worth reporting.
    """

    improvement: float
    selection_score: float
    metrics: Mapping[str, float] = field(default_factory=dict)


class Objective(ABC):
    """A real channel to improve.

    name: as registered; unit: of the improvement ("1" for a fraction); inputs: sim channels the model reads;
    target: the real channel; weights: default sweep over λ; baseline_weights: the same for the analytic proxy.
    """

    name: str
    unit: str
    inputs: tuple[str, ...]
    target: Channel
    weights: tuple[float, ...] = (0.5, 1.0, 5.0)
    baseline_weights: tuple[float, ...] = ()
    instrument: str | None = None  # name of the instrument that measures `target` on a twin

    @abstractmethod
    def measurement_model(self) -> Any:
        """A `hts.measurement.models.MeasurementModelConfig`: which network is fitted, and how."""

    @abstractmethod
    def reward(self, prediction: torch.Tensor) -> torch.Tensor:
        """r_real of the predicted target in units of its training data's standard deviation
        (prediction is z-scored), per second; any shape in, same shape out."""

    @abstractmethod
    def score(self, segments: Segments) -> Mapping[str, np.ndarray]:
        """Quantities of each 1 s segment, each of shape (segments,)."""

    @abstractmethod
    def compare(self, policy: Mapping[str, float], reference: Mapping[str, float]) -> Comparison:
        """From the means of `score` over a policy's and its reference's segments to one comparison."""

    def proxy(self, channels: Mapping[str, torch.Tensor]) -> torch.Tensor | None:
        """The analytic stand-in of the target from sim channels (..., J) -> (...,); None if there is none."""
        return None


# ------------------------------------------------------------------------------------ simulated reality


@dataclass
class PhysicsSample:
    """One physics step of W simulated robots, as instruments see it. Arrays (W, J) or (W, F), SI units.

    motor_torque: made by the motor current, seen at the joint, N·m; joint_velocity rad/s;
    foot_force: normal, N; foot_speed: normal speed of each foot just before this step, m/s (downwards positive);
    foot_mass: effective mass of each foot along the normal, kg; dt: s.
    """

    motor_torque: np.ndarray
    joint_velocity: np.ndarray
    foot_force: np.ndarray
    foot_speed: np.ndarray
    foot_mass: np.ndarray
    dt: float


class Instrument(ABC):
    """A simulated sensor of a real channel on a twin. Learning code never sees one.

    It keeps its hidden state (temperatures, charge, filters) for W robots at once, across policy swaps.
    """

    channels: tuple[Channel, ...]

    @abstractmethod
    def reset(self, num_worlds: int, rng: np.random.Generator) -> None:
        """A fresh instrument on each of W robots."""

    @abstractmethod
    def step(self, sample: PhysicsSample) -> None:
        """One physics step passes."""

    @abstractmethod
    def read(self) -> Mapping[str, np.ndarray]:
        """What the instrument shows now, channel name -> (W, *shape)."""

    @abstractmethod
    def idle(self) -> Mapping[str, float]:
        """Level of each channel with electronics on and motors idle, as someone would read it off."""

    def settle(self) -> None:  # noqa: B027 - most have nothing slow
        """Bring slow hidden state (heat) to the steady state of the steps since the last reset or settle."""

    def describe(self) -> Mapping[str, Any]:
        """Its parameters, for the twin's hash and the calibration table."""
        return {}


# ---------------------------------------------------------------------------------------------- world


@dataclass(frozen=True)
class WorldContext:
    """What a world is told when it is made.

    robot: name as registered; robot_settings: its settings; objectives: name -> settings;
    seed; folder: where it may write; control_rate_hz.
    """

    robot: str
    robot_settings: Settings
    objectives: Mapping[str, Settings]
    seed: int
    folder: Path


class World(ABC):
    """Where policies run "for real". It gets exported policies and returns recordings, nothing else."""

    name: str

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

    def head_to_head_round(
        self, policies: Sequence[Path], reference: Path, speed: float, number: int, block_seconds: float
    ) -> list[list[Recording]] | None:
        """A short head-to-head of several policies at one speed, for selectors that ask for several rounds.

        number: 0, 1, ...; each round is recorded afresh, and asking for one again gives the same recordings.
        One list a policy: two blocks of it and two of the reference, of `block_seconds` each, in a balanced order such
        as A-B-B-A. Blocks of the reference may be shared between the lists. None, the default: this world knows
        whole head-to-heads only, and that is what elites then get.
        """
        return None

    def cost(self, robot_seconds: float) -> Mapping[str, float]:
        """What so many seconds of walking will cost here, e.g. {"robot_minutes": 5.3, "wall_seconds": 12.0}."""
        return {"robot_minutes": robot_seconds / 60.0}

    def close(self) -> None:  # noqa: B027 - most hold nothing
        """Let go of processes and files."""


# ------------------------------------------------------------------------------------------- selection


@dataclass(frozen=True)
class SimulatedCandidate:
    """A candidate after fine-tuning, judged in simulation by its mean action.

    score: unweighted mean r_real, larger is better, summed over objectives; falls: worlds that fell; tracked: whether
    it keeps the speed; scores: the parts of `score`, objective -> mean r_real, in the order of the run's objectives.
    """

    id: str
    score: float
    falls: int
    tracked: bool
    scores: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class TestedCandidate:
    """An elite after its head-to-head: one Comparison per objective, and whether it fell."""

    id: str
    comparisons: Mapping[str, Comparison]
    fell: bool

    __test__ = False  # its name begins like a pytest class


@dataclass(frozen=True)
class Rounds:
    """How a selector wants tests in rounds: length of each block of a round, s, and how many rounds at most."""

    block_seconds: float
    most: int


@dataclass(frozen=True)
class RacedCandidate:
    """An elite after the rounds so far.

    tested: all its rounds together, None if nothing could be reported; racing: whether it was in the last round;
    halves: two a round, in order, each one block of the policy against one of the reference, as one Comparison per
    objective (None if it could not be compared). Half n of one candidate was recorded beside half n of the others.
    """

    id: str
    tested: TestedCandidate | None
    racing: bool
    halves: Sequence[Mapping[str, Comparison] | None]


class Selector(ABC):
    """Which candidates are worth the robot's time, and which of the tested ones goes on."""

    @abstractmethod
    def elites(self, candidates: Sequence[SimulatedCandidate], count: int) -> list[str]:
        """Ids of the candidates to test, best first."""

    @abstractmethod
    def best(self, tested: Sequence[TestedCandidate]) -> str | None:
        """Id of the anchor of the next iteration; None if nothing beats the reference."""

    def rounds(self) -> Rounds | None:
        """None, the default: every elite gets one whole head-to-head. Else they are tested in rounds, and `keep` is asked
        after each."""
        return None

    def keep(self, raced: Sequence[RacedCandidate]) -> list[str]:
        """Ids of those still racing that get another round; fewer than two end the test. By default nobody does.

        raced: every elite, also those that are out. It must be a function of `raced` alone: after a stop it is asked
        again from the first round.
        """
        return []


class LogReader(ABC):
    """Turns somebody's log files into a recording."""

    @abstractmethod
    def read(self, files: Sequence[Path], mapping: Mapping[str, Any], robot: Robot) -> Recording:
        """One recording from the files. Raises RecordingError naming file, column and what to do."""
