"""A dog of twelve joints from an MJCF text, as its author has it: for tests of what the kit compares."""

from __future__ import annotations

LEGS, PARTS = ("LF", "RF", "LH", "RH"), ("HAA", "HFE", "KFE")
JOINTS = tuple(f"{leg}_{part}" for leg in LEGS for part in PARTS)
ISAAC = tuple(f"{leg}_{part}" for part in PARTS for leg in LEGS)
RANGE = {"HAA": (-0.8, 0.8), "HFE": (-1.0, 2.5), "KFE": (-2.6, -0.5)}
POSE = {"HAA": 0.0, "HFE": 0.8, "KFE": -1.6}
ACTUATOR = '<position name="{0}" joint="{0}" kp="25" kv="0.5" forcerange="-40 40"/>'
FLOOR = '<geom name="floor" type="plane" size="0 0 0.05" priority="1"/>'


def leg(name: str, site: float) -> str:
    x, y = 0.2 if name[1] == "F" else -0.2, 0.1 if name[0] == "L" else -0.1
    haa, hfe, kfe = (
        f'<joint name="{name}_{part}" axis="{axis}" range="{RANGE[part][0]} {RANGE[part][1]}" armature="0.01"/>'
        for part, axis in zip(PARTS, ("1 0 0", "0 1 0", "0 1 0"), strict=True)
    )
    mass = '<inertial pos="0 0 {0}" mass="{1}" diaginertia="0.003 0.003 0.001"/>'
    return (
        f'<body name="{name}_hip" pos="{x} {y} 0">{haa}{mass.format(0, 0.6)}'
        f'<body name="{name}_thigh" pos="0 {0.8 * y} 0">{hfe}{mass.format(-0.05, 0.8)}'
        f'<body name="{name}_shank" pos="0 0 -0.2">{kfe}{mass.format(-0.1, 0.2)}'
        f'<geom name="{name}_foot" type="sphere" size="0.02" pos="0 0 -0.2" mass="0.05"/>'
        f'<site name="{name}_foot" pos="0 0 -0.2" size="{site}"/></body></body></body>'
    )


def text(
    actuators: tuple[str, ...] = JOINTS,
    sensors: tuple[str, ...] = JOINTS,
    touch: tuple[str, ...] = LEGS,
    site: float = 0.03,
) -> str:
    """MJCF; actuators, sensors, touch: in this order; site: radius of the feet's, m."""
    return (
        '<mujoco model="dog"><compiler angle="radian" autolimits="true"/><option integrator="implicitfast"/>'
        f'<worldbody>{FLOOR}<body name="trunk" pos="0 0 0.3"><freejoint name="root"/>'
        '<geom name="trunk" type="box" size="0.2 0.08 0.05" mass="8" contype="0" conaffinity="1"/>'
        f'<site name="trunk_shell" type="box" size="0.21 0.09 0.06"/>{"".join(leg(one, site) for one in LEGS)}</body>'
        f"</worldbody><actuator>{''.join(ACTUATOR.format(one) for one in actuators)}</actuator><sensor>"
        + "".join(f'<actuatorfrc name="torque_{one}" actuator="{one}"/>' for one in sensors)
        + "".join(f'<touch name="touch_{one}" site="{one}_foot"/>' for one in touch)
        + "".join(f'<framelinvel name="foot_velocity_{one}" objtype="site" objname="{one}_foot"/>' for one in LEGS)
        + '<touch name="trunk_touch" site="trunk_shell"/></sensor></mujoco>'
    )


def dog(model: str, joints: tuple[str, ...] = JOINTS, legs: tuple[str, ...] = LEGS):
    """A robot that follows velocities, of this MJCF and joint order."""
    from dm_control import mjcf

    from hts.channels import standard_channels
    from hts.contracts import RobotSpec
    from hts.envs.velocity_robot import VelocityRobot

    parts = [name.split("_")[1] for name in joints]

    class Dog(VelocityRobot):
        spec = RobotSpec(
            name="dog",
            joint_names=joints,
            default_pose=tuple(POSE[part] for part in parts),
            kp=(25.0,) * 12,
            kd=(0.5,) * 12,
            action_scale=(0.25,) * 12,
            torque_limit=(40.0,) * 12,
            velocity_limit=(20.0,) * 12,
            position_limit=tuple(RANGE[part] for part in parts),
            control_rate_hz=50.0,
            physics_dt=0.005,
            substeps=4,
            base_height=0.3,
            foot_sites=tuple(f"{one}_foot" for one in legs),
        )

        def mjcf(self):
            return mjcf.from_xml_string(model)

        def channels(self):
            return standard_channels(12, 4)

        def pretrained_policy(self):
            return None

    return Dog()
