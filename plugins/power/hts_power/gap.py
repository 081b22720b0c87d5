"""How far training simulation and twin are apart, for the same policy and commands.

The training simulation here is the robot's own model as it is, with its servos, time step and perfect sensors,
without randomisation. The same drive train and battery are put on both, so that what differs is the motion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from hts.contracts import Robot
    from hts.testing.twin import TwinSettings
    from hts_power.gauge import BatteryGauge

SKIP_SECONDS = 2.0  # of walking, before anything is measured
ROWS = (
    ("net_watts", "net power, W"),
    ("torque_rms", "joint torque RMS, N m"),
    ("velocity_rms", "joint velocity RMS, rad/s"),
    ("mean_speed", "mean speed, m/s"),
)


def compare(
    robot: Robot,
    settings: TwinSettings,
    make_gauge: Callable[[], BatteryGauge],
    policy: Path,
    seconds: float,
    twin: Mapping[str, Any],
) -> dict[str, Any]:
    """[training simulation, twin] of each quantity, per speed; and how the two machines differ.

    twin: result of `calibration.measure`.
    """
    walks: dict[str, dict[str, list[float]]] = {}
    for speed, row in twin["walking"].items():
        trained = train(robot, make_gauge(), policy, float(speed), seconds)
        real = {**row, "net_watts": row["true_watts"]["battery"] - row["true_watts"]["idle"]}
        walks[speed] = {name: [trained[name], real[name]] for name, _ in ROWS}
    return {"walking": walks, "machines": machines(robot, settings)}


def train(robot: Robot, gauge: BatteryGauge, policy: Path, speed: float, seconds: float) -> dict[str, float]:
    """One robot walking in the nominal training simulation: net power W, RMS torque and velocity, mean speed."""
    import mujoco

    from hts.contracts import PhysicsSample
    from hts.policies.deploy import DeployedPolicy
    from hts.sim.models import compile_model
    from hts.testing.twin import Operator

    spec = robot.spec
    model = compile_model(robot)
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in spec.joint_names]
    qpos, dof = np.array([j.qposadr[0] for j in joints]), np.array([j.dofadr[0] for j in joints])
    actuators = np.array([model.actuator(name).id for name in spec.joint_names])
    data.qpos[2], data.qpos[qpos] = spec.base_height, spec.default_pose
    mujoco.mj_forward(model, data)
    controller, operator = DeployedPolicy(policy), Operator(1)
    gauge.reset(1, np.random.default_rng(0))
    none = np.zeros((1, len(spec.foot_sites)))
    rows: list[tuple[np.ndarray, np.ndarray, float]] = []
    period = 1 / spec.control_rate_hz
    skip, start, started = round(SKIP_SECONDS / period), {}, 0.0
    for step in range(skip + round(seconds / period)):
        if step == skip:
            gauge.read()
            gauge.settle()
            start, started = {name: joules.copy() for name, joules in gauge.energy.items()}, gauge.seconds
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, data.qpos[3:7])
        turn = rotation.reshape(3, 3).T  # world to trunk
        heading = np.array([np.arctan2(turn[0, 1], turn[0, 0])])
        data.ctrl[actuators] = controller.targets(
            {
                "angular_velocity": data.qvel[None, 3:6],
                "projected_gravity": -turn[None, :, 2],
                "command": operator.command(np.array([speed, 0.0, 0.0]), heading),
                "joint_position": data.qpos[None, qpos],
                "joint_velocity": data.qvel[None, dof],
            }
        )[0]
        for _ in range(spec.substeps):
            velocity = data.qvel[None, dof].copy()
            mujoco.mj_step(model, data)
            gauge.step(
                PhysicsSample(data.actuator_force[None, actuators], velocity, none, none, none, model.opt.timestep)
            )
        if step >= skip:
            rows.append((data.actuator_force[actuators].copy(), data.qvel[dof].copy(), float(turn[0] @ data.qvel[:3])))
    gauge.read()
    torque, speeds, forward = (np.array(column) for column in zip(*rows, strict=True))
    watts = {name: float((gauge.energy[name] - start[name])[0]) / (gauge.seconds - started) for name in start}
    return {
        "net_watts": watts["battery"] - watts["idle"],
        "torque_rms": float(np.sqrt((torque**2).mean())),
        "velocity_rms": float(np.sqrt((speeds**2).mean())),
        "mean_speed": float(forward.mean()),
    }


def machines(robot: Robot, settings: TwinSettings) -> dict[str, list[str]]:
    """[training simulation, twin] of what is built differently."""
    from hts.sim.models import compile_model
    from hts.testing.twin import build

    spec, p, nominal = robot.spec, settings.dynamics, compile_model(robot)
    twin = build(robot, p)
    dof = np.array([nominal.joint(name).dofadr[0] for name in spec.joint_names])
    floor = nominal.geom_friction[nominal.geom_bodyid == 0, 0]
    cone = {0: "pyramidal", 1: "elliptic"}
    return {
        "mass, kg": [f"{nominal.body_mass.sum():.2f}", f"{twin.total_mass:.2f}"],
        "actuation delay, ms": ["0", f"{1000 * p.actuation_delay:g}"],
        "joint friction, mean, N m": [f"{nominal.dof_frictionloss[dof].mean():.2f}", f"{twin.friction.mean():.2f}"],
        "load-dependent gear loss, mean": ["0", f"{twin.gear_loss.mean():.3f}"],
        "armature, mean, kg m^2": [
            f"{nominal.dof_armature[dof].mean():.4f}",
            f"{twin.model.dof_armature[twin.joint_dof].mean():.4f}",
        ],
        "floor friction": [f"{floor[0]:.2f}", f"{p.floor_friction:.2f}"],
        "physics step, ms": [f"{1000 * nominal.opt.timestep:g}", f"{1000 * p.physics_dt:g}"],
        "friction cone": [cone[int(nominal.opt.cone)], cone[int(twin.model.opt.cone)]],
        "torque falls with speed": ["no", f"above {p.full_torque_speed:.0%} of no-load speed"],
    }


def table(gap: Mapping[str, Any]) -> list[str]:
    """As GitHub-flavoured markdown."""
    lines = ["| | training simulation | twin | apart |", "|---|---|---|---|"]
    for speed, row in gap["walking"].items():
        for name, title in ROWS:
            trained, real = row[name]
            lines.append(f"| {title} at {speed} m/s | {trained:.3f} | {real:.3f} | {real / trained - 1:+.0%} |")
    for title, (trained, real) in gap["machines"].items():
        lines.append(f"| {title} | {trained} | {real} | |")
    return lines
