"""Numbers of the Unitree Go1, with their sources. SI units.

Sources, by the letter used below:

U  unitreerobotics/unitree_ros, robots/go1_description/xacro/const.xacro and urdf/go1.urdf, commit d6f13aad
(BSD-3-Clause) D  Go1 datasheet 1.5
M  values attributed to the GO-M8010-6 motor manual V1.0, quoted by two unrelated public repositories (second-hand)
W  Improbable-AI/walk-these-ways, commit 0e7236bd
E  estimate, with how it was made

Legs are in the order of Unitree's SDK: front right, front left, rear right, rear left; joints in a leg
are hip (abduction, axis x), thigh (axis y), calf (axis y). Frames: x forward, y left, z up.
"""

from __future__ import annotations

LEGS = ("FR", "FL", "RR", "RL")
PARTS = ("hip", "thigh", "calf")
JOINT_NAMES = tuple(f"{leg}_{part}_joint" for leg in LEGS for part in PARTS)
SIDE = {"FR": -1.0, "FL": 1.0, "RR": -1.0, "RL": 1.0}  # sign of y
END = {"FR": 1.0, "FL": 1.0, "RR": -1.0, "RL": -1.0}  # sign of x

# ---- rigid bodies (U): links without rotors, values of the left front leg.
# (mass kg, centre of mass m, inertia about it ixx ixy ixz iyy iyz izz kg m^2)
TRUNK = (
    5.204,
    (0.0223, 0.002, -0.0005),
    (0.0168128557, -0.0002296769, -0.0002945293, 0.063009565, -0.0000418731, 0.0716547275),
)
HIP = (
    0.591,
    (-0.005657, -0.008752, -0.000102),
    (0.000334008405, -0.000010826066, 0.000001290732, 0.000619101213, 0.000001643194, 0.00040057614),
)
THIGH = (
    0.92,
    (-0.003342, -0.018054, -0.033451),
    (0.004431760472, 0.000057496807, -0.000218457134, 0.004485671726, 0.000572001265, 0.000740309489),
)
CALF = (
    0.135862,
    (0.006197, 0.001408, -0.116695),
    (0.001088793059, -0.000000255679, 0.000007117814, 0.001100428748, 0.000002077264, 0.000024787446),
)
FOOT = (0.06, (0.0, 0.0, 0.0), (9.6e-6, 0.0, 0.0, 9.6e-6, 0.0, 9.6e-6))
ROTOR_MASS = 0.089  # kg
ROTOR_INERTIA_SPIN = 0.000111842  # kg m^2 about its axis
ROTOR_INERTIA_ACROSS = 0.000059647  # kg m^2

# ---- kinematics (U), m
HIP_FROM_TRUNK = (0.1881, 0.04675, 0.0)
THIGH_FROM_HIP_Y = 0.08
LINK_LENGTH = 0.213  # thigh and calf alike
FOOT_RADIUS = 0.023  # the URDF says 0.020; mujoco_menagerie and mjlab use 0.023
HIP_ROTOR_FROM_TRUNK = (0.11215, 0.04675)
THIGH_ROTOR_FROM_HIP_Y = -0.00015
CALF_ROTOR_FROM_THIGH_Y = -0.03235
TRUNK_BOX = (0.3762, 0.0935, 0.114)

# ---- limits (U; torque also D)
POSITION_LIMIT = {"hip": (-0.863, 0.863), "thigh": (-0.686, 4.501), "calf": (-2.818, -0.888)}  # rad
TORQUE_LIMIT = {"hip": 23.7, "thigh": 23.7, "calf": 35.55}  # N m
VELOCITY_LIMIT = {"hip": 30.1, "thigh": 30.1, "calf": 20.06}  # rad/s

# ---- motors
GEAR_RATIO = {"hip": 6.33, "thigh": 6.33, "calf": 9.495}  # M; the knee has 1.5 more (D)
TORQUE_CONSTANT = {"hip": 0.63895, "thigh": 0.63895, "calf": 0.95843}  # M, N m at the joint per q-axis peak A
# E, range 0.10-0.19: from a Go2 standing log's rail power over temperature-weighted torque squared, and from
# scaling the Mini Cheetah motor by rotor mass.
PHASE_RESISTANCE_OHM = 0.13
# Rotor inertia seen at the joint, kg m^2: spin inertia x ratio^2 (gears not included).
ARMATURE = {part: ROTOR_INERTIA_SPIN * ratio**2 for part, ratio in GEAR_RATIO.items()}
# E: dry friction of gear and bearings that the simulator knows of. Mini Cheetah and mujoco_menagerie use 0.2.
JOINT_FRICTION = {"hip": 0.2, "thigh": 0.2, "calf": 0.3}  # N m
JOINT_DAMPING = 0.01  # N m s; Mini Cheetah

# ---- controller
# W's stance, with the knees a little more bent so that the feet lie under the hips.
DEFAULT_POSE = {"hip": 0.0, "thigh": 0.9, "calf": -1.8}  # rad; thigh and calf as mujoco_menagerie's home
KP, KD = 30.0, 0.6  # N m/rad, N m s/rad: walked in trials where 20/0.5 stood still
ACTION_SCALE = 0.35  # rad per action unit
CONTROL_RATE_HZ = 50.0
PHYSICS_DT = 0.005
SUBSTEPS = 4
BASE_HEIGHT = 0.29  # m: 2 * 0.213 * cos(0.9) + 0.023 = 0.288
