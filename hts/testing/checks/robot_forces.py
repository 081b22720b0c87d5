"""Models of robots that follow velocities: forces that neither their spec nor their sensors know of.

MJCF files have them for their viewers, or from a class of defaults: such a simulation runs, and is of another machine.
"""

from __future__ import annotations

import numpy as np

from hts.plugins import Entry, Registry
from hts.testing.checks.ensure import ensure
from hts.testing.checks.robot_models import RELATIVE, Row, comparable_model, compare, meets

ITERATIONS = 5
SHARE = 0.1
"""Of kd, or of the torque that a drive has for each rad/s of its speed: what bearings brake lies far below."""


def trunk_moves_freely(entry: Entry, registry: Registry) -> None:
    """In a model for the velocity task nothing holds the trunk in the air: its free joint has no damping, armature,
    friction or stiffness, and no body is carried by gravcomp."""
    from hts.sim.conventions import without_free_trunk

    robot, model = comparable_model(entry)
    if model is None:
        return
    carried = [model.body(index).name for index in np.flatnonzero(model.body_gravcomp)]
    ensure(not carried, f"gravcomp of bodies of its model ({', '.join(carried)}) takes their weight away. Leave it out")
    if without_free_trunk(model, robot.spec):
        return  # said by `model_is_in_order`
    numbers = {
        "damping": model.dof_damping[:6].max(),
        "armature": model.dof_armature[:6].max(),
        "frictionloss": model.dof_frictionloss[:6].max(),
        "stiffness": model.jnt_stiffness[0],
    }
    found = ", ".join(f"{name} {value:g}" for name, value in numbers.items() if value > 0)
    ensure(
        not found,
        f"the free joint '{model.joint(0).name}' of its model has {found}, as if the trunk moved through oil, expected "
        'none. <joint type="free"/> takes what a <default> says of joints: write <freejoint/> instead',
    )


def servos_alone_move_joints(entry: Entry, registry: Registry) -> None:
    """In a model for the velocity task joints have the armature of their rotors, and hardly any damping of their own:
    damping acts beside kd, no torque sensor shows it, and a twin has another."""
    robot, model = comparable_model(entry)
    if model is None:
        return
    spec, dampings, rotors = robot.spec, list[Row](), list[Row]()
    numbers = zip(spec.joint_names, spec.kp, spec.kd, spec.torque_limit, spec.velocity_limit, strict=True)
    for joint, kp, kd, torque, speed in numbers:
        dof = int(model.joint(joint).dofadr[0])
        most = SHARE * max(kd, torque / speed)
        if kp > 0 and model.dof_damping[dof] > most:
            dampings.append((joint, f"{model.dof_damping[dof]:g}", f"at most {most:.2g}"))
        if model.dof_armature[dof] == 0:
            rotors.append((joint, "0", "rotor inertia times the square of the gear ratio"))
    compare(
        "damping of joints in its model, N*m*s/rad",
        dampings,
        "It brakes beside kd, in training alone: damping of the drive belongs into kv and SPEC.kd, and is 0 here",
    )
    compare("armature of joints in its model, kg*m^2", rotors, "Gear losses of a twin are reckoned from it")


def torques_have_one_limit(entry: Entry, registry: Registry) -> None:
    """In a model for the velocity task no actuatorfrcrange of a joint is narrower than torque_limit: `actuatorfrc`
    sensors show the torque before it is cut."""
    robot, model = comparable_model(entry)
    if model is None:
        return
    rows = []
    for joint, limit in zip(robot.spec.joint_names, robot.spec.torque_limit, strict=True):
        index = model.joint(joint).id
        low, high = model.jnt_actfrcrange[index]
        least = limit * (1 - RELATIVE)
        if model.jnt_actfrclimited[index] and (low > -least or high < least):
            rows.append((joint, f"{low:g} to {high:g}", f"none, or {-limit:g} to {limit:g}"))
    compare("actuatorfrcrange of joints in its model, N*m", rows, "Correct it or SPEC.torque_limit")


def only_the_floor_is_met(entry: Entry, registry: Registry) -> None:
    """In a model for the velocity task a robot meets the geom `floor` and nothing else that stands in the world, and no
    <pair> has a friction of its own there."""
    import mujoco

    from hts.sim.conventions import FLOOR, floor_on_a_body, without_free_trunk

    robot, model = comparable_model(entry)
    if model is None or without_free_trunk(model, robot.spec):  # which `model_is_in_order` says
        return
    on_a_body = floor_on_a_body(model)
    ensure(not on_a_body, on_a_body)
    floor, fixed = model.geom(FLOOR).id, model.body_weldid[model.geom_bodyid] == 0
    own = np.flatnonzero(~fixed)
    others = [i for i in np.flatnonzero(fixed) if i != floor and any(meets(model, int(i), int(one)) for one in own)]
    if others:
        kind = mujoco.mjtGeom(int(model.geom_type[others[0]])).name.removeprefix("mjGEOM_").lower()
        x, y, z = model.geom_pos[others[0]] + model.body_pos[model.geom_bodyid[others[0]]]
        ensure(
            False,
            f"{len(others)} more geom(s) than '{FLOOR}' stand in the world of its model and can be touched (first: "
            f"{kind} '{model.geom(others[0]).name}' at {x:.3g} {y:.3g} {z:.3g}): steps and walls of a scene. Training "
            "is on the floor: take them out",
        )
    pairs = zip(model.pair_geom1, model.pair_geom2, model.pair_dim, strict=True)
    rough = [(a, b) for a, b, condim in pairs if condim > 1 and floor in (a, b)]
    named = ", ".join(f"'{model.geom(int(b if a == floor else a)).name}'" for a, b in rough)
    ensure(
        not rough,
        f"<pair> of its model gives {named} a friction on '{FLOOR}' of its own, which neither training nor a twin can "
        "vary. Take the pair out, and give the geoms contype and conaffinity",
    )


def contacts_are_solved(entry: Entry, registry: Registry) -> None:
    """In a model for the velocity task the solver has 5 iterations at least: with one, as models for MJX have it, the
    floor pushes with more than twice the weight, and torques and foot forces are as wrong."""
    _, model = comparable_model(entry)
    found = ITERATIONS if model is None else int(model.opt.iterations)
    ensure(
        found >= ITERATIONS,
        f'<option iterations="{found}"> of its model stops the solver before contacts carry the weight, expected at '
        f"least {ITERATIONS}. Leave it out, or write 10",
    )


CHECKS = (
    trunk_moves_freely,
    servos_alone_move_joints,
    torques_have_one_limit,
    only_the_floor_is_met,
    contacts_are_solved,
)
