"""Whether forces under feet are newtons, and under the feet that they are said to be under.

Over a walk the ground carries the robot, so in the mean the forces make its weight: on the default simulated robot and
16 drawn ones, six walks each, 0.72 to 1.66 times that, drift and errors of the sensors included.

A leg that stands on the ground has larger torques than one in the air, so the force under its foot rises with them.
Which joints move a foot the model says. On the same walks the correlation, in the mean of the legs, was 0.55 to 0.91,
and with left and right exchanged in all channels of joints -0.45 to -0.87. On two public logs of a walking quadruped it
is -0.69 and -0.72, and 0.81 and 0.79 if left and right feet are exchanged: their columns are called after the wrong
feet (tests/recordings/test_feet.py).
"""

from __future__ import annotations

from collections.abc import Collection
from itertools import permutations
from typing import TYPE_CHECKING

import numpy as np

from hts.contracts import Robot
from hts.recordings.recording import Recording
from hts.recordings.repeated import moving
from hts.recordings.robot_model import robot_model

if TYPE_CHECKING:
    import mujoco

FORCE, TORQUE = "foot_force", "joint_torque"
LEAST_SECONDS = 3.0
"""Of moving joints."""
MUCH, LITTLE, SWINGS = 2.5, 0.3, 2.0
"""Times the weight, of the mean, from which on and below which it is told; below, only where the feet's standard
deviations together are less than SWINGS times the mean (1 of a trot), since a sensor's zero may drift below that."""
UNLIKE, LIKE = -0.3, 0.5
"""Correlation, mean of the legs, below which the feet are not those of the legs, and above which others are."""
OVER_SECONDS = 1.0
"""What changes slower than that is left out: loads, and drift of a sensor."""
LATE_SECONDS = 0.06
"""By which forces may come later than torques, or earlier."""
LEGS = range(3, 5)
"""Robots with two feet may stand with straight knees, which takes hardly any torque."""


def foot_notes(recording: Recording, robot: Robot, stated: Collection[str] = ()) -> dict[str, str]:
    """Notes where `foot_force` is far from carrying the robot, or goes with the torques of other legs.

    stated: names of channels whose limits a mapping states, which is a person's word for them. Nothing is said of a log
    without forces in N, of a fall, of a robot that hardly moves, or without a model.
    """
    series = recording.channels.get(FORCE)
    if series is None or FORCE in stated or recording.fell or series.channel.unit != "N" or series.values.ndim != 2:
        return {}
    walks = moving(recording.channels, recording.rate_hz)
    model = None if walks is None or walks.sum() < LEAST_SECONDS * recording.rate_hz else robot_model(robot)
    if walks is None or model is None:
        return {}
    force = series.values.astype(np.float64)
    return _scale_notes(recording, model, force, walks) | _leg_notes(recording, robot, model, force, walks)


def _scale_notes(recording: Recording, model: mujoco.MjModel, force: np.ndarray, walks: np.ndarray) -> dict[str, str]:
    from hts.sim.models import moving_mass

    weight = 9.81 * (recording.mass_kg or moving_mass(model))
    share = float(force[walks].sum(axis=1).mean()) / weight
    swings = float(force[walks].std(axis=0).sum()) / weight
    if not (share > MUCH or (share < LITTLE and swings < SWINGS * share)):
        return {}
    other = "has the zero of the sensors moved" if share > MUCH else "was the robot carried"
    return {
        "foot_force_scale": (
            f"the feet carry {share * weight:.3g} N in the mean of {walks.sum() / recording.rate_hz:.3g} s of moving, "
            f"{share:.2g} times the robot's weight ({weight:.3g} N). Expected about as much: is it in another unit "
            f"(raw counts of a sensor are no N; correct unit or scale), or {other}?"
        )
    }


def _leg_notes(
    recording: Recording, robot: Robot, model: mujoco.MjModel, force: np.ndarray, walks: np.ndarray
) -> dict[str, str]:
    legs, torque = _legs(robot, model), recording.channels.get(TORQUE)
    if torque is None or len(legs) not in LEGS or len(legs) != force.shape[1]:
        return {}
    effort = np.stack([np.sqrt((torque.values[:, leg].astype(np.float64) ** 2).sum(axis=1)) for leg in legs], axis=1)
    second, late = round(OVER_SECONDS * recording.rate_hz), round(LATE_SECONDS * recording.rate_hz)
    alike = alike_at_best(quick(force, second), quick(effort, second), walks, late)
    if alike is None:
        return {}
    own = float(np.diag(alike).mean())
    orders = {
        order: float(np.mean([alike[foot, leg] for foot, leg in enumerate(order)]))
        for order in permutations(range(len(legs)))
    }
    best = max(orders, key=lambda order: orders[order])
    if not (own < UNLIKE and orders[best] > LIKE):
        return {}
    feet = robot.spec.foot_sites
    shown = ", ".join(f"{feet[foot]} with the leg of {feet[leg]}" for foot, leg in enumerate(best) if foot != leg)
    return {
        "foot_force_legs": (
            f"{FORCE} falls where {TORQUE} of the same leg rises (correlation {own:.2f} in the mean of {len(legs)} "
            f"legs), and goes with other legs: {shown} ({orders[best]:.2f}). Expected is that a leg which stands has "
            f"more of both: are legs exchanged, in {FORCE} or in all channels of joints, or is one of the two late by "
            "0.1 s and more? A steady gait does not tell which"
        )
    }


def _legs(robot: Robot, model: mujoco.MjModel) -> list[list[int]]:
    """Joints that move each foot and no other one, as numbers of the robot's joint order; of each foot."""
    found: list[set[int]] = []
    if not {*robot.spec.foot_sites} <= {model.site(number).name for number in range(model.nsite)}:
        return []
    for site in robot.spec.foot_sites:
        body, moved = int(model.site(site).bodyid[0]), set[int]()
        while body:
            first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
            names = [model.joint(joint).name for joint in range(first, first + count)]
            moved |= {robot.spec.joint_names.index(name) for name in names if name in robot.spec.joint_names}
            body = int(model.body_parentid[body])
        found.append(moved)
    own = [sorted(leg.difference(*(other for other in found if other is not leg))) for leg in found]
    return own if all(own) else []


def quick(values: np.ndarray, samples: int) -> np.ndarray:
    """Values (T, C) without what changes slower than so many samples."""
    window = np.ones(max(1, min(samples, len(values))))
    whole = np.convolve(np.ones(len(values)), window, "same")
    return values - np.stack([np.convolve(one, window, "same") / whole for one in values.T], axis=1)


def alike_at_best(force: np.ndarray, effort: np.ndarray, walks: np.ndarray, late: int) -> np.ndarray | None:
    """Correlation of each foot's force with each leg's effort, (F, F), at the delay of up to `late` samples, either
    way, where the largest of them are largest; None of what does not change. force, effort: (T, F)."""
    best: np.ndarray | None = None
    for by in range(-late, late + 1):
        first, last = max(0, by), len(force) + min(0, by)
        kept = walks[first:last]
        one, other = force[first:last][kept], effort[first - by : last - by][kept]
        spread = one.std(axis=0)[:, None] * other.std(axis=0)
        if not (spread > 0).all():  # nor of values that are missing, NaN
            return None
        alike = np.asarray((one - one.mean(axis=0)).T @ (other - other.mean(axis=0)) / len(one) / spread)
        if best is None or np.abs(alike).sum() > np.abs(best).sum():
            best = alike
    return best
