"""Whether joint targets are the angles that the joints are told: degrees, offsets from a pose, and a policy's actions
look like targets too, and no limit shows them, since a target may lie far outside of a joint's range.

A joint follows its target, so over a walk the two lie near each other: of the medians of (target - position) the root
mean square over all joints was 0.13 and 0.16 rad on simulated walks of a quadruped, 0.10 rad on a public log of a real
one (tests/recordings/test_real_logs.py). The same walks with offsets from the default pose in the place of targets had
1.1 to 1.3 rad, with actions 1.5, and 60 in degrees. Only what another reading explains is refused: a machine that is
let go, or leans on something, may lie far from its targets, too. A default pose plus anything small lies near joints
that work about that pose, so read otherwise the targets must also lead the positions in time, and as far as these go.
Targets of an arm that stay for a while and then jump, where it is to go next, lie far from it rightly.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from hts.contracts import RobotSpec
from hts.errors import RecordingError
from hts.recordings.motion import correlations
from hts.recordings.recording import Recording
from hts.recordings.repeated import SAME, moving, runs_of

TARGET, POSITION = "joint_target", "joint_position"
LEAST_SECONDS = 3.0
"""Of moving joints."""
VARIES = 0.01
"""rad of standard deviation, of half of the targets: others are held, or written by nobody."""
FAR = 0.5
"""rad, from which on targets are looked at; read otherwise they must lie nearer than that."""
EXPLAINED = 1 / 3
"""Another reading explains them if it brings them so much nearer."""
SWINGS = 10.0
"""Times as much as the positions targets vary, in the middle, that may be degrees, which vary 57 times as much; of a
walk it was 2.6 to 2.7 times."""
HELD_SECONDS, HELD = 0.2, 0.5
"""Targets that stay for so long, in so many samples of the joint in the middle, are where to go next; policies act
every 0.02 s or so."""
LATE_SECONDS, LEADS = 0.1, 0.3
"""By up to so many positions follow their targets, and then correlate by so much with them, the joint in the middle: on
the public log by 0.55 at 0.06 s, on four simulated walks by 0.49 to 0.8 at 0.06 to 0.1 s."""
AS_FAR = 0.7
"""Of the positions' standard deviation targets must have so much, the joint in the middle: on the same walks 1.4, and
1.9 to 4.6, times as much, since joints follow late and not all of the way."""
ENDLESS = 60.0
"""rad between the limits of a joint, some ten turns, from which on it turns for ever, as a wheel does."""


def check_targets(recording: Recording, spec: RobotSpec, where: str, stated: Collection[str] = ()) -> None:
    """Raise RecordingError where `joint_target` lies far from `joint_position`, and near it read as something else.

    spec: its default pose, rad, and action scale, rad; where: begins the message; stated: names of channels whose
    limits a mapping states, which is a person's word for them. Nothing is said of a log without both channels in rad,
    of one that hardly moves, nor where the targets stay as they are, for good or until the next, nor of wheels.
    """
    channels, names = recording.channels, (TARGET, POSITION)
    if TARGET in stated or any(name not in channels or channels[name].channel.unit != "rad" for name in names):
        return
    walks = moving(channels, recording.rate_hz)
    if walks is None or walks.sum() < LEAST_SECONDS * recording.rate_hz:
        return
    target, position = (channels[name].values[walks].astype(np.float64) for name in names)
    low, high = np.asarray(spec.position_limit).T
    limited = high - low < ENDLESS
    if target.shape != position.shape or target.shape[1:] != (spec.num_joints,) or not limited.any():
        return
    target, position = target[:, limited], position[:, limited]
    if not np.median(target.std(axis=0)) >= VARIES or _held(target, recording.rate_hz) > HELD:
        return
    far = _distance(target, position)
    pose, scale = np.asarray(spec.default_pose)[limited], np.asarray(spec.action_scale)[limited]
    explained = _read_otherwise(target, position, pose, scale, round(LATE_SECONDS * recording.rate_hz))
    hint = min(explained, key=lambda one: explained[one])
    if not (far > FAR and explained[hint] < min(FAR, EXPLAINED * far)):  # nor of values that are missing, NaN
        return
    seconds = walks.sum() / recording.rate_hz
    raise RecordingError(
        f"{where}: '{TARGET}' lies {far:.2g} rad from '{POSITION}' (median of {seconds:.3g} s of moving, root mean "
        f"square of {limited.sum()} joints), but {explained[hint]:.2g} rad {hint}; if it is right, say so with "
        "`limits`."
    )


def _apart(one: np.ndarray, other: np.ndarray) -> float:
    """Root mean square over the joints, rad. one, other: (J,)."""
    return float(np.sqrt(np.mean((one - other) ** 2)))


def _distance(target: np.ndarray, position: np.ndarray) -> float:
    """Of the medians, `_apart`. target, position: (T, J), rad."""
    return _apart(np.median(target, axis=0), np.median(position, axis=0))


def _held(target: np.ndarray, rate_hz: float) -> float:
    """Share of the samples in which a joint's target stays for HELD_SECONDS and more, of the joint in the middle.
    target: (T, J), rad."""
    same = np.abs(np.diff(target, axis=0)) <= SAME
    lengths = [np.array([last - first for first, last in runs_of(one)]) for one in same.T]
    return float(np.median([one[one >= HELD_SECONDS * rate_hz].sum() for one in lengths])) / len(target)


def _leads(target: np.ndarray, position: np.ndarray, late: int) -> bool:
    """Whether positions go where targets do, up to `late` samples later, and no farther: (T, J) each, rad."""
    moved = (position.std(axis=0) > VARIES) & (target.std(axis=0) > 0)
    if not moved.any():
        return False
    target, position = target[:, moved], position[:, moved]
    ahead = [correlations(target[: len(target) - by], position[by:]) for by in range(late + 1)]
    swings = np.median(target.std(axis=0) / position.std(axis=0))
    return bool(np.median(ahead, axis=1).max() > LEADS and swings > AS_FAR)


def _read_otherwise(
    target: np.ndarray, position: np.ndarray, pose: np.ndarray, scale: np.ndarray, late: int
) -> dict[str, float]:
    """What else targets may be, with what to do -> how far they lie from the positions then, rad.

    target, position: (T, J), rad, positions up to `late` samples later; pose, scale: (J,), of the robot. A pose near
    zero tells nothing of offsets from it, and only targets that vary far more than the positions may be degrees.
    """
    policy = (
        "taken as what a policy gives, offsets from the default pose or actions. Expected the angle that is sent, "
        "default_pose + offset or default_pose + action_scale * action: write that into the log, or leave "
        "joint_target out of the mapping (hts import: --drop joint_target)"
    )
    readings = [("taken the other way. Expected the positions' sign: say sign: -1", -target)]
    if _apart(pose, np.zeros(len(pose))) > FAR:
        readings += [(policy, pose + target), (policy, pose + scale * target)]
    if np.median(target.std(axis=0)) > SWINGS * np.median(position.std(axis=0)):
        readings.append(("taken as degrees. Expected rad: say unit: deg", np.radians(target)))
    asked, found = np.median(target, axis=0), np.median(position, axis=0)
    explained = {
        "in another order of the joints. Expected that of the positions: correct the columns": _apart(
            np.sort(asked), np.sort(found)
        )
    }
    for hint, read in readings:
        if _leads(read, position, late):
            explained[hint] = min(_distance(read, position), explained.get(hint, np.inf))
    return explained
