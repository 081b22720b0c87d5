"""What a robot's joints did between two samples of a log, from its own position control.

Torque of a position-controlled joint, kp (q* - q) - kd q', jumps where the target q* does, once a control step, and
falls again as the joint follows. A log that reads it once a control step, before the new target, has the lowest of it.
What lies between is known all the same: the target is in the log, and the joint moves smoothly. So the control step is
told in K steps, as the training simulation takes them: torque at the beginning of each, speed in its middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hts.channels import SUBSTEP_TORQUE, SUBSTEP_VELOCITY
from hts.errors import ConfigError

if TYPE_CHECKING:
    from hts.recordings.recording import Recording

IN_STEPS = {"joint_torque": SUBSTEP_TORQUE, "joint_velocity": SUBSTEP_VELOCITY}
"""Channel of a log -> the channel of an env that tells the same in each physics step."""
NEEDED = ("joint_torque", "joint_velocity", "joint_position", "joint_target")
LEAST_AGREEMENT = 0.7  # correlation of the torque that is read with the computed one
SCALE = (0.5, 2.0)  # of the read torque and the computed one: gains in the firmware's units may be off so far


def in_physics_steps(names: Sequence[str], what: str) -> tuple[str, ...]:
    """The channels of an env that tell these in each physics step. Raises ConfigError for one that none does; what: is
    to be asked so."""
    strange = [name for name in names if name not in IN_STEPS]
    if strange:
        raise ConfigError(
            f"{what} is to be asked in each physics step, and reads '{strange[0]}', which no env tells so. Known: "
            f"{', '.join(IN_STEPS)}."
        )
    return tuple(IN_STEPS[name] for name in names)


def torque_scale(recording: Recording) -> float | None:
    """By what the torque that position control asks for is multiplied to be the one that is read; None where the log
    does not hold what that takes, or where the two do not agree."""
    if not set(NEEDED) <= set(recording.channels):
        return None
    read, speed, position, target = _joints(recording)
    if any(gain.shape != read.shape[1:] for gain in _gains(recording)):
        return None
    asked = _asked(recording, _before(target), position, speed)
    scale = float((read * asked).sum() / max(float((asked * asked).sum()), 1e-12))
    agreed = np.corrcoef(read.ravel(), asked.ravel())[0, 1]
    return scale if SCALE[0] < scale < SCALE[1] and agreed > LEAST_AGREEMENT else None


def torque_at_samples(recording: Recording) -> np.ndarray | None:
    """The torque that position control asks for at each sample, N·m (T, J), in the scale of the one that is read; None
    where `torque_scale` is."""
    scale = torque_scale(recording)
    if scale is None:
        return None
    _, speed, position, target = _joints(recording)
    return scale * _asked(recording, _before(target), position, speed)


def _asked(recording: Recording, target: np.ndarray, position: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """kp (target - position) - kd speed, N·m; all (T, J)."""
    kp, kd = _gains(recording)
    asked: np.ndarray = kp * (target - position) - kd * speed
    return asked


def between_samples(recording: Recording, steps: int, late: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Torque N·m and speed rad/s (T, steps, J) in each of so many equal parts of the control step that ends with a
    sample; of the first sample those of the second. None where `torque_scale` is.

    late: in the first so many parts the target before is still in force. Position is the cubic (Hermite) through both
    samples and their speeds, speed the line between them.
    """
    scale = torque_scale(recording)
    if scale is None or recording.num_samples < 2:
        return None
    _, speed, position, target = _joints(recording)
    dt, older = 1.0 / recording.rate_hz, _before(target)
    torques, speeds = [], []
    for part in range(steps):
        u, middle = part / steps, (part + 0.5) / steps
        at = (
            (1 + 2 * u) * (1 - u) ** 2 * position[:-1]
            + u * (1 - u) ** 2 * dt * speed[:-1]
            + u**2 * (3 - 2 * u) * position[1:]
            - u**2 * (1 - u) * dt * speed[1:]
        )
        fast = (1 - u) * speed[:-1] + u * speed[1:]
        in_force = older[:-1] if part < late else target[:-1]
        torques.append(scale * _asked(recording, in_force, at, fast))
        speeds.append((1 - middle) * speed[:-1] + middle * speed[1:])
    return _with_first(torques), _with_first(speeds)


def _with_first(parts: Sequence[np.ndarray]) -> np.ndarray:
    whole = np.stack(parts, 1)
    return np.concatenate((whole[:1], whole))


def _before(target: np.ndarray) -> np.ndarray:
    """What is read now answers to the target before."""
    return np.concatenate((target[:1], target[:-1]))


def _joints(recording: Recording) -> list[np.ndarray]:
    return [np.asarray(recording.values(name), dtype=float) for name in NEEDED]


def _gains(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(recording.kp, dtype=float), np.asarray(recording.kd, dtype=float)
