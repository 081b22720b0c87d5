"""The Go1 in MuJoCo, composed with `dm_control.mjcf` from primitive shapes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dm_control import mjcf

from hts_go1 import constants as c
from hts_go1.inertia import Rigid, joined


def rotor(axis: str, position: Sequence[float]) -> Rigid:
    """A motor's rotor lying in its parent link; axis x or y is its spin axis."""
    across = c.ROTOR_INERTIA_ACROSS
    inertia = np.diag([across] * 3)
    inertia["xyz".index(axis), "xyz".index(axis)] = c.ROTOR_INERTIA_SPIN
    return Rigid(c.ROTOR_MASS, np.array(position, float), inertia)


def links(leg: str) -> dict[str, Rigid]:
    """Hip, thigh and calf of one leg, each with the rotor that it carries; the calf with its foot."""
    side, end = c.SIDE[leg], c.END[leg]
    to_right = (1.0, side, 1.0)
    hip = Rigid.from_values(*c.HIP).mirrored((end, side, 1.0))
    thigh = Rigid.from_values(*c.THIGH).mirrored(to_right)
    calf = Rigid.from_values(*c.CALF).mirrored(to_right)
    foot = Rigid.from_values(*c.FOOT).shifted((0, 0, -c.LINK_LENGTH))
    return {
        "hip": joined([hip, rotor("y", (0, side * c.THIGH_ROTOR_FROM_HIP_Y, 0))]),
        "thigh": joined([thigh, rotor("y", (0, side * c.CALF_ROTOR_FROM_THIGH_Y, 0))]),
        "calf": joined([calf, foot]),
    }


def trunk() -> Rigid:
    """The trunk with the four hip rotors."""
    x, y = c.HIP_ROTOR_FROM_TRUNK
    rotors = [rotor("x", (c.END[leg] * x, c.SIDE[leg] * y, 0)) for leg in c.LEGS]
    return joined([Rigid.from_values(*c.TRUNK), *rotors])


def _add_inertial(body: mjcf.Element, rigid: Rigid) -> None:
    m = rigid.inertia
    full = [m[0, 0], m[1, 1], m[2, 2], m[0, 1], m[0, 2], m[1, 2]]
    body.add("inertial", mass=rigid.mass, pos=rigid.com, fullinertia=full)


def build() -> mjcf.RootElement:
    """Robot, floor, position actuators and sensors. Sensors:

    imu_gyro rad/s, imu_velocity m/s (trunk frame), torque_<joint> N m (motor current's torque at the joint),
    touch_<leg> N (normal force), foot_velocity_<leg> m/s (world frame), foot_position_<leg> m (world frame),
    trunk_touch N.
    """
    root = mjcf.RootElement(model="go1")
    root.compiler.angle = "radian"
    root.compiler.autolimits = True
    root.option.timestep = c.PHYSICS_DT
    root.option.integrator = "implicitfast"
    root.option.cone = "pyramidal"
    root.option.iterations = 10
    root.option.ls_iterations = 20
    root.visual.map.znear = 0.02
    getattr(root.visual, "global").offwidth = 1280
    getattr(root.visual, "global").offheight = 720
    root.asset.add(
        "texture",
        name="grid",
        type="2d",
        builtin="checker",
        width=300,
        height=300,
        rgb1=[0.82, 0.84, 0.86],
        rgb2=[0.72, 0.75, 0.78],
    )
    root.asset.add("material", name="grid", texture="grid", texrepeat=[2, 2], texuniform=True)
    root.worldbody.add("light", pos=[0, 0, 4], dir=[0, 0, -1], directional=True)
    # The floor's friction wins over the feet's (priority 1), so one number per env instance randomises grip.
    root.worldbody.add(
        "geom",
        name="floor",
        type="plane",
        size=[0, 0, 0.05],
        material="grid",
        friction=[0.7, 0.02, 0.01],
        priority=1,
        contype=1,
        conaffinity=0,
        condim=3,
    )
    body = root.worldbody.add("body", name="trunk", pos=[0, 0, c.BASE_HEIGHT])
    body.add("freejoint", name="root")
    body.add("camera", name="track", mode="trackcom", pos=[0.2, -1.6, 0.5], xyaxes=[1, 0.12, 0, 0, 0.25, 1])
    _add_inertial(body, trunk())
    body.add("site", name="imu", pos=[0, 0, 0], size=[0.01])
    shell = {"contype": 0, "conaffinity": 1, "condim": 1, "rgba": [0.25, 0.27, 0.3, 1]}
    body.add("geom", name="trunk", type="box", size=np.array(c.TRUNK_BOX) / 2, **shell)
    body.add("site", name="trunk_shell", type="box", size=np.array(c.TRUNK_BOX) / 2 + 0.01, rgba=[0, 0, 0, 0])
    for leg in c.LEGS:
        _add_leg(root, body, leg)
    _add_sensors(root)
    return root


def _add_leg(root: mjcf.RootElement, trunk_body: mjcf.Element, leg: str) -> None:
    side, end = c.SIDE[leg], c.END[leg]
    x, y, z = c.HIP_FROM_TRUNK
    visual = {"contype": 0, "conaffinity": 0, "rgba": [0.55, 0.57, 0.6, 1]}
    rigid = links(leg)
    hip = trunk_body.add("body", name=f"{leg}_hip", pos=[end * x, side * y, z])
    thigh = hip.add("body", name=f"{leg}_thigh", pos=[0, side * c.THIGH_FROM_HIP_Y, 0])
    calf = thigh.add("body", name=f"{leg}_calf", pos=[0, 0, -c.LINK_LENGTH])
    for part, body, axis in (("hip", hip, [1, 0, 0]), ("thigh", thigh, [0, 1, 0]), ("calf", calf, [0, 1, 0])):
        _add_inertial(body, rigid[part])
        joint = body.add(
            "joint",
            name=f"{leg}_{part}_joint",
            axis=axis,
            range=c.POSITION_LIMIT[part],
            armature=c.ARMATURE[part],
            damping=c.JOINT_DAMPING,
            frictionloss=c.JOINT_FRICTION[part],
        )
        limit = c.TORQUE_LIMIT[part]
        root.actuator.add(
            "position", name=joint.name, joint=joint, kp=c.KP, kv=c.KD, forcerange=[-limit, limit], ctrllimited=False
        )
    hip.add("geom", type="cylinder", size=[0.045, 0.02], pos=[0, side * 0.06, 0], euler=[np.pi / 2, 0, 0], **visual)
    thigh.add("geom", type="capsule", fromto=[0, 0, 0, 0, 0, -c.LINK_LENGTH], size=[0.02], **visual)
    # The knee can touch the floor; the shank above the foot is drawn only.
    calf.add(
        "geom",
        name=f"{leg}_knee",
        type="sphere",
        size=[0.025],
        contype=0,
        conaffinity=1,
        condim=1,
        rgba=[0.25, 0.27, 0.3, 1],
    )
    calf.add("geom", type="capsule", fromto=[0, 0, 0, 0, 0, -c.LINK_LENGTH], size=[0.012], **visual)
    calf.add(
        "geom",
        name=f"{leg}_foot",
        type="sphere",
        size=[c.FOOT_RADIUS],
        pos=[0, 0, -c.LINK_LENGTH],
        contype=0,
        conaffinity=1,
        condim=3,
        rgba=[0.1, 0.1, 0.1, 1],
    )
    calf.add("site", name=f"{leg}_foot", pos=[0, 0, -c.LINK_LENGTH], size=[c.FOOT_RADIUS + 0.01], rgba=[0, 0, 0, 0])


def _add_sensors(root: mjcf.RootElement) -> None:
    sensor = root.sensor
    sensor.add("gyro", name="imu_gyro", site="imu")
    sensor.add("velocimeter", name="imu_velocity", site="imu")
    for name in c.JOINT_NAMES:
        sensor.add("actuatorfrc", name=f"torque_{name}", actuator=name)
    for leg in c.LEGS:
        sensor.add("touch", name=f"touch_{leg}", site=f"{leg}_foot")
    for leg in c.LEGS:
        sensor.add("framelinvel", name=f"foot_velocity_{leg}", objtype="site", objname=f"{leg}_foot")
    for leg in c.LEGS:
        sensor.add("framepos", name=f"foot_position_{leg}", objtype="site", objname=f"{leg}_foot")
    sensor.add("touch", name="trunk_touch", site="trunk_shell")
