"""Measurement model `drive_train`: what the physics of electric drives allows, and no more.

    z(t) = sum_k h_k s(t - k),   s = b + sum_j w_j . phi(tau_j, q'_j),   h_k >= 0, sum h = 1

phi holds the terms of which a drive's electrical power is made (docs/twin.md, items 1 to 6): copper loss tau^2,
mechanical power tau q', the part of it that is not generated max(tau q', 0), inverter loss |tau|, iron loss |q'| and
q'^2, and tau^4 for motors that saturate. h is the sensor: it averages and is late. At rest (phi = 0) the target is at
its idle level, which every recording says.

Joints of one kind (the hips, the thighs, ...) are built alike: their weights are a common one plus a deviation each,
and both are penalised, the deviations more (a hierarchical linear model). The penalties are the largest whose error on
left-out policies (recordings, while there are few policies) is within one standard error of the least: a weight that
the data do not ask for is one that a policy would exploit. So some twenty numbers carry most of a fit, and a few
minutes of walking determine them; what they leave open is the posterior covariance, from which every prediction has its
own standard deviation.

Noise in the torque of a log flattens its square, and a policy then finds the copper loss too cheap. The torque of a
position-controlled joint is also known from its target, kp (target - q) - kd q', up to one factor (the firmware's scale
of gains), which the log itself tells. The fit takes the torque, read or computed, that explains the target better.

Inside the env the reward looks at s itself (`settled`): it has the same mean as z without the sensor's delay, so an
action is paid for when it is taken and not half a second later.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from hts.config import Config
from hts.contracts import MeasurementModel, ModelContext, Prediction, Signals
from hts.errors import ConfigError
from hts.measurement.data import training_data
from hts.measurement.lstm_fit import one_thread
from hts.measurement.torch_model import TorchModel

if TYPE_CHECKING:
    from hts.contracts.measurement_model import Progress
    from hts.recordings.recording import Recording

TERMS = 7  # per joint
DIRECTIONS = 16  # of the posterior covariance that are kept, the widest ones
COMMON = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # penalty on common weights, per sample
OWN = (10.0, 100.0, 1000.0, 1e5)  # times that: on deviations of single joints
MOST_FOLDS = 10
LEAST_AGREEMENT = 0.7  # correlation of the torque that is read with the computed one
ROUNDS = 3  # of sensor and drives in turn
IDLE_SHARE = 0.02  # the idle level counts as so many samples, of all
BLOCK_SECONDS = 2.0  # of residuals that are taken to be one: a stride is like the next


class DriveTrainSettings(Config):
    """Settings of measurement model `drive_train`."""

    lag_seconds: float = Field(1.0, ge=0, description="how far back the sensor may look, s")
    beta: float = Field(
        1.0, ge=0, description="β: the reward is that of the worse end of mean ± β standard deviations; 0: of the mean"
    )
    instant: bool = Field(
        True,
        description="reward each action when it is taken, without the sensor's delay; false: as the sensor shows it",
    )


def make(settings: Mapping[str, Any], context: ModelContext) -> MeasurementModel:
    """Raises ConfigError unless it reads two channels of one size: torque and speed of the same joints."""
    return DriveTrain(DriveTrainSettings.model_validate(dict(settings)), context.signals)


class DriveTrain(TorchModel):
    """weight: (TERMS · J,), scaled terms to z-scores; bias: (); sensor: h, (M + 1,), M samples of the longest lag;
    doubt: (TERMS · J + 1, DIRECTIONS), a square root of the posterior covariance of weight and bias. The memory of W
    worlds is (W, M): what the past adds to the next M predictions."""

    def __init__(self, config: DriveTrainSettings, signals: Signals) -> None:
        if len(signals.sizes) != 2 or signals.sizes[0] != signals.sizes[1]:
            found = ", ".join(f"{channel.name} {channel.shape}" for channel in signals.inputs)
            raise ConfigError(
                f"drive_train reads torque and speed of the same joints, in this order; found {found}. Choose another "
                "measurement model for this objective, e.g. linear."
            )
        super().__init__(signals)
        self.config = config
        self.pessimism = config.beta
        self.longest = round(config.lag_seconds * signals.rate_hz)
        self.register_buffer("weight", torch.zeros(self.num_features))
        self.register_buffer("bias", torch.tensor(0.0))
        self.register_buffer("sensor", torch.zeros(self.longest + 1))
        self.register_buffer("doubt", torch.zeros(self.num_features + 1, DIRECTIONS))
        self.eval()

    @property
    def settings(self) -> Mapping[str, Any]:
        return self.config.model_dump(mode="json")

    @property
    def num_features(self) -> int:
        """TERMS for each joint."""
        return TERMS * self.signals.sizes[0]

    def features(self, inputs: Tensor) -> Tensor:
        """Torque and speed (..., 2 J) -> terms (..., TERMS · J), term by term; not scaled."""
        torque, speed = inputs.unflatten(-1, (2, -1)).unbind(-2)
        squared, power = torque * torque, torque * speed
        terms = (squared, power, power.clamp_min(0.0), torque.abs(), speed.abs(), speed * speed, squared * squared)
        return torch.cat(terms, -1)

    @property
    def settles(self) -> bool:
        """Whether the reward looks at `settled`."""
        return self.config.instant

    # --------------------------------------------------------------------------------------------- fitting

    @torch.no_grad()
    def fit(
        self,
        recordings: Sequence[Recording],
        *,
        seed: int = 0,
        epochs: int = 20,
        max_seconds: float = math.inf,
        progress: Progress | None = None,
        warm_start: MeasurementModel | None = None,
    ) -> dict[str, Any]:
        """Drives and sensor in turn, each by least squares in double precision; seed, epochs and warm start have
        nothing to change in it."""
        began = time.monotonic()
        pieces = training_data(self.signals, recordings)
        with one_thread():
            self.set_statistics(torch.cat([p.inputs for p in pieces]), torch.cat([p.target for p in pieces]))
            targets = [self.normalise_target(piece.target.double()).numpy() for piece in pieces]
            name = self.signals.target.name
            idle = [float(recording.idle[name]) for recording in recordings if name in recording.idle]
            rest = None if not idle else (float(np.mean(idle)) - float(self.target_mean)) / float(self.target_std)
            kind, folds = kinds(recordings[0].joint_names, self.signals.sizes[0]), _folds(recordings)
            sources = {"read": [piece.inputs for piece in pieces]}
            computed = [computed_inputs(self.signals, recording) for recording in recordings]
            if all(inputs is not None for inputs in computed):
                sources["computed"] = [inputs for inputs in computed if inputs is not None]
            found: dict[str, tuple[_Drives, np.ndarray, list[np.ndarray]]] = {}
            for source, inputs in sources.items():
                terms = [self.scaled_features(each.double()).numpy() for each in inputs]
                drives = _Drives(kind, rest)
                seen = [piece.sum(1) for piece in terms]
                for _ in range(ROUNDS):
                    sensor = _sensor(seen, targets, self.longest)
                    shown = [_shown(piece, sensor) for piece in terms]
                    drives.fit(shown, targets, folds, self.longest)
                    seen = [piece @ drives.weight + drives.bias for piece in terms]
                found[source] = drives, sensor, shown
                if progress is not None:
                    progress(len(found), len(sources), drives.error)
            torque = min(found, key=lambda source: found[source][0].error)
            drives, sensor, shown = found[torque]
            doubt = drives.doubt(shown, targets, self.longest, self.signals.rate_hz)
        for buffer, value in (
            (self.weight, drives.weight),
            (self.bias, drives.bias),
            (self.sensor, sensor),
            (self.doubt, doubt),
        ):
            buffer.copy_(torch.as_tensor(value))
        self._folded = None
        return {
            "samples": sum(len(piece.target) for piece in pieces),
            "recordings": len(recordings),
            "seed": seed,
            "epochs": 1,
            "stopped": "solved",
            "warm_started": False,
            "torque": torque,
            "penalties": {"common": drives.penalties[0], "own": drives.penalties[1]},
            "sensor_delay_seconds": float(sensor @ np.arange(len(sensor)) / self.signals.rate_hz),
            "validation_r2": 1.0 - drives.error / float(np.concatenate(targets).var()),
            "seconds": time.monotonic() - began,
        }

    def _before_statistics(self, mean: Tensor, std: Tensor, target_mean: Tensor, target_std: Tensor) -> None:
        """Each term has one scale for all joints, so that weights of joints built alike are alike; none is shifted, so
        that nothing stays nothing at rest."""
        size = (mean.square() + std.square()).view(TERMS, -1).mean(1).sqrt()
        std.copy_(torch.where(size > 0, size, 1.0).repeat_interleave(self.signals.sizes[0]))
        mean.zero_()

    # --------------------------------------------------------------------------------------------- running

    def initial_state(self, num_worlds: int) -> Tensor:
        return torch.zeros(num_worlds, self.longest, device=self.device)

    def reset(self, state: Tensor, begun: Tensor) -> Tensor:
        return state.masked_fill(begun[:, None], 0.0)

    def settled(self, inputs: Tensor) -> Prediction:
        """What the target would settle at if these inputs stayed: inputs (..., F) -> (...)."""
        weight, constant = self._weights()
        found = self.features(inputs) @ weight + constant
        return Prediction(found[..., 0], found[..., 1:].square().sum(-1).sqrt())

    def sequence(self, inputs: Tensor, state: Tensor | None = None) -> tuple[Prediction, Tensor]:
        mean, std = self.settled(inputs)
        batch, length = mean.shape
        total = mean.new_zeros(batch, length + self.longest)
        if state is not None:
            total[:, : self.longest] += state
        for lag, share in enumerate(self.sensor):
            total[:, lag : lag + length] += share * mean
        return Prediction(total[:, :length], std), total[:, length:]

    @torch.no_grad()
    def step(self, inputs: Tensor, state: Tensor) -> tuple[Prediction, Tensor]:
        mean, std = self.settled(inputs)
        total = mean[:, None] * self.sensor + torch.cat((state, torch.zeros_like(mean[:, None])), 1)
        return Prediction(total[:, 0], std), total[:, 1:]

    def _weights(self) -> tuple[Tensor, Tensor]:
        """(TERMS · J, 1 + DIRECTIONS) and (1 + DIRECTIONS,): terms in channel units to the mean, and to what squares
        and adds up to the variance."""
        if self._folded is None:
            columns = torch.cat((self.weight[:, None], self.doubt[:-1]), 1).double() / self.feature_std[:, None]
            self._folded = columns.float(), torch.cat((self.bias[None], self.doubt[-1]))
        return self._folded


def kinds(names: Sequence[str], count: int) -> np.ndarray:
    """Which joints are built alike, (J,) numbers: FR_hip and FL_hip are, by what follows the leg's name.
    All are where names do not say."""
    rest = [name.split("_", 1)[-1] for name in names]
    if len(rest) != count or any(rest.count(one) < 2 for one in rest):
        return np.zeros(count, dtype=int)
    order = list(dict.fromkeys(rest))
    return np.array([order.index(one) for one in rest])


def _folds(recordings: Sequence[Recording]) -> np.ndarray:
    """A number for each recording: what is left out together."""
    policies = [recording.policy_hash for recording in recordings]
    names = policies if len(set(policies)) >= 4 else [str(index) for index in range(len(recordings))]
    order = list(dict.fromkeys(names))
    return np.array([order.index(name) % MOST_FOLDS for name in names])


def computed_inputs(signals: Signals, recording: Recording) -> Tensor | None:
    """Torque and speed (T, 2 J) with the torque that the joints' position control asked for; None where the log does
    not hold what that takes, or where it does not agree with the torque that was read."""
    names = {"joint_torque", "joint_velocity", "joint_position", "joint_target"}
    if set(signals.names) != {"joint_torque", "joint_velocity"} or not names <= set(recording.channels):
        return None
    read, speed, position, target = (
        np.asarray(recording.values(name), dtype=float)
        for name in ("joint_torque", "joint_velocity", "joint_position", "joint_target")
    )
    gains = [np.asarray(gain, dtype=float) for gain in (recording.kp, recording.kd)]
    if any(gain.shape != read.shape[1:] for gain in gains):
        return None
    in_force = np.concatenate((target[:1], target[:-1]))  # what is read now answers to the target before
    asked = gains[0] * (in_force - position) - gains[1] * speed
    scale = float((read * asked).sum() / max((asked * asked).sum(), 1e-12))
    agreed = np.corrcoef(read.ravel(), asked.ravel())[0, 1]
    if not (0.5 < scale < 2.0 and agreed > LEAST_AGREEMENT):
        return None
    parts = {"joint_torque": scale * asked, "joint_velocity": speed}
    return torch.from_numpy(np.concatenate([parts[name] for name in signals.names], 1)).float()


def _shown(values: np.ndarray, sensor: np.ndarray) -> np.ndarray:
    """Series (T, G) as the sensor shows them."""
    return np.stack([np.convolve(column, sensor)[: len(values)] for column in values.T], 1)


def _skipped(length: int, longest: int) -> int:
    """How much of a recording's start is not used: what came before it is unknown."""
    return min(longest, length // 2)


def _sensor(seen: Sequence[np.ndarray], targets: Sequence[np.ndarray], longest: int) -> np.ndarray:
    """h (M + 1,) by non-negative least squares from what the drives take (T,) to what is shown, with a free level."""
    from scipy.optimize import nnls

    rows, right = [], []
    for taken, target in zip(seen, targets, strict=True):
        skip = _skipped(len(target), longest)
        padded = np.concatenate((np.full(longest, taken[0]), taken))
        windows = np.lib.stride_tricks.sliding_window_view(padded, longest + 1)[:, ::-1][skip:]
        rows.append(windows - windows.mean(0))
        right.append(target[skip:] - target[skip:].mean())
    gram = sum(row.T @ row for row in rows)
    cross = sum(row.T @ y for row, y in zip(rows, right, strict=True))
    gram[np.diag_indices_from(gram)] += 1e-6 * np.trace(gram) / len(gram)
    root = np.linalg.cholesky(gram)
    found = nnls(root.T, np.linalg.solve(root, cross), maxiter=50 * len(cross))[0]
    total = found.sum()
    return found / total if total > 0 else np.eye(1, longest + 1)[0]


class _Drives:
    """Weights of the drives' terms by hierarchical least squares.

    Coefficients are common ones of each kind of joint (u), deviations of each joint (v), and the level b:
    w = A u + v. Everything follows from sums of squares and products of each recording.
    """

    def __init__(self, kind: np.ndarray, rest: float | None) -> None:
        joints, number = len(kind), int(kind.max()) + 1
        self._rest = rest
        spread = np.zeros((TERMS * joints, TERMS * number))
        for term in range(TERMS):
            for joint in range(joints):
                spread[term * joints + joint, term * number + kind[joint]] = 1.0
        size = TERMS * joints
        self._map = np.zeros((size + 1, spread.shape[1] + size + 1))  # from (u, v, b) to (w, b)
        self._map[:size, : spread.shape[1]], self._map[:size, spread.shape[1] : -1] = spread, np.eye(size)
        self._map[-1, -1] = 1.0
        self._common = spread.shape[1]
        self.weight, self.bias, self.error = np.zeros(size), 0.0, math.inf
        self.penalties = (COMMON[0], OWN[0])

    def fit(self, shown: Sequence[np.ndarray], targets: Sequence[np.ndarray], folds: np.ndarray, longest: int) -> None:
        """shown: terms as the sensor shows them, (T, TERMS · J) of each recording; folds: a number of each."""
        sums = [_Sums.of(terms, target, longest) for terms, target in zip(shown, targets, strict=True)]
        whole = _Sums.total(sums)
        parts = [_Sums.total([one for one, own in zip(sums, folds, strict=True) if own == fold]) for fold in set(folds)]
        table: dict[tuple[float, float], np.ndarray] = {}
        for penalties in itertools.product(COMMON, OWN):
            rests = [(part, whole.minus(part)) for part in parts] if len(parts) > 1 else [(whole, whole)]
            table[penalties] = np.array([part.error(self._solved(rest, *penalties)) for part, rest in rests])
        best = min(table, key=lambda one: table[one].mean())
        bar = table[best].mean() + table[best].std(ddof=min(1, len(table[best]) - 1)) / math.sqrt(len(table[best]))
        # Those of deviations first: single joints are where a model of a few gaits goes wrong.
        self.penalties = max((one for one in table if table[one].mean() <= bar), key=lambda one: (one[1], one[0]))
        solution = self._solved(whole, *self.penalties)
        self.weight, self.bias, self.error = solution[:-1], float(solution[-1]), float(table[self.penalties].mean())

    def doubt(
        self, shown: Sequence[np.ndarray], targets: Sequence[np.ndarray], longest: int, rate_hz: float
    ) -> np.ndarray:
        """Square root (TERMS · J + 1, DIRECTIONS) of the posterior covariance of weights and level.

        Residuals are alike for a while, and one recording's differ from the next one's: the variance of their means
        over blocks, and over recordings, times the length says how many samples are really one.
        """
        whole = _Sums.total([_Sums.of(terms, target, longest) for terms, target in zip(shown, targets, strict=True)])
        residuals = []
        for terms, target in zip(shown, targets, strict=True):
            skip = _skipped(len(target), longest)
            residuals.append((target - terms @ self.weight - self.bias)[skip:])
        block = max(1, round(BLOCK_SECONDS * rate_hz))
        pieces = [r[i : i + block] for r in residuals for i in range(0, max(1, len(r) - block + 1), block)]
        noise = max(
            float(np.mean([len(piece) * piece.mean() ** 2 for piece in pieces])),
            float(np.mean([len(piece) * piece.mean() ** 2 for piece in residuals])),
            float(np.mean(np.concatenate(residuals) ** 2)),
        )
        matrix, _ = self._normal(whole, *self.penalties)
        covariance = self._map @ np.linalg.solve(matrix, self._map.T) * noise
        values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
        kept = np.argsort(values)[::-1][:DIRECTIONS]
        root = np.zeros((len(values), DIRECTIONS))  # of a robot with fewer, the rest stays 0
        root[:, : len(kept)] = vectors[:, kept] * np.sqrt(np.maximum(values[kept], 0.0))
        return root

    def _solved(self, sums: _Sums, common: float, own: float) -> np.ndarray:
        """(w, b)."""
        matrix, right = self._normal(sums, common, own)
        return self._map @ np.linalg.solve(matrix, right)

    def _normal(self, sums: _Sums, common: float, own: float) -> tuple[np.ndarray, np.ndarray]:
        """Normal equations of (u, v, b)."""
        matrix = self._map.T @ sums.xx @ self._map
        right = self._map.T @ sums.xy
        penalty = np.full(len(matrix), common * own * sums.count)
        penalty[: self._common] = common * sums.count
        penalty[-1] = 1e-9 * sums.count
        if self._rest is not None:
            penalty[-1] = IDLE_SHARE * sums.count
            right[-1] += penalty[-1] * self._rest
        matrix[np.diag_indices_from(matrix)] += penalty
        return matrix, right


class _Sums:
    """XᵀX, Xᵀy, yᵀy of (terms, 1) and target."""

    def __init__(self, count: int, xx: np.ndarray, xy: np.ndarray, yy: float) -> None:
        self.count, self.xx, self.xy, self.yy = count, xx, xy, yy

    @classmethod
    def of(cls, terms: np.ndarray, target: np.ndarray, longest: int) -> _Sums:
        skip = _skipped(len(target), longest)
        x, y = np.concatenate((terms[skip:], np.ones((len(terms) - skip, 1))), 1), target[skip:]
        return cls(len(y), x.T @ x, x.T @ y, float(y @ y))

    @classmethod
    def total(cls, sums: Sequence[_Sums]) -> _Sums:
        none = np.zeros(())
        xx, xy = sum((s.xx for s in sums), none), sum((s.xy for s in sums), none)
        return cls(sum(s.count for s in sums), xx, xy, sum(s.yy for s in sums))

    def minus(self, other: _Sums) -> _Sums:
        return _Sums(self.count - other.count, self.xx - other.xx, self.xy - other.xy, self.yy - other.yy)

    def error(self, solution: np.ndarray) -> float:
        """Mean squared error of (w, b)."""
        return float(self.yy - 2 * solution @ self.xy + solution @ self.xx @ solution) / max(1, self.count)
