"""The body of `tiny` in MuJoCo, composed with `dm_control.mjcf`. To take an MJCF file of yours: `mjcf.from_path`.

What training and twin look for in any robot's model, by name:
  geom `floor`, of priority 1, so that one number per world decides the grip
  body SPEC.trunk_body with a free joint; the joints of SPEC, one position actuator each
  a site per foot (SPEC.foot_sites) that holds all of the foot's contacts
  sensors torque_<joint> N·m, touch_<foot> N, foot_velocity_<foot> m/s (each kind in the order of SPEC, one after the
  other; <foot> is the site's name without `_foot`), and trunk_touch N, which ends an episode
"""

from __future__ import annotations

from dm_control import mjcf

RADIUS, TRACK, TRUNK_MASS, WHEEL_MASS = 0.08, 0.30, 3.0, 0.3  # m, m between the wheels, kg, kg
CASTER_RADIUS, CASTER_X = 0.03, 0.2  # m, m from the axle
WHEELS = {"left": TRACK / 2, "right": -TRACK / 2}  # joint -> y of the wheel, m
KP, KD, TORQUE_LIMIT, PHYSICS_DT = 0.1, 1.0, 1.0, 0.005  # as in robot.SPEC


def build() -> mjcf.RootElement:
    """Robot, floor, actuators and sensors."""
    root = mjcf.RootElement(model="tiny")
    root.compiler.angle = "radian"
    root.option.timestep = PHYSICS_DT
    root.option.integrator = "implicitfast"
    world = root.worldbody
    world.add("light", pos=[0, 0, 4], dir=[0, 0, -1], directional=True)
    world.add("geom", name="floor", type="plane", size=[0, 0, 0.05], friction=[0.7, 0.02, 0.01], priority=1)
    trunk = world.add("body", name="trunk", pos=[0, 0, RADIUS])
    trunk.add("freejoint", name="root")
    trunk.add("camera", name="track", mode="trackcom", pos=[0.2, -1.6, 0.5], xyaxes=[1, 0.12, 0, 0, 0.25, 1])
    shell = [0.15, 0.1, 0.03]
    trunk.add("geom", name="trunk", type="box", size=shell, pos=[0, 0, 0.02], mass=TRUNK_MASS, condim=1)
    trunk.add("site", name="trunk_shell", type="box", size=[side + 0.01 for side in shell], pos=[0, 0, 0.02])
    _add_casters(root, trunk)
    for name, y in WHEELS.items():
        wheel = trunk.add("body", name=f"{name}_wheel", pos=[0, y, 0])
        joint = wheel.add("joint", name=name, axis=[0, 1, 0], armature=0.01, damping=0.005, frictionloss=0.01)
        wheel.add("geom", name=f"{name}_wheel", type="sphere", size=[RADIUS], mass=WHEEL_MASS)
        wheel.add("site", name=f"{name}_foot", size=[RADIUS + 0.01])
        limits = [-TORQUE_LIMIT, TORQUE_LIMIT]
        root.actuator.add("position", name=name, joint=joint, kp=KP, kv=KD, forcerange=limits, ctrllimited=False)
    for name in WHEELS:
        root.sensor.add("actuatorfrc", name=f"torque_{name}", actuator=name)
    for name in WHEELS:
        root.sensor.add("touch", name=f"touch_{name}", site=f"{name}_foot")
    for name in WHEELS:
        root.sensor.add("framelinvel", name=f"foot_velocity_{name}", objtype="site", objname=f"{name}_foot")
    root.sensor.add("touch", name="trunk_touch", site="trunk_shell")
    return root


def _add_casters(root, trunk) -> None:
    """Two balls that slide without friction, so that the cart stands.
    On a body of their own: they are not the trunk."""
    body = trunk.add("body", name="casters", pos=[0, 0, CASTER_RADIUS - RADIUS + 0.002])
    for name, x in (("front", CASTER_X), ("back", -CASTER_X)):
        free = {"contype": 0, "conaffinity": 0}
        body.add("geom", name=name, type="sphere", size=[CASTER_RADIUS], pos=[x, 0, 0], mass=0.05, **free)
        root.contact.add("pair", name=f"{name}_on_floor", geom1="floor", geom2=name, condim=1)
