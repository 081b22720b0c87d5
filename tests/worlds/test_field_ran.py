"""Logs of a bundle that were exchanged: the joint targets in them show whose they are."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from field_folder import SECONDS, bundle, field, fill_in, write_log

from hts.errors import RecordingError, WaitingForRobot
from hts.policies.deploy import DeployedPolicy
from hts.worlds.base import walking
from hts.worlds.field_ran import distance

ASKED = walking(0.5, SECONDS)


@pytest.fixture
def policies(tmp_path, policy, robot) -> list[Path]:
    """Two that differ by what a short fine-tuning changes."""
    from hts.policies.export import to_onnx
    from hts.policies.files import Policy, load_policy

    one = load_policy(robot.pretrained_policy())
    tensors = {
        name: value * 1.02 if name.endswith("weight") and value.shape[0] == 12 else value
        for name, value in one.tensors.items()
    }
    changed = Policy(tensors, dataclasses.replace(one.card, policy_hash="c" * 64))
    return [policy, to_onnx(changed, tmp_path / "tuned.onnx")]


def walk(log: Path, robot, policy: Path, noise: float = 0.0, late: int = 0) -> None:
    """Write a log in which the joint targets are what the policy makes of the rest. noise: of its actions; late: rows
    by which the state is logged before the target that was computed from it."""
    write_log(log, robot)
    names = log.read_text().partition("\n")[0].split(",")
    rows = np.loadtxt(log, delimiter=",", skiprows=1)
    deployed, rng = DeployedPolicy(policy), np.random.default_rng(0)
    pose, scale = (np.asarray(value) for value in (deployed.card.default_pose, deployed.card.action_scale))

    def place(channel: str) -> list[int]:
        kind = channel.removeprefix("joint_")
        wanted = (
            [f"{joint}_{kind}" for joint in robot.spec.joint_names]
            if kind != channel
            else [f"{channel}_{axis}" for axis in range(3)]
        )
        return [names.index(one) for one in wanted]

    action = np.zeros((1, 12), np.float32)
    for index, row in enumerate(rows):
        state = rows[max(index - late, 0)]
        seen = {channel: state[place(channel)][None] for channel in ("angular_velocity", "projected_gravity")}
        seen |= {channel: state[place(channel)][None] for channel in ("joint_position", "joint_velocity")}
        seen |= {"joint_position_offset": seen["joint_position"] - pose, "last_action": action}
        seen |= {"command": row[place("command")][None]}
        action = deployed.replayed(seen) + noise * rng.standard_normal((1, 12)).astype(np.float32)
        row[place("joint_target")] = pose + scale * action[0]
    np.savetxt(log, rows, delimiter=",", header=",".join(names), comments="", fmt="%.6f")


def collected(run, policies):
    return field(run).collect(policies, ASKED)


@pytest.fixture
def logs(run, policies) -> Path:
    with pytest.raises(WaitingForRobot):
        collected(run, policies)
    fill_in(run)
    return bundle(run) / "logs"


@pytest.mark.parametrize(
    ("noise", "late"),
    [(0.0, 0), (0.0, 1), (0.0, 3), (0.002, 0)],
    ids=["same row", "row before", "three rows before", "noise"],
)
def test_exchanged_logs_are_refused_and_those_in_their_places_read(run, robot, policies, logs, noise, late):
    for name, policy in zip(("01", "00"), policies, strict=True):
        walk(logs / f"{name}.csv", robot, policy, noise, late)
    with pytest.raises(RecordingError) as refused:
        collected(run, policies)
    assert str(refused.value).startswith(f"{logs}/00.csv: its joint targets are those of tuned.onnx (computed again ")
    assert " rad), not of walk.onnx (off by 0." in str(refused.value) and "\n" not in str(refused.value)
    for name, policy in zip(("00", "01"), policies, strict=True):
        walk(logs / f"{name}.csv", robot, policy, noise, late)
    assert len(collected(run, policies)) == 2


def test_a_log_in_which_nobodys_targets_are_or_not_all_that_a_policy_sees_says_nothing(run, robot, policies, logs):
    for name in ("00", "01"):
        write_log(logs / f"{name}.csv", robot)
    found, _ = collected(run, policies)
    known = DeployedPolicy(policies[0])
    assert distance(known, found) > 0.01
    less = {name: series for name, series in found.channels.items() if name != "angular_velocity"}
    assert distance(known, dataclasses.replace(found, channels=less)) is None
    assert distance(known, dataclasses.replace(found, rate_hz=25.0)) is None
