"""Models of robots that follow velocities: does the simulation have the numbers that the spec says?"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from hts.contracts import Robot
from hts.contracts.spec_faults import ENDLESS, fault_of_height, fault_of_spec
from hts.envs.velocity_robot import VelocityRobot
from hts.plugins import Entry, Registry
from hts.testing.checks.ensure import NotTried, ensure

if TYPE_CHECKING:
    import mujoco

RELATIVE = 1e-3  # of gains and torques: a rounded number is no other one
ANGLE = 2e-3  # rad, of limits: degrees with one decimal are
LIGHT, HEAVY = 0.003, 30.0  # weight times standing height over the sum of all torques: of robots that walk 0.05 to 2
DEPTH = 1e-3  # m that a foot is put into the floor
HEIGHT = 0.1  # of the standing height: a robot whose servos give way under its weight stands a little lower

Row = tuple[str, str, str]
"""Joint, found, expected."""


def lacks_its_model(robot: Robot) -> bool:
    """Whether a robot is to be trained in the velocity task, and brings no model to make that env of."""
    own_env = type(robot).make_env is not VelocityRobot.make_env
    return isinstance(robot, VelocityRobot) and not own_env and robot.mjcf() is None


def usable_model(entry: Entry) -> mujoco.MjModel | None:
    """The model of a robot that follows velocities in our env; None for any other, such as one with an env of its own.
    Raises NotTried for a model that this env refuses, which `model_matches` or `model_is_in_order` says."""
    from hts.sim.conventions import out_of_order

    robot, model = comparable_model(entry)
    if model is not None and out_of_order(model, robot.spec):
        raise NotTried("its model is in another order than its spec")
    return model


def comparable_model(entry: Entry) -> tuple[Robot, mujoco.MjModel | None]:
    """The robot, and the same model in whatever order; only to be read, since all checks get this one. Raises NotTried
    where its env needs one and there is none, it cannot be made, or something is missing, as `model_matches` says."""
    robot, model, lacking = _compiled(entry)
    if lacking:
        raise NotTried(lacking)
    return robot, model


@lru_cache(maxsize=1)
def _compiled(entry: Entry) -> tuple[Robot, mujoco.MjModel | None, str]:
    """Robot, model and why none can be compared, made once for all checks of one robot: MJCF takes its time."""
    from hts.sim.conventions import missing
    from hts.sim.models import compile_model

    robot = entry.factory({})
    if not isinstance(robot, VelocityRobot):
        return robot, None, ""
    if fault_of_spec(robot.spec) not in ("", fault_of_height(robot.spec)):
        return robot, None, "its spec is no spec of its joints"  # said by `spec_is_consistent` or `times_fit`
    try:
        root = robot.mjcf()
        lacking = root is None and lacks_its_model(robot)
        model = None if root is None else compile_model(robot)
    except Exception:  # noqa: BLE001 - whatever a stranger's model does has been said by `model_matches`
        return robot, None, "its model cannot be made"
    if lacking:
        return robot, None, "it has no model"
    if model is not None and missing(model, robot.spec):
        return robot, None, "its model lacks something"
    return robot, model, ""


def model_is_in_order(entry: Entry, registry: Registry) -> None:
    """In a model for the velocity task joints of the tree, actuators and sensors come in the order of the spec, and
    sensors measure what they are named for."""
    from hts.sim.conventions import out_of_order

    robot, model = comparable_model(entry)
    if model is not None:
        fault = out_of_order(model, robot.spec)
        ensure(not fault, fault)


def actuators_are_servos(entry: Entry, registry: Registry) -> None:
    """In a model for the velocity task every actuator is a position servo without gear: its input is a joint target."""
    robot, model = comparable_model(entry)
    if model is None:
        return
    actuators = _actuators(model, robot)
    rows = [(joint, _kind(model, index), "position") for joint, index in actuators]
    compare("actuators of its model", rows, 'Write <position kp="…" kv="…"/>')
    gears = [(joint, f"{model.actuator_gear[index, 0]:g}", "1") for joint, index in actuators]
    compare("gear of its model's actuators", gears, "Leave `gear` out: gains and torques are at the joint")


def gains_match(entry: Entry, registry: Registry) -> None:
    """In a model for the velocity task the actuators have kp and kd of the spec: the simulation takes them from the
    model, everything else from the spec."""
    robot, model = comparable_model(entry)
    if model is None:
        return
    spec, rows, others = robot.spec, list[Row](), list[str]()
    for (joint, index), kp, kd in zip(_actuators(model, robot), spec.kp, spec.kd, strict=True):
        if _kind(model, index) != "position":
            others.append(joint)  # said by `actuators_are_servos`
            continue
        found = model.actuator_gainprm[index, 0], 0.0 - model.actuator_biasprm[index, 2]
        for name, value, wanted in zip(("kp", "kd"), found, (kp, kd), strict=True):
            if not math.isclose(value, wanted, rel_tol=RELATIVE, abs_tol=1e-6):
                rows.append((joint, f"{name} {value:.6g}", f"{name} {wanted:.6g}"))
    compare("gains in its model", rows, "kd is kv of the actuator, not damping of the joint")
    if others:
        raise NotTried(f"actuators of {', '.join(others)} are no position servos")


def torque_limits_match(entry: Entry, registry: Registry) -> None:
    """In a model for the velocity task each actuator has the spec's torque_limit, both ways, as its forcerange."""
    robot, model = comparable_model(entry)
    if model is None:
        return
    rows = []
    for (joint, index), limit in zip(_actuators(model, robot), robot.spec.torque_limit, strict=True):
        low, high = model.actuator_forcerange[index]
        limited = bool(model.actuator_forcelimited[index])
        if not (limited and np.allclose((low, high), (-limit, limit), rtol=RELATIVE, atol=1e-6)):
            rows.append((joint, f"{low:.6g} to {high:.6g}" if limited else "none", f"{-limit:.6g} to {limit:.6g}"))
    compare("forcerange in its model, N*m", rows, "Correct the actuators or SPEC.torque_limit")


def targets_are_not_clipped(entry: Entry, registry: Registry) -> None:
    """In a model for the velocity task no actuator clips joint targets: it has no ctrlrange, or one that is wider than
    position_limit by torque_limit / kp, so far that the torque is at its limit anyway."""
    import mujoco

    robot, model = comparable_model(entry)
    if model is None or model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL):
        return
    spec, rows = robot.spec, []
    numbers = zip(_actuators(model, robot), spec.kp, spec.torque_limit, spec.position_limit, strict=True)
    for (joint, index), kp, limit, (low, high) in numbers:
        if not model.actuator_ctrllimited[index] or kp <= 0:
            continue
        first, last = model.actuator_ctrlrange[index]
        reach = limit / kp  # rad: a target so far from the joint asks for all of its torque
        if first > low - reach + ANGLE or last < high + reach - ANGLE:
            wanted = f"none, or at least {low - reach:.6g} to {high + reach:.6g}"
            rows.append((joint, f"{first:.6g} to {last:.6g}", wanted))
    advice = 'It clips the targets of a policy, in training alone: write ctrllimited="false"'
    compare("ctrlrange of its model's actuators, rad", rows, advice)


def position_limits_match(entry: Entry, registry: Registry) -> None:
    """In a model for the velocity task each joint's range is the spec's position_limit; wheels may have none."""
    robot, model = comparable_model(entry)
    if model is None:
        return
    rows = []
    for joint, (low, high) in zip(robot.spec.joint_names, robot.spec.position_limit, strict=True):
        index = model.joint(joint).id
        limited, found = bool(model.jnt_limited[index]), model.jnt_range[index]
        if limited and np.allclose(found, (low, high), rtol=0, atol=ANGLE):
            continue
        if not limited and high - low > ENDLESS:
            continue
        rows.append((joint, f"{found[0]:.6g} to {found[1]:.6g}" if limited else "none", f"{low:.6g} to {high:.6g}"))
    compare("range of joints in its model, rad", rows, "Correct the model or SPEC.position_limit")


def weight_is_carried(entry: Entry, registry: Registry) -> None:
    """In a model for the velocity task gravity points down, and the robot weighs what its torques can carry."""
    import mujoco

    robot, model = comparable_model(entry)
    if model is None or fault_of_height(robot.spec):  # which `height_matches` says
        return
    off = bool(model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY))
    x, y, z = (0.0, 0.0, 0.0) if off else model.opt.gravity
    ensure(z < 0 and abs(x) + abs(y) < 1e-6 * abs(z), f"gravity of its model is {x:g} {y:g} {z:g}, expected 0 0 -9.81")
    mass, torque = float(model.body_mass.sum()), math.fsum(robot.spec.torque_limit)
    share = -z * mass * robot.spec.base_height / torque
    ensure(
        LIGHT <= share <= HEAVY,
        f"its model weighs {mass:.4g} kg and stands {robot.spec.base_height:g} m high, all its torque limits together "
        f"are {torque:.4g} N·m: nothing like it walks. Write masses in kg, torques in N·m",
    )


def floor_decides_the_grip(entry: Entry, registry: Registry) -> None:
    """In a model for the velocity task the geom `floor` has a higher priority than all of the robot: its friction is
    the one that is varied."""
    from hts.sim.conventions import FLOOR

    _, model = comparable_model(entry)
    if model is None:
        return
    own = int(model.geom(FLOOR).priority[0])
    others = [i for i in range(model.ngeom) if model.geom_bodyid[i] != 0 and model.geom_priority[i] >= own]
    touching = [i for i in others if meets(model, model.geom(FLOOR).id, i)]
    if touching:
        first = model.geom(touching[0])
        body = model.body(int(model.geom_bodyid[touching[0]])).name
        ensure(
            False,
            f"geom '{FLOOR}' of its model has priority {own}, geom '{first.name}' of body '{body}' has "
            f'{int(first.priority[0])}. Give the floor a higher one (priority="1" where the others have none)',
        )


def feet_are_felt(entry: Entry, registry: Registry) -> None:
    """In a model for the velocity task the site of each foot holds the points at which its body touches the floor in
    the default pose: a touch sensor sees no others."""
    robot, model = _placeable(entry)
    if model is None:
        return
    rows = []
    for name in robot.spec.foot_sites:
        body = model.body(int(model.site_bodyid[model.site(name).id])).name
        size = " x ".join(dict.fromkeys(f"{1000 * one:.3g}" for one in model.site(name).size if one > 0))
        points = _on_the_floor(model, robot, name)
        if not points:
            rows.append((name, f"no geom of body '{body}' touches the floor", "the body that touches it"))
        elif max(points) > 0:
            rows.append((name, f"{size} mm", f"one that reaches {1000 * max(points):.2g} mm further"))
    compare("foot sites of its model", rows, "Make the site a little larger than the foot", "site")


def height_matches(entry: Entry, registry: Registry) -> None:
    """In a model for the velocity task base_height is where the trunk is, upright and in the default pose, when the
    lowest part of the robot touches the floor: episodes begin there, and a share of it is a fall."""
    import mujoco

    robot, model = _placeable(entry)
    if model is None:
        return
    height, points = _standing(model, mujoco.MjData(model), robot, range(1, model.nbody))
    said = robot.spec.base_height
    ensure(
        not points or abs(said - height) <= HEIGHT * height,
        f"spec.base_height is {said:g} m; in the default pose the lowest part of its model touches the floor with "
        f"'{robot.spec.trunk_body}' at {height:.4g} m. Correct SPEC.base_height, m, or SPEC.default_pose",
    )
    data, feet = mujoco.MjData(model), robot.spec.foot_sites
    reach = {foot: _standing(model, data, robot, [int(model.site_bodyid[model.site(foot).id])])[0] for foot in feet}
    longest = max(reach, key=lambda foot: reach[foot], default="")
    rows = [
        (
            foot,
            f"{1000 * (reach[longest] - low):.3g} mm above that of '{longest}'",
            "as low, within a tenth of the height",
        )
        for foot, low in reach.items()
        if low > 0 and reach[longest] - low > HEIGHT * reach[longest]
    ]
    compare("lowest points of its feet in the default pose", rows, "Correct a joint's axis or ref, or the pose", "foot")


def _placeable(entry: Entry) -> tuple[Robot, mujoco.MjModel | None]:
    """The robot, and its model if that can be put down on a plane; None where there is nothing to compare. Raises
    NotTried without a free joint of its trunk."""
    import mujoco

    from hts.sim.conventions import FLOOR, FREE

    robot, model = comparable_model(entry)
    if model is None or model.geom(FLOOR).type[0] != int(mujoco.mjtGeom.mjGEOM_PLANE):
        return robot, None
    if model.njnt == 0 or model.jnt_type[0] != FREE:
        raise NotTried("its trunk cannot be put anywhere")  # said by `model_is_in_order`
    return robot, model


def _on_the_floor(model: mujoco.MjModel, robot: Robot, foot: str) -> list[float]:
    """Of each point at which the foot's body touches the floor, just so: how far it lies outside the site, m (at
    least); 0 inside."""
    import mujoco

    site = model.site(foot).id
    data = mujoco.MjData(model)
    _, found = _standing(model, data, robot, [int(model.site_bodyid[site])])
    return [_outside(model, data, site, point) for point in found]


def _standing(
    model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, bodies: Collection[int]
) -> tuple[float, list[np.ndarray]]:
    """Height of the trunk, m, upright and in the default pose, at which one of these bodies touches the floor just so,
    and the points where, m; none if none of them can touch it."""
    import mujoco

    from hts.sim.conventions import FLOOR

    floor = model.geom(FLOOR).id
    places = [int(model.joint(name).qposadr[0]) for name in robot.spec.joint_names]

    def points(height: float) -> list[np.ndarray]:
        data.qpos[:] = model.qpos0
        data.qpos[:3], data.qpos[3:7] = (0, 0, height), (1, 0, 0, 0)
        data.qpos[places] = robot.spec.default_pose
        mujoco.mj_fwdPosition(model, data)
        return [
            contact.pos.copy()
            for contact in data.contact
            if contact.dist < 0
            and floor in contact.geom
            and any(int(model.geom_bodyid[geom]) in bodies for geom in contact.geom)
        ]

    low, high = -1.0 - robot.spec.base_height, 3 * robot.spec.base_height + 1.0
    if not points(low):
        return 0.0, []
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if points(middle) else (low, middle)
    return low, points(low - DEPTH)


def _outside(model: mujoco.MjModel, data: mujoco.MjData, site: int, point: np.ndarray) -> float:
    """How much wider the site has to be in order to hold a point, m; 0 if it holds it."""
    import mujoco

    def held(more: float) -> bool:
        size, ray = model.site_size[site] + more, np.array([0.0, 0.0, -1.0])  # as a touch sensor looks for its site
        place, turned, kind = data.site_xpos[site], data.site_xmat[site], int(model.site_type[site])
        return bool(mujoco.mju_rayGeom(place, turned, size, point, ray, kind) >= 0)

    if held(0.0):
        return 0.0
    return next((more for more in np.arange(1, 500) * DEPTH if held(more)), math.inf)


def meets(model: mujoco.MjModel, first: int, second: int) -> bool:
    """Whether two geoms can touch as their contype and conaffinity say."""
    kinds, others = model.geom_contype, model.geom_conaffinity
    return bool(kinds[first] & others[second] or kinds[second] & others[first])


def _actuators(model: mujoco.MjModel, robot: Robot) -> list[tuple[str, int]]:
    """Each joint, in the spec's order, with the number of its actuator."""
    from hts.sim.conventions import actuator_of

    numbers = actuator_of(model)
    return [(joint, numbers[joint]) for joint in robot.spec.joint_names]


def _kind(model: mujoco.MjModel, index: int) -> str:
    """What an actuator is called in MJCF, by its numbers."""
    import mujoco

    gain, bias = model.actuator_gainprm[index], model.actuator_biasprm[index]
    gain_type, bias_type = int(model.actuator_gaintype[index]), int(model.actuator_biastype[index])
    state = int(model.actuator_dyntype[index])
    if gain_type != int(mujoco.mjtGain.mjGAIN_FIXED):
        return "general"
    if bias_type == int(mujoco.mjtBias.mjBIAS_NONE):
        return "motor"
    if bias_type != int(mujoco.mjtBias.mjBIAS_AFFINE):
        return "general"
    if state != int(mujoco.mjtDyn.mjDYN_NONE):
        return "intvelocity" if state == int(mujoco.mjtDyn.mjDYN_INTEGRATOR) else "one with a state of its own"
    if bias[1] == 0 and bias[2] == -gain[0]:
        return "velocity"
    servo = bias[0] == 0 and math.isclose(-bias[1], gain[0], rel_tol=RELATIVE, abs_tol=1e-9)
    return "position" if servo else "general"


def compare(what: str, rows: Sequence[Row], advice: str, kind: str = "joint") -> None:
    """Raises PluginError that says all rows whose found is not the expected; joints with the same fault together."""
    alike: dict[tuple[str, str], list[str]] = {}
    for name, found, expected in rows:
        if found != expected:
            alike.setdefault((found, expected), []).append(f"'{name}'")
    said = [f"{kind} {', '.join(names)}: {found}, expected {expected}" for (found, expected), names in alike.items()]
    ensure(not said, f"{what}: {'; '.join(said)}. {advice}")


CHECKS = (
    model_is_in_order,
    actuators_are_servos,
    gains_match,
    torque_limits_match,
    targets_are_not_clipped,
    position_limits_match,
    weight_is_carried,
    floor_decides_the_grip,
    feet_are_felt,
    height_matches,
)
