"""The replay of a log: what it proves of an imported policy, what it refutes, and what it leaves open.

The log is a made-up walk of four joints with inertia, moved by position control from a network in another library's
order, scale and pose; so what is true of it is known.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from hts.contracts import RobotSpec
from hts.errors import ConfigError, PolicyError
from hts.policies.contract import Contract
from hts.policies.files import load_policy, save_policy
from hts.policies.importing import import_whole
from hts.policies.layout import Layout, load_layout
from hts.policies.proof import ACCEPTED, ITEMS, NOT_PROVEN, PROVEN, State, accepted, as_card, unproven
from hts.policies.replay import replay
from hts.policies.replay_log import read_log
from hts.policies.replay_targets import told_apart

NAMES = ("a_hip", "a_knee", "b_hip", "b_knee")
SPEC = RobotSpec(
    name="dog",
    joint_names=NAMES,
    default_pose=(0.1, -0.2, 0.1, -0.2),
    kp=(20.0, 30.0, 20.0, 30.0),
    kd=(0.5, 0.8, 0.5, 0.8),
    action_scale=(0.25, 0.25, 0.25, 0.25),
    torque_limit=(40.0,) * 4,
    velocity_limit=(30.0,) * 4,
    position_limit=((-3.0, 3.0),) * 4,
    control_rate_hz=50.0,
    physics_dt=0.005,
    substeps=4,
    base_height=0.3,
    foot_sites=("left_foot", "right_foot"),
)
THEIRS = ("b_knee", "a_hip", "b_hip", "a_knee")
PARTS = (
    {"name": "base_ang_vel", "size": 3, "scale": 0.25},
    {"name": "velocity_commands", "size": 3, "scale": (2.0, 2.0, 0.25)},
    {"name": "projected_gravity", "size": 3},
    {"name": "joint_pos", "size": 4},
    {"name": "joint_vel", "size": 4, "scale": 0.05},
    {"name": "actions", "size": 4},
)
TRUE = Contract(
    joint_names=THEIRS,
    default_pose={"a_hip": 0.0, "b_hip": 0.05, ".*_knee": -0.3},
    action_scale=(0.3, 0.2, 0.25, 0.35),
    kp={".*_hip": 20.0, ".*_knee": 30.0},
    kd={".*_hip": 0.5, ".*_knee": 0.8},
    control_rate_hz=50.0,
    delay_seconds=(0.0, 0.015),
)
POSE, SCALE = np.array([-0.3, 0.0, 0.05, -0.3]), np.array([0.3, 0.2, 0.25, 0.35])  # in THEIRS' order
KP, KD = np.array([30.0, 20.0, 20.0, 30.0]), np.array([0.8, 0.5, 0.5, 0.8])
STEP, TICK, ROWS = 0.001, 20, 400  # s, steps per control step, control steps


def network() -> nn.Sequential:
    torch.manual_seed(5)
    net = nn.Sequential(nn.Linear(21, 16), nn.ELU(), nn.Linear(16, 8), nn.ELU(), nn.Linear(8, 4))
    with torch.no_grad():
        net[-1].weight.mul_(3.0)
    return net


def walk(delay: float = 0.005, every: int = TICK, noise: float = 0.0) -> dict[str, np.ndarray]:
    """A log with a row every so many milliseconds, state read before the target is sent. delay: s."""
    net, rng, late = network().double(), np.random.default_rng(1), round(delay / STEP)
    q, dq, tau, last = POSE.copy(), np.zeros(4), np.zeros(4), np.zeros(4)
    sent = [POSE.copy()] * (late + 1)  # targets on their way, the one in force first
    target, seen = POSE.copy(), np.zeros(21)
    rows: dict[str, list[np.ndarray]] = {}
    for step in range(ROWS * TICK):
        time = step * STEP
        body = np.array([np.sin(3 * time), 0.5 * np.cos(5 * time), 0.3 * np.sin(time)])
        gravity = np.array([0.1 * np.sin(4 * time), 0.1 * np.cos(7 * time), -0.99])
        command = np.array([0.5 + 0.5 * np.sin(0.5 * time), 0.1, -0.2])
        before = {"joint_position": q.copy(), "joint_velocity": dq.copy(), "joint_torque": tau.copy()}
        if step % TICK == 0:
            seen = np.concatenate(
                [0.25 * body, np.array([2.0, 2.0, 0.25]) * command, gravity, q - POSE, 0.05 * dq, last]
            )
            with torch.no_grad():
                last = net(torch.from_numpy(seen)).numpy()
            target = POSE + SCALE * last
        if step % every == 0:
            row = {**before, "time": np.array(100.0 + time), "observation": seen, "action": last}
            row |= {"joint_target": target, "angular_velocity": body, "projected_gravity": gravity, "command": command}
            for key, value in row.items():
                rows.setdefault(key, []).append(np.array(value))
        sent = [*sent[1:], target.copy()]
        tau = KP * (sent[0] - q) - KD * dq + noise * rng.standard_normal(4)
        dq = dq + STEP * (tau + 4 * np.sin(20 * time + np.arange(4)) - 8 * q) / 0.05
        q = q + STEP * dq
    order = [THEIRS.index(name) for name in NAMES]
    found = {key: np.stack(values) for key, values in rows.items()}
    joints = [key for key in found if key.startswith("joint_")]
    return {**found, **{key: found[key][:, order] for key in joints}, "joint_names": np.array(NAMES)}


@pytest.fixture(scope="module")
def full() -> dict[str, np.ndarray]:
    return walk()


@pytest.fixture
def checkpoint(tmp_path):
    state = {f"actor.{name}": value for name, value in network().state_dict().items()}
    torch.save({"model_state_dict": {"std": torch.full((4,), 0.3), **state}, "iter": 7}, tmp_path / "model.pt")
    return tmp_path / "model.pt"


def states(checkpoint, arrays, contract=TRUE, parts=PARTS, robot=SPEC):
    np.savez(checkpoint.with_name("log.npz"), **arrays)
    imported = import_whole(checkpoint, robot, Layout(parts, contract.joint_names, contract))
    return replay(checkpoint, imported, read_log(checkpoint.with_name("log.npz")), robot)


def by_state(found, state):
    return [item for item in ITEMS if found[item].state == state]


def test_a_full_log_proves_all(checkpoint, full):
    found = states(checkpoint, full)
    assert by_state(found, PROVEN) == list(ITEMS), {item: one.why for item, one in found.items()}


ORDER = ("a_hip", "b_knee", "b_hip", "a_knee")  # two swapped, everywhere
WRONG = {
    "joint order": (
        {"joint_names": ORDER, "default_pose": dict(zip(THEIRS, POSE, strict=True))},
        "joint_order is another",
    ),
    "scale": ({"action_scale": (0.3, 0.2, 0.25, 0.36)}, r"action_scale of a_knee is 0.35 rad .* says 0.36"),
    "pose": ({"default_pose": 0.0}, "default_pose of"),
    "kp": (
        {"kp": {".*_hip": 20.0, "a_knee": 33.0, "b_knee": 30.0}},
        r"of a_knee kp 3\d\.?\d* and .* the contract's 33 and",
    ),
    "kd": ({"kd": 0.5}, r"of ._knee kp .* and kd 0\.[78]\d* .* the contract's 30 and 0.5"),
    "delay": (
        {"delay_seconds": (0.025, 0.03)},
        "the delay is 0 to below 20 ms by the log's torques, delay_seconds says 25",
    ),
    "rate": (
        {"control_rate_hz": 100.0},
        "its actions change 50 times a second by the log's stamps, control_rate_hz says 100",
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_full_log_refutes_what_is_wrong_and_actions_alone_leave_it_open(checkpoint, full, what):
    changes, words = WRONG[what]
    contract = replace(TRUE, **changes)
    robot = replace(SPEC, control_rate_hz=contract.control_rate_hz)
    with pytest.raises(PolicyError, match=f"log.npz refutes its contract: {words}") as caught:
        states(checkpoint, full, contract, robot=robot)
    assert "\n" not in str(caught.value)
    alone = {key: full[key] for key in ("observation", "action")}
    found = states(checkpoint, alone, contract, robot=robot)
    assert by_state(found, PROVEN) == ["actions"]


def test_two_numbers_have_as_many_digits_as_tell_them_apart():
    assert told_apart(0.35, 0.36) == ("0.35", "0.36")
    assert told_apart(0.25, 0.2500004) == ("0.25", "0.2500004")


def changed(number, **keys):
    """PARTS with other keys in one of them."""
    return tuple({**part, **(keys if place == number else {})} for place, part in enumerate(PARTS))


WRONG_PARTS = {
    "a scale": (changed(1, scale=1.0), {}, r"the scale of command is 2 by the log \(x\), the layout says 1"),
    "a scale that is hardly another": (
        changed(1, scale=[1.9996, 2.0, 0.25]),
        {},
        r"the scale of command is 2 by the log \(x\), the layout says 1\.9996",
    ),
    "degrees": (
        PARTS,
        {"joint_velocity": np.degrees},
        "the scale of joint_velocity is 0.0008727 .* says 0.05, as if the log were in degrees",
    ),
    "a sign": (PARTS, {"projected_gravity": np.negative}, "the scale of projected_gravity is -1 .* sign is another"),
    "axes": (
        PARTS,
        {"projected_gravity": lambda xyz: xyz[:, [1, 2, 0]]},
        "projected_gravity has its axes in another order: entry 0 of projected_gravity is z in the log",
    ),
    "order of parts": (
        (PARTS[2], PARTS[1], PARTS[0], *PARTS[3:]),
        {},
        "what the layout calls projected_gravity is angular_velocity in the log, with the scale 0.25",
    ),
    "angles": (
        changed(3, name="joint_position"),
        {},
        "calls joint_position are distances from the default pose in the log: call it joint_position_offset",
    ),
    "zero": (
        PARTS,
        {"joint_position": lambda angles: angles + np.array([0.0, 0.2, 0.0, 0.0])},
        "joint_position_offset of a_knee is off by -0.2 rad in the whole log",
    ),
}


@pytest.mark.parametrize("what", WRONG_PARTS)
def test_a_log_refutes_an_observation_that_is_exactly_something_else(checkpoint, full, what):
    parts, changes, words = WRONG_PARTS[what]
    log = {**full, **{key: change(full[key]) for key, change in changes.items()}}
    with pytest.raises(PolicyError, match=f"log.npz refutes its contract: .*{words}"):
        states(checkpoint, log, parts=parts)


def test_an_observation_with_noise_is_not_proven_and_refutes_nothing(checkpoint, full):
    noisy = full["angular_velocity"] + 0.1 * np.random.default_rng(2).standard_normal(full["angular_velocity"].shape)
    found = states(checkpoint, {**full, "angular_velocity": noisy})
    assert found["observation"].state == NOT_PROVEN and "angular_velocity (off by" in found["observation"].why


def test_a_log_with_wrong_actions_is_refuted(checkpoint, full):
    with pytest.raises(PolicyError, match="its actions are off by up to"):
        states(checkpoint, {"observation": full["observation"], "action": full["action"] + 2e-4})


def test_a_network_that_gives_targets_is_told_so(tmp_path, full):
    net = network()
    with torch.no_grad():
        net[-1].weight.mul_(torch.from_numpy(SCALE)[:, None])
        net[-1].bias.mul_(torch.from_numpy(SCALE)).add_(torch.from_numpy(POSE))
    state = {f"actor.{name}": value for name, value in net.state_dict().items()}
    torch.save({"model_state_dict": {"std": torch.full((4,), 0.3), **state}, "iter": 7}, tmp_path / "model.pt")
    with pytest.raises(PolicyError, match="its network gives the joint targets themselves, rad, and not the actions"):
        states(tmp_path / "model.pt", full)


def test_stamps_at_another_rate_refute_the_rate(checkpoint, full):
    with pytest.raises(PolicyError, match="change 40 times a second"):
        states(checkpoint, {**full, "time": 1.25 * full["time"]})


@pytest.mark.parametrize(
    ("delay", "shown"), [(0.002, "0 to below 5 ms"), (0.012, "10 to below 15 ms"), (0.035, "35 to below 40 ms")]
)
def test_a_faster_log_shows_the_delay_more_sharply(checkpoint, delay, shown):
    arrays = walk(delay, every=5)
    found = states(checkpoint, arrays, replace(TRUE, delay_seconds=(delay, delay)))
    assert by_state(found, PROVEN) == list(ITEMS), {item: one.why for item, one in found.items()}
    assert shown in found["delay"].why
    with pytest.raises(PolicyError, match=f"the delay is {shown}"):
        states(checkpoint, arrays, replace(TRUE, delay_seconds=(delay + 0.006, delay + 0.01)))


def test_the_order_of_logging_does_not_change_the_delay(checkpoint, full):
    """State logged after the step: row k holds the state that came of target k."""
    later = {key: values[1:] for key, values in full.items() if key not in ("joint_names", "time")}
    kept = ("observation", "action", "joint_target", "command")
    after = {key: (full[key][:-1] if key in kept else values) for key, values in later.items()}
    arrays = {**after, "time": full["time"][:-1], "joint_names": full["joint_names"]}
    found = states(checkpoint, arrays)
    assert found["delay"].state == PROVEN and found["observation"].state == PROVEN, found["observation"].why


def test_without_logged_observations_they_are_built_from_the_channels(checkpoint, full):
    arrays = {key: values for key, values in full.items() if key not in ("observation", "action")}
    found = states(checkpoint, arrays)
    assert by_state(found, PROVEN) == list(ITEMS), {item: one.why for item, one in found.items()}
    wrong = states(checkpoint, arrays, replace(TRUE, joint_names=ORDER))
    assert {"actions", "joint_order", "action_scale", "observation"} <= set(by_state(wrong, NOT_PROVEN))


def test_each_part_of_a_log_that_is_missing_leaves_its_item_open(checkpoint, full):
    for missing, item in (("joint_torque", "gains"), ("joint_torque", "delay"), ("time", "control_rate")):
        found = states(checkpoint, {key: value for key, value in full.items() if key != missing})
        assert found[item].state == NOT_PROVEN and found["joint_order"].state == PROVEN
    found = states(checkpoint, {key: value for key, value in full.items() if key != "command"})
    assert by_state(found, NOT_PROVEN) == ["observation"] and "command" in found["observation"].why


def test_noisy_torques_prove_gains_or_nothing(checkpoint):
    assert states(checkpoint, walk(noise=0.03))["gains"].state == PROVEN
    found = states(checkpoint, walk(noise=8.0))
    assert found["gains"].state == NOT_PROVEN and "position control leaves" in found["gains"].why


def test_gains_that_are_not_the_robots_stay_open_whatever_the_log_shows(checkpoint, full):
    robot = replace(SPEC, kp=(25.0,) * 4)
    found = states(checkpoint, full, robot=robot)
    assert found["gains"].state == "differs" and "robot 'dog' has 25" in found["gains"].why


def test_a_person_vouches_by_name_and_the_card_keeps_it(checkpoint, full, tmp_path):
    imported = import_whole(checkpoint, SPEC, Layout(PARTS, THEIRS, TRUE))
    assert unproven(imported.policy.card) == list(ITEMS)
    alone = states(checkpoint, {key: full[key] for key in ("observation", "action")})
    word = accepted(alone, [item for item in ITEMS if item != "delay"], "Ada Lovelace")
    assert word["actions"].state == PROVEN and word["gains"] == State(ACCEPTED, word["gains"].why, "Ada Lovelace")
    made = {**imported.policy.card.made, "proof": as_card(word)}
    policy = replace(imported.policy, card=replace(imported.policy.card, made=made))
    again = load_policy(save_policy(tmp_path / "mine", policy), SPEC)
    assert unproven(again.card) == ["delay"] and again.card.made["proof"]["gains"]["by"] == "Ada Lovelace"
    tuned = replace(again.card, made={"start": {"policy_hash": "x", "made": dict(again.card.made)}})
    assert unproven(tuned) == ["delay"]
    with pytest.raises(ConfigError, match="--by NAME"):
        accepted(alone, ["gains"], " ")
    with pytest.raises(ConfigError, match="No item named 'gain'. Did you mean 'gains'"):
        accepted(alone, ["gain"], "Ada")


# ------------------------------------------------------------------------------------------- logs that do not fit


def alone(full: dict[str, np.ndarray], rows: slice | list[int]) -> dict[str, np.ndarray]:
    """Observations and actions of some rows, and nothing else."""
    return {key: full[key][rows] for key in ("observation", "action")}


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (slice(1), "different observations in the log's 1 rows: 1, expected at least 16"),
        (slice(15), "15 rows: 15"),
        ([7] * 40, "40 rows: 1,"),
    ],
)
def test_a_few_rows_prove_no_actions(checkpoint, full, rows, words):
    found = states(checkpoint, alone(full, rows))
    assert found["actions"].state == NOT_PROVEN and words in found["actions"].why
    assert states(checkpoint, alone(full, slice(16)))["actions"].state == PROVEN


def test_one_row_is_enough_to_refute_actions(checkpoint, full):
    row = alone(full, slice(1))
    with pytest.raises(PolicyError, match="its actions are off by up to"):
        states(checkpoint, {**row, "action": row["action"] + 0.1})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (lambda full: {"observation": full["observation"][:, :20]}, "'observation' has 20 columns, .*model.pt has 21"),
        (lambda full: {"action": full["action"][:, :3]}, "'action' has 3 columns, the policy in .*model.pt has 4"),
        (lambda full: {"joint_names": np.array(["a", "b"])}, r"its joint_names \['a', 'b'\] lack 'b_knee' of"),
    ],
)
def test_a_log_of_another_policy_or_robot_is_refused_in_one_line(checkpoint, full, changes, words):
    with pytest.raises(PolicyError, match=f"log.npz: {words}") as caught:
        states(checkpoint, {**alone(full, slice(None)), **changes(full)})
    assert "\n" not in str(caught.value)


def test_a_log_without_rows_is_refused(checkpoint, full):
    with pytest.raises(PolicyError, match="log.npz: 'observation' has no rows"):
        states(checkpoint, alone(full, slice(0)))


@pytest.mark.parametrize("gains", ["-1", "[20, -1, 20, 20]", "{.*_hip: -1.0, .*_knee: 30}"])
def test_gains_below_zero_are_refused(checkpoint, tmp_path, gains):
    (tmp_path / "layout.yaml").write_text(f"kp: {gains}\n")
    with pytest.raises(ConfigError, match=r"layout.yaml: kp: -1 is below 0, expected gains of 0 or more"):
        load_layout(tmp_path / "layout.yaml")
    with pytest.raises(PolicyError, match=r"model.pt: kd is -0.5 for a joint, expected 0 or more"):
        import_whole(checkpoint, SPEC, Layout(PARTS, THEIRS, replace(TRUE, kd={".*_hip": -0.5, ".*_knee": 0.8})))
