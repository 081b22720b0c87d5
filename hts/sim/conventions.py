"""What the velocity task takes for granted of a robot's model: names that are there, and everything in one order."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import mujoco

from hts.contracts import RobotSpec
from hts.errors import ConfigError
from hts.sim.engine import sensor_slices

FLOOR = "floor"  # name of the ground geom in a robot's MJCF; its friction must win (priority) over the feet's
TRUNK_TOUCH = "trunk_touch"
WHERE = "docs/authors/robot.md, 'The velocity task', lists what a model needs"
NAMELESS = "(a joint without a name)"
ON_JOINTS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
FREE = int(mujoco.mjtJoint.mjJNT_FREE)


def check_conventions(model: mujoco.MjModel, spec: RobotSpec) -> None:
    """Raises ConfigError, in one line, for a model that lacks something or has it in another order than the spec: the
    env reads and writes joints, actuators and sensors by their place."""
    fault = missing(model, spec) or out_of_order(model, spec)
    if fault:
        raise ConfigError(f"Robot '{spec.name}': {fault}")


def check_joints(model: mujoco.MjModel, spec: RobotSpec) -> None:
    """The same for who reads joints and drives actuators by place and looks for no sensors, such as `hts play`."""
    fault = missing(model, spec, velocity_task=False) or joints_out_of_order(model, spec)
    if fault:
        raise ConfigError(f"Robot '{spec.name}': {fault}")


def sensor_groups(spec: RobotSpec) -> dict[str, list[str]]:
    """Kind -> the names of its sensors, which lie side by side in this order."""
    legs = [site.removesuffix("_foot") for site in spec.foot_sites]
    return {
        "torque": [f"torque_{name}" for name in spec.joint_names],
        "touch": [f"touch_{leg}" for leg in legs],
        "foot_velocity": [f"foot_velocity_{leg}" for leg in legs],
    }


def missing(model: mujoco.MjModel, spec: RobotSpec, velocity_task: bool = True) -> str:
    """All that the model lacks, in words; empty for nothing. velocity_task: also what only that looks for."""
    wanted = {"body": [spec.trunk_body], "joint": list(spec.joint_names), "site": list(spec.foot_sites)}
    if velocity_task:
        sensors = [name for group in sensor_groups(spec).values() for name in group]
        wanted |= {"geom": [FLOOR], "sensor": [*sensors, TRUNK_TOUCH]}
    kinds = mujoco.mjtObj
    numbers = {
        "body": kinds.mjOBJ_BODY,
        "joint": kinds.mjOBJ_JOINT,
        "site": kinds.mjOBJ_SITE,
        "geom": kinds.mjOBJ_GEOM,
        "sensor": kinds.mjOBJ_SENSOR,
    }
    lacking = {
        kind: [name for name in names if mujoco.mj_name2id(model, numbers[kind], name) < 0]
        for kind, names in wanted.items()
    }
    parts = [f"no {kind} {quoted(names)}" for kind, names in lacking.items() if names]
    if velocity_task:
        driven = set(driven_joints(model))
        idle = [name for name in spec.joint_names if name not in driven and name not in lacking["joint"]]
        parts += [f"no actuator of joint {quoted(idle)}"] * bool(idle)
    if not parts:
        return ""
    return f"its model has {', '.join(parts)}. Add what is missing to the MJCF, under these names ({WHERE})."


def without_free_trunk(model: mujoco.MjModel, spec: RobotSpec) -> str:
    """What the first joint is where it is not the free joint of the trunk, in words; empty where it is."""
    if model.njnt > 0 and model.jnt_type[0] == FREE and model.jnt_bodyid[0] == model.body(spec.trunk_body).id:
        return ""
    return (
        f"the first joint of its model is {_first_joint(model)}, expected a free joint of body '{spec.trunk_body}'. "
        f"Give that body a <freejoint/>, before all other joints ({WHERE})."
    )


def floor_on_a_body(model: mujoco.MjModel) -> str:
    """In words, if the floor lies on a body of its own; else empty. A twin looks for it in the world, and would vary no
    grip."""
    floor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, FLOOR)
    if floor < 0 or model.geom_bodyid[floor] == 0:
        return ""
    body = model.body(int(model.geom_bodyid[floor])).name
    return (
        f"geom '{FLOOR}' of its model lies on body '{body}', expected directly in the <worldbody>. Take it out of that "
        f"body ({WHERE})."
    )


def joints_out_of_order(model: mujoco.MjModel, spec: RobotSpec) -> str:
    """The first joint or actuator whose place in the model is not the spec's, in words; empty for none. No body and no
    joint may be missing."""
    if fixed := without_free_trunk(model, spec):
        return fixed
    tree = [model.joint(index).name or NAMELESS for index in range(1, model.njnt)]
    if tree != list(spec.joint_names):
        advice = "Write SPEC.joint_names, and every tuple that follows it, in the order of the tree"
        if sorted(tree) != sorted(spec.joint_names):
            advice = "Take joints that are not in SPEC.joint_names out of the model, or put them into the spec"
        return _places("joint", "in the tree of its model", tree, spec.joint_names, advice)
    driven = driven_joints(model)
    if driven != list(spec.joint_names):
        advice = "Write the actuators in the order of SPEC.joint_names, one a joint"
        return _places("the actuator of joint", "among the actuators of its model", driven, spec.joint_names, advice)
    return ""


def out_of_order(model: mujoco.MjModel, spec: RobotSpec) -> str:
    """The first thing whose place in the model is not the spec's, in words; empty for none. Nothing may be missing."""
    if joints := joints_out_of_order(model, spec):
        return joints
    slices = sensor_slices(model)
    for kind, names in sensor_groups(spec).items():
        found = sorted(names, key=lambda name: slices[name].start)
        if found != names:
            advice = f"Write the sensors {kind}_… in the order of the spec"
            return _places("sensor", f"among the sensors {kind}_… of its model", found, names, advice)
        between = _between(slices, names)
        if between:
            return (
                f"sensor '{between}' of its model stands between the sensors {kind}_…, which are expected side by side "
                f"({', '.join(names)}). Move it before or behind them ({WHERE})."
            )
    return mismeasured(model, spec)


def mismeasured(model: mujoco.MjModel, spec: RobotSpec) -> str:
    """All sensors that measure something else than they are named for, in words; empty for none. No sensor may be
    missing. Sensors of the kinds `user` and `plugin` are passed over: what they measure, only their code knows."""
    wanted = {f"torque_{name}": f"actuator force of joint '{name}'" for name in spec.joint_names}
    for site in spec.foot_sites:
        leg = site.removesuffix("_foot")
        wanted[f"touch_{leg}"] = f"touch at site '{site}'"
        wanted[f"foot_velocity_{leg}"] = f"velocity of body '{model.body(int(model.site(site).bodyid[0])).name}'"
    found = {name: _measured(model, model.sensor(name).id) for name in wanted}
    wrong = [
        f"'{name}' measures {found[name]}, expected {here}"
        for name, here in wanted.items()
        if found[name] not in (here, "")
    ]
    if not wrong:
        return ""
    turned = any(_axes(model, model.sensor(name).id) for name in wanted if name.startswith("foot_velocity_"))
    world = " Velocities of feet are in the world's axes: <framelinvel> without reftype." if turned else ""
    return f"sensors of its model: {'; '.join(wrong)}. Correct what they refer to, or their names ({WHERE}).{world}"


def _measured(model: mujoco.MjModel, sensor: int) -> str:
    """What a sensor measures, and of what; empty if only its code knows."""
    kinds, kind, of = mujoco.mjtSensor, int(model.sensor_type[sensor]), int(model.sensor_objid[sensor])
    if kind in (int(kinds.mjSENS_USER), int(kinds.mjSENS_PLUGIN)):
        return ""
    if kind == int(kinds.mjSENS_ACTUATORFRC):
        return f"actuator force of joint '{driven_joints(model)[of]}'"
    if kind == int(kinds.mjSENS_JOINTACTFRC):
        return f"actuator force of joint '{model.joint(of).name or NAMELESS}'"
    if kind == int(kinds.mjSENS_TOUCH):
        return f"touch at site '{model.site(of).name}'"
    if kind in (int(kinds.mjSENS_FRAMELINVEL), int(kinds.mjSENS_VELOCIMETER)):
        body = f"of body '{model.body(_body_of(model, int(model.sensor_objtype[sensor]), of)).name}'"
        return f"velocity{_axes(model, sensor)} {body}"
    return kinds(kind).name.removeprefix("mjSENS_").lower()


def _axes(model: mujoco.MjModel, sensor: int) -> str:
    """Of a sensor of velocity: in what axes, where they are not the world's."""
    if int(model.sensor_type[sensor]) == int(mujoco.mjtSensor.mjSENS_VELOCIMETER):
        return " in its own axes"
    if (frame := int(model.sensor_refid[sensor])) < 0:
        return ""
    name = model.body(_body_of(model, int(model.sensor_reftype[sensor]), frame)).name
    return f" against body '{name}'"


def _body_of(model: mujoco.MjModel, kind: int, index: int) -> int:
    """The body that an object of a kind (mjtObj) lies on."""
    on = {
        int(mujoco.mjtObj.mjOBJ_SITE): model.site_bodyid,
        int(mujoco.mjtObj.mjOBJ_GEOM): model.geom_bodyid,
        int(mujoco.mjtObj.mjOBJ_CAMERA): model.cam_bodyid,
    }
    return int(on[kind][index]) if kind in on else index  # else a body, by its inertia or its frame


def driven_joints(model: mujoco.MjModel) -> list[str]:
    """The joint that each actuator drives, in the order of the actuators; what drives none stands in brackets."""
    found = []
    for index in range(model.nu):
        if model.actuator_trntype[index] in ON_JOINTS:
            found.append(model.joint(int(model.actuator_trnid[index, 0])).name or NAMELESS)
        else:
            found.append(f"(actuator '{model.actuator(index).name}', on no joint)")
    return found


def actuator_of(model: mujoco.MjModel) -> dict[str, int]:
    """Joint -> the number of its (first) actuator."""
    numbers: dict[str, int] = {}
    for index, joint in enumerate(driven_joints(model)):
        numbers.setdefault(joint, index)
    return numbers


def quoted(names: Sequence[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def _first_joint(model: mujoco.MjModel) -> str:
    if model.njnt == 0:
        return "none at all"
    return f"'{model.joint(0).name}' of body '{model.body(int(model.jnt_bodyid[0])).name}'"


def _places(what: str, where: str, found: Sequence[str], wanted: Sequence[str], advice: str) -> str:
    """First that is out of place, and both orders."""
    pairs = enumerate(itertools.zip_longest(found, wanted, fillvalue=""))
    place, here, expected = next((place, *pair) for place, pair in pairs if pair[0] != pair[1])
    stands = f"{what} '{here}' is number {place + 1} {where}" if here else f"number {place + 1} {where} is none"
    after = f"'{expected}' is expected there" if expected else "none is expected there"
    return f"{stands}, {after}: found {', '.join(found)}; expected {', '.join(wanted)}. {advice} ({WHERE})."


def _between(slices: dict[str, slice], names: Sequence[str]) -> str:
    """A sensor that lies between those of a group in their order; empty for none."""
    inside = range(slices[names[0]].start, slices[names[-1]].stop) if names else range(0)
    return next((name for name, own in slices.items() if own.start in inside and name not in names), "")
