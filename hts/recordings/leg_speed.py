"""How fast the trunk goes by its legs: a foot that stands stays where it is, so the trunk moves as that foot does not.

With the position p of a foot in the trunk's axes, its change p' and the trunk's turning w, the trunk moves at
-(p' + w x p) while the foot stands. Which foot stands is told by its force, else by which one is lowest.

Where the numbers come from: on the default simulated robot and six drawn ones, told 0.4 and 1.1 m/s, the trunk went
1.1 to 1.2 times as fast as the legs say, up to 1.5 times without forces: feet slip, and the lowest one still lands.
"""

from __future__ import annotations

import numpy as np

from hts.contracts import Robot
from hts.recordings.recording import Recording
from hts.recordings.robot_model import robot_model

POSITION, TURNING, GRAVITY, FORCE = "joint_position", "angular_velocity", "projected_gravity", "foot_force"
MOST_SAMPLES = 3000
"""Of a log that are looked at; a minute at 50 Hz."""


def leg_speed(recording: Recording, robot: Robot) -> np.ndarray | None:
    """Velocity of the trunk by its legs, (T, 2), m/s ahead and to the left, of the first MOST_SAMPLES; None of a robot
    without a model or feet, and of a log without positions in rad or gravity."""
    channels, sites = recording.channels, robot.spec.foot_sites
    if not sites or any(name not in channels for name in (POSITION, GRAVITY)):
        return None
    position, down = (channels[name].values[:MOST_SAMPLES].astype(np.float64) for name in (POSITION, GRAVITY))
    if channels[POSITION].channel.unit != "rad" or position.shape[1:] != (robot.spec.num_joints,) or len(down) < 3:
        return None
    feet = _feet(position, recording.joint_names, robot)
    if feet is None:
        return None
    turning = channels[TURNING].values[: len(down)] if TURNING in channels else np.zeros_like(down)
    trunk = -(np.gradient(feet, 1.0 / recording.rate_hz, axis=0) + np.cross(turning[:, None], feet))
    force = channels[FORCE].values[: len(down)] if FORCE in channels else None
    if force is None or force.shape[1:] != (len(sites),) or not (force.std(axis=0) > 0).all():
        force = np.einsum("tfi,ti->tf", feet, down)
    return np.asarray(trunk[np.arange(len(trunk)), force.argmax(axis=1), :2])


def _feet(position: np.ndarray, joint_names: tuple[str, ...], robot: Robot) -> np.ndarray | None:
    """Positions of the feet in the trunk's axes, (T, F, 3), m; None without a model that has all of the names.
    position: (T, J), rad."""
    model, spec = robot_model(robot), robot.spec
    if model is None:
        return None
    import mujoco

    joints = {model.joint(number).name: int(model.jnt_qposadr[number]) for number in range(model.njnt)}
    bodies = {model.body(number).name: number for number in range(model.nbody)}
    sites = {model.site(number).name: number for number in range(model.nsite)}
    if not ({*joint_names} <= joints.keys() and spec.trunk_body in bodies and {*spec.foot_sites} <= sites.keys()):
        return None
    places, feet = [joints[name] for name in joint_names], [sites[name] for name in spec.foot_sites]
    data, trunk = mujoco.MjData(model), bodies[spec.trunk_body]
    found = np.empty((len(position), len(feet), 3))
    for sample, angles in enumerate(position):
        data.qpos[places] = angles
        mujoco.mj_kinematics(model, data)
        found[sample] = (data.site_xpos[feet] - data.xpos[trunk]) @ data.xmat[trunk].reshape(3, 3)
    return found
