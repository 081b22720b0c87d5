"""Whether joint targets are the angles that the joints are told: degrees, offsets from a pose, and a policy's actions
look like targets too, and no limit shows them, since a target may lie far outside of a joint's range.

A joint follows its target, so over a walk the two lie near each other: of the medians of (target - position) the root
mean square over all joints was 0.13 and 0.16 rad on simulated walks of a quadruped, 0.10 rad on a public log of a real
one (tests/recordings/test_real_logs.py). The same walks with offsets from the default pose in the place of targets had
1.1 to 1.3 rad, with actions 1.5, and 60 in degrees. Only what another reading explains is refused: a machine that is
let go, or leans on something, may lie far from its targets, too.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from hts.contracts import RobotSpec
from hts.errors import RecordingError
from hts.recordings.recording import Recording
from hts.recordings.repeated import moving

TARGET, POSITION = "joint_target", "joint_position"
LEAST_SECONDS = 3.0
"""Of moving joints."""
VARIES = 0.01
"""rad of standard deviation, of half of the targets: others are held, or written by nobody."""
FAR = 0.5
"""rad, from which on targets are looked at."""
EXPLAINED = 1 / 3
"""Another reading explains them if it brings them so much nearer."""
SWINGS = 10.0
"""Times as much as the positions targets vary, in the middle, that may be degrees, which vary 57 times as much; of a
walk it was 2.6 to 2.7 times."""


def check_targets(recording: Recording, spec: RobotSpec, where: str, stated: Collection[str] = ()) -> None:
    """Raise RecordingError where `joint_target` lies far from `joint_position`, and near it read as something else.

    spec: its default pose, rad, and action scale, rad; where: begins the message; stated: names of channels whose
    limits a mapping states, which is a person's word for them. Nothing is said of a log without both channels in rad,
    of one that hardly moves, nor where the targets stay as they are.
    """
    channels, names = recording.channels, (TARGET, POSITION)
    if TARGET in stated or any(name not in channels or channels[name].channel.unit != "rad" for name in names):
        return
    walks = moving(channels, recording.rate_hz)
    if walks is None or walks.sum() < LEAST_SECONDS * recording.rate_hz:
        return
    target, position = (channels[name].values[walks].astype(np.float64) for name in names)
    if target.shape != position.shape or target.shape[1:] != (spec.num_joints,):
        return
    if np.median(target.std(axis=0)) < VARIES:
        return
    asked, found = np.median(target, axis=0), np.median(position, axis=0)
    far = _apart(asked, found)
    explained = _read_otherwise(asked, found, spec)
    if np.median(target.std(axis=0)) > SWINGS * np.median(position.std(axis=0)):
        explained["taken as degrees. Expected rad: say unit: deg"] = _apart(np.radians(asked), found)
    hint = min(explained, key=lambda one: explained[one])
    if far <= FAR or explained[hint] > EXPLAINED * far:
        return
    seconds = walks.sum() / recording.rate_hz
    raise RecordingError(
        f"{where}: '{TARGET}' lies {far:.2g} rad from '{POSITION}' (median of {seconds:.3g} s of moving, root mean "
        f"square of all joints), but {explained[hint]:.2g} rad {hint}; if it is right, say so with `limits`."
    )


def _apart(one: np.ndarray, other: np.ndarray) -> float:
    """Root mean square over the joints, rad. one, other: (J,)."""
    return float(np.sqrt(np.mean((one - other) ** 2)))


def _read_otherwise(asked: np.ndarray, found: np.ndarray, spec: RobotSpec) -> dict[str, float]:
    """What else targets may be, with what to do -> how far they lie from the positions then, rad. asked, found: (J,)
    medians of targets and positions, rad. A pose near zero tells nothing of offsets from it."""
    pose, scale = np.asarray(spec.default_pose), np.asarray(spec.action_scale)
    explained = {
        "taken the other way. Expected the positions' sign: say sign: -1": _apart(-asked, found),
        "in another order of the joints. Expected that of the positions: correct the columns": _apart(
            np.sort(asked), np.sort(found)
        ),
    }
    if _apart(pose, np.zeros(len(pose))) > FAR:
        explained[
            "taken as what a policy gives, offsets from the default pose or actions. Expected the angle that is sent, "
            "default_pose + offset or default_pose + action_scale * action: write that into the log, or import without "
            "it, --drop joint_target"
        ] = min(_apart(pose + asked, found), _apart(pose + scale * asked, found))
    return explained
