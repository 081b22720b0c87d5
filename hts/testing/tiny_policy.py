"""The first policy of the cart, written down instead of trained: it drives at the commanded velocity.

A position servo makes the torque kp (target - q) - kd q'. With target = q + u, held over a control step and arriving
τ late on average, a wheel settles where kp u = (kd + kp τ) q'. So u = (kd/kp + τ) v/r drives the wheel at v. The
targets are linear in what the policy sees, and a hidden layer of ELUs that never go below 0 is linear too.

All numbers of the network are moderate, as a trained one's are: large ones that cancel each other would cost the
precision that an export is held to, and the first gradient steps would change the actions by more than any KL bound.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

HIDDEN = (16,)
SIGMA = 0.5  # exploration noise of each action, action units: 0.6 N·m
LATE = 0.01 + 0.0075  # τ, s: half a control step, and the mean actuation delay of training
REACH = 50.0  # action units, down to which the hidden layer is linear; 20 s at 1.5 m/s backwards end at -45
FAR = 100.0  # rad: scale of the wheel angles, which grow all the time; they are seen up to ten times that


def write_drive_policy(path: Path, name: str) -> Path:
    """Write the policy of the cart in `examples.robot` for a robot called `name`, numbers and card; returns `path`."""
    from hts.envs.observation import critic_observation_size, observation_layout
    from hts.policies.files import Policy, make_card, save_policy
    from hts.rl.population import Population, Sizes
    from hts.testing.examples.robot.model import RADIUS, TRACK
    from hts.testing.examples.robot.robot import SPEC

    spec = replace(SPEC, name=name)
    joints = spec.num_joints
    layout, start = observation_layout(joints), {}
    size = 0
    for part in layout:
        start[part["name"]] = size
        size += int(part["size"])
    sizes = Sizes(size, critic_observation_size(joints, len(spec.foot_sites)), joints, HIDDEN)
    tensors = {key: value.clone() for key, value in Population(sizes, 1, SIGMA).candidate(0).items()}
    command, angle = start["command"], start["joint_position_offset"]
    for normaliser in ("observation_std", "critic_observation_std"):
        tensors[normaliser][angle : angle + joints] = FAR
    weight, bias, out, out_bias = (tensors[f"actor.{layer}.{what}"] for layer in (0, 1) for what in ("weight", "bias"))
    out.zero_()
    tensors["critic.1.weight"].zero_()  # a critic that knows nothing says 0
    # Hidden unit j is 1 + (action of wheel j) / REACH; the output takes both away again.
    for wheel, side in enumerate((-1.0, 1.0)):  # turning left, the left wheel is the slower one
        unit = REACH * spec.action_scale[wheel]  # rad of target that move the hidden unit by 1
        lead = (spec.kd[wheel] / spec.kp[wheel] + LATE) / RADIUS  # rad per m/s
        weight[wheel] = 0.0
        weight[wheel, command] = lead / unit
        weight[wheel, command + 2] = side * lead * TRACK / 2 / unit
        weight[wheel, angle + wheel] = FAR / unit
        bias[wheel] = 1.0
        out[wheel, wheel] = REACH
        out_bias[wheel] = -REACH
    card = make_card(spec, tensors, layout, sizes, how="written down, not trained")
    return save_policy(path, Policy(tensors, card))
