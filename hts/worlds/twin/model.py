"""The robot's MJCF made into another machine: other masses, friction, contact and step, motors instead of servos."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from hts.contracts import Robot, RobotSpec
from hts.errors import ConfigError, UnfitWorldError
from hts.guarded import guarded
from hts.sim.conventions import floor_on_a_body, missing, without_free_trunk
from hts.sim.models import compile_model
from hts.worlds.twin.ground import bumpy_floor, heights
from hts.worlds.twin.parameters import DynamicsParameters
from hts.worlds.twin.structure import BodyStructure

TOUCH_ZONE = 1.6  # times the site size: the zone of the touch sensor must hold every contact of the foot
ITERATIONS, LINE_SEARCH = 10, 20  # of the solver, at least: more changed no force of a standing or stepping biped


@dataclass(frozen=True)
class Machine:
    """A compiled twin and where things are in it.

    joint_qpos, joint_dof: addresses, (J,) or a slice; touch, foot_velocity: columns of sensordata, (F,) and (F,) of the
    vertical component; foot_mass: effective vertical mass of each foot in the default pose, kg (F,);
    friction, gear_loss: dry friction N·m and share of the motor torque lost, (J,); standing: qpos of the default
    pose; standing_torque: that holds it, N·m (J,); total_mass: kg.
    """

    model: mujoco.MjModel
    spec: RobotSpec
    joint_qpos: slice | np.ndarray
    joint_dof: slice | np.ndarray
    touch: slice | np.ndarray
    foot_velocity: slice | np.ndarray
    foot_mass: np.ndarray
    friction: np.ndarray
    gear_loss: np.ndarray
    encoder_offset: np.ndarray
    standing: np.ndarray
    standing_torque: np.ndarray
    total_mass: float


def columns(addresses: np.ndarray) -> slice | np.ndarray:
    """The addresses as a slice where they are evenly spaced, because a slice is a view and costs nothing."""
    steps = np.diff(addresses)
    if len(addresses) == 1:
        return slice(int(addresses[0]), int(addresses[0]) + 1)
    if steps[0] > 0 and (steps == steps[0]).all():
        return slice(int(addresses[0]), int(addresses[-1]) + 1, int(steps[0]))
    return addresses


def by_gearing(spec: RobotSpec, plain: float, extra_stage: float) -> np.ndarray:
    """One value per joint, (J,): joints whose gear ratio exceeds the robot's smallest have a further stage or
    linkage."""
    if spec.motors is None:
        return np.full(spec.num_joints, plain)
    ratio = np.array(spec.motors.gear_ratio)
    return np.where(ratio > 1.01 * ratio.min(), extra_stage, plain)


def build(robot: Robot, parameters: DynamicsParameters) -> Machine:
    """Compile the twin of a robot. Raises UnfitWorldError for a robot that has no model, ConfigError or PluginError for
    a model that cannot be compiled or lacks what its spec names."""
    spec = robot.spec
    root = guarded(f"Robot '{spec.name}': mjcf()", robot.mjcf)
    if root is None:
        raise UnfitWorldError(
            f"Robot '{spec.name}' has no model (it is log-only, or brings an env of its own), so there is no twin of "
            "it. Start a run in another world: --world field, or one of a plugin's."
        )
    nominal = compile_model(robot)
    fault = missing(nominal, spec, velocity_task=False) or without_free_trunk(nominal, spec) or floor_on_a_body(nominal)
    if fault:
        raise ConfigError(f"Robot '{spec.name}': {fault}")
    machine_rng = np.random.default_rng([parameters.machine, 1])
    friction = by_gearing(spec, parameters.joint_friction, parameters.joint_friction_extra_stage)
    friction = friction * (1 + parameters.friction_spread * machine_rng.uniform(-1, 1, spec.num_joints))
    offset = parameters.encoder_offset * machine_rng.uniform(-1, 1, spec.num_joints)

    joints = [root.find("joint", name) for name in spec.joint_names]
    names = [joint.full_identifier for joint in joints]
    trunk = root.find("body", spec.trunk_body).full_identifier
    _motors_for_servos(root, joints)
    _foot_sensors(root, nominal, spec)
    structure = parameters.structure
    if structure.floor_roughness > 0:
        bumpy_floor(root, structure.floor_roughness)
    root.option.timestep = parameters.physics_dt
    root.option.integrator = "Euler"
    root.option.cone = "elliptic"
    root.option.impratio = parameters.contact_impratio
    model = mujoco.MjModel.from_xml_string(root.to_xml_string(), {k: v for k, v in root.get_assets().items()})

    # Damping is too small to need its implicit treatment, and without islands a step of one robot is cheaper.
    flags = mujoco.mjtDisableBit
    model.opt.disableflags |= flags.mjDSBL_EULERDAMP | flags.mjDSBL_ISLAND | flags.mjDSBL_MIDPHASE
    # At 1 ms and with the last step's accelerations to start from, the solver gains nothing below this.
    model.opt.tolerance = 1e-6
    # One iteration, as models for MJX have it, pushes a robot up with more than twice its weight.
    model.opt.iterations = max(int(nominal.opt.iterations), ITERATIONS)
    model.opt.ls_iterations = max(int(nominal.opt.ls_iterations), LINE_SEARCH)
    dof = np.array([model.joint(name).dofadr[0] for name in names])
    qpos = np.array([model.joint(name).qposadr[0] for name in names])
    model.dof_armature[dof] *= parameters.armature_scale
    model.dof_frictionloss[dof] = friction
    model.dof_damping[dof] = parameters.joint_damping
    body = model.body(trunk).id
    model.body_mass[body] *= parameters.trunk_mass_scale
    model.body_inertia[body] *= parameters.trunk_mass_scale
    model.body_ipos[body] += (parameters.com_shift_x, parameters.com_shift_y, parameters.com_shift_z)
    if structure.payload_mass > 0:
        _load(model, body, structure)
    if structure.floor_roughness > 0:
        model.hfield_data[:] = heights(structure, parameters.machine).ravel()
    model.geom_solref[:, 0] = parameters.contact_time
    floor = model.geom_bodyid == 0
    model.geom_friction[floor, 0] = parameters.floor_friction
    model.geom_priority[floor] = 1  # the floor's friction decides, whatever the feet say
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)

    standing = model.qpos0.copy()
    standing[2] = spec.base_height
    standing[qpos] = spec.default_pose
    return Machine(
        model=model,
        spec=spec,
        joint_qpos=columns(qpos),
        joint_dof=columns(dof),
        touch=columns(np.array([model.sensor(f"twin_touch_{i}").adr[0] for i in range(len(spec.foot_sites))])),
        foot_velocity=columns(
            np.array([model.sensor(f"twin_velocity_{i}").adr[0] + 2 for i in range(len(spec.foot_sites))])
        ),
        foot_mass=effective_foot_mass(model, standing, len(spec.foot_sites)),
        friction=friction,
        gear_loss=by_gearing(spec, parameters.gear_loss, parameters.gear_loss_extra_stage),
        encoder_offset=offset,
        standing=standing,
        standing_torque=statics(model, standing, len(spec.foot_sites))[dof],
        total_mass=float(model.body_mass.sum()),
    )


def _load(model: mujoco.MjModel, body: int, structure: BodyStructure) -> None:
    """A payload, taken as a point, on a body: mass, centre of mass and inertia of both together (Steiner's theorem)."""
    mass, added = float(model.body_mass[body]), structure.payload_mass
    centre, place = (
        model.body_ipos[body].copy(),
        np.array([structure.payload_x, structure.payload_y, structure.payload_z]),
    )
    arm = place - centre
    axes, quaternion = np.zeros(9), np.zeros(4)
    mujoco.mju_quat2Mat(axes, model.body_iquat[body])
    turned = axes.reshape(3, 3)
    inertia = turned @ np.diag(model.body_inertia[body]) @ turned.T
    inertia += mass * added / (mass + added) * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    principal, vectors = np.linalg.eigh(inertia)
    vectors[:, 0] *= np.sign(np.linalg.det(vectors))  # a rotation, not a reflection
    mujoco.mju_mat2Quat(quaternion, vectors.ravel())
    model.body_mass[body] = mass + added
    model.body_ipos[body] = centre + added / (mass + added) * arm
    model.body_inertia[body], model.body_iquat[body] = principal, quaternion


def _motors_for_servos(root: Any, joints: list) -> None:
    """Position servos become plain torque motors in joint order: the twin does its own motor control."""
    for sensor in root.find_all("sensor"):  # sensors of the robot's own model; the twin has other ones
        sensor.remove()
    for actuator in root.find_all("actuator"):
        actuator.remove()
    for joint in joints:
        root.actuator.add("motor", name=joint.name, joint=joint, ctrllimited=False)


def _foot_sensors(root: Any, nominal: mujoco.MjModel, spec: RobotSpec) -> None:
    """Normal force on and velocity of each foot. nominal: knows place and size of a site also where a <default> says
    them."""
    for index, name in enumerate(spec.foot_sites):
        found = nominal.site(name)
        zone = root.find("site", name).parent.add("site", name=f"twin_foot_{index}", type="sphere", pos=found.pos)
        zone.size = [_zone(int(found.type[0]), found.size)]
        root.sensor.add("touch", name=f"twin_touch_{index}", site=zone)
        root.sensor.add("framelinvel", name=f"twin_velocity_{index}", objtype="site", objname=zone)


def _zone(kind: int, size: np.ndarray) -> float:
    """Radius of a sphere that holds a site of this kind (mjtGeom) and size (3,), with something to spare, m."""
    geoms = mujoco.mjtGeom
    around = {
        int(geoms.mjGEOM_BOX): float(np.linalg.norm(size)),
        int(geoms.mjGEOM_CAPSULE): float(size[0] + size[1]),
        int(geoms.mjGEOM_CYLINDER): float(np.hypot(size[0], size[1])),
    }
    return max(TOUCH_ZONE * float(np.max(size)), around.get(kind, 0.0))


def effective_foot_mass(model: mujoco.MjModel, qpos: np.ndarray, num_feet: int) -> np.ndarray:
    """m_e = 1 / (J_z M^-1 J_z^T) of each foot, kg (F,): what a foot weighs to the floor that it hits."""
    data, rows = _posed(model, qpos, num_feet)
    solved = np.zeros_like(rows)
    mujoco.mj_solveM(model, data, solved, rows)
    return np.array([1.0 / float(row @ one) for row, one in zip(rows, solved, strict=True)])


def statics(model: mujoco.MjModel, qpos: np.ndarray, num_feet: int) -> np.ndarray:
    """Generalised forces that hold a pose on its feet, (nv,), those of the free trunk being zero.

    Feet push straight up, with the smallest sum of squares that carries the weight and keeps the trunk level:
    tau = g(q) - sum_i J_zi^T f_i, f the minimum-norm solution of the trunk's six equations.
    """
    data, rows = _posed(model, qpos, num_feet)
    force = np.linalg.lstsq(rows[:, :6].T, data.qfrc_bias[:6], rcond=None)[0]
    return data.qfrc_bias - rows.T @ force


def _posed(model: mujoco.MjModel, qpos: np.ndarray, num_feet: int) -> tuple[mujoco.MjData, np.ndarray]:
    """The robot in a pose, and J_z of each foot there, (F, nv)."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    rows, jacobian, rotation = np.zeros((num_feet, model.nv)), np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for foot in range(num_feet):
        mujoco.mj_jacSite(model, data, jacobian, rotation, model.site(f"twin_foot_{foot}").id)
        rows[foot] = jacobian[2]
    return data, rows
