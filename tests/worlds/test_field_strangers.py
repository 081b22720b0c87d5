"""Logs of a bundle that none of its policies made, beside logs that agree with theirs; what must not be taken for one.

The walks are a twin's, closed loop: what the policy was given lies in the log as it was.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hts
from hts.config import Command, ScheduleConfig
from hts.errors import RecordingError
from hts.policies.export import to_onnx
from hts.policies.files import Policy, load_policy
from hts.recordings.recording import Recording, Series
from hts.worlds.base import request_id, seed_sequence
from hts.worlds.field_ran import check_whose
from hts.worlds.twin.parameters import TwinSettings
from hts.worlds.twin.programme import Block, Session
from hts.worlds.twin.session import Batch

OURS = Path(hts.__file__).parents[1] / "docs" / "results" / "coverage" / "policies"
SECONDS = 5.0


@pytest.fixture(scope="module")
def policies(robot, tmp_path_factory) -> list[Path]:
    """The pretrained one, and two that a run fine-tuned from it, early and at the end."""
    pretrained = to_onnx(load_policy(robot.pretrained_policy()), tmp_path_factory.mktemp("policies") / "walk.onnx")
    return [pretrained, OURS / "s0-early.onnx", OURS / "s0-final.onnx"]


@pytest.fixture(scope="module")
def walks(robot, policies) -> list[Recording]:
    """Of each policy at 0.5 m/s."""
    schedule = ScheduleConfig(commands=(Command(seconds=SECONDS, vx=0.5),))
    batch = Batch(robot, TwinSettings(), {}, len(policies), seed_sequence(0, request_id("strangers")))
    sessions = [Session(id=path.stem, blocks=(Block(policy=str(path), schedule=schedule),)) for path in policies]
    return [rows[0] for rows in batch.run(sessions, "twin")]


def check(rows: list[tuple[Path, Recording]]) -> None:
    policies, recordings = zip(*rows, strict=True)
    check_whose([Path(f"{number:02d}.csv") for number in range(len(rows))], recordings, policies)


def changed(recording: Recording, **values: np.ndarray) -> Recording:
    channels = recording.channels
    new = {name: Series(channels[name].channel, value.astype(np.float32)) for name, value in values.items()}
    return recording.replace(channels={**channels, **new})


def states(recording: Recording, change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    """A log in which all that the sensors give is changed."""
    names = ("joint_position", "joint_velocity", "angular_velocity", "projected_gravity")
    return changed(recording, **{name: change(recording.values(name).astype(np.float64)) for name in names})


def noisy(value: np.ndarray) -> np.ndarray:
    return value + 0.03 * np.abs(value).max() * np.random.default_rng(0).standard_normal(value.shape)


def filtered(recording: Recording) -> Recording:
    """Through a filter before it was sent."""
    found = recording.values("joint_target").astype(np.float64)
    for row in range(1, len(found)):
        found[row] = 0.4 * found[row] + 0.6 * found[row - 1]
    return changed(recording, joint_target=found)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_log_of_a_policy_that_is_not_in_the_bundle_is_refused(policies, walks, number):
    others = [row for row in range(3) if row != number]
    rows = [(policies[row], walks[row]) for row in others]
    check(rows)
    with pytest.raises(RecordingError) as refused:
        check([rows[0], (policies[others[1]], walks[number])])
    text = str(refused.value)
    assert text.startswith(f"01.csv: its joint targets are not those of {policies[others[1]].name}, of which this row ")
    assert "off by 0.0" in text and "as in other logs of this visit (1). Run " in text and "\n" not in text


def test_a_file_of_yesterday_in_both_rows_of_a_candidate_is_refused(policies, walks):
    (a, b, _), (walk, _, stranger) = policies, walks
    with pytest.raises(RecordingError, match=r"^01\.csv: .* not those of s0-early\.onnx"):
        check([(a, walk), (b, stranger), (b, stranger), (a, walk)])


@pytest.mark.parametrize(
    "change",
    [
        lambda walk: states(walk, lambda value: np.round(value, 2)),
        lambda walk: states(walk, noisy),
        lambda walk: states(walk, lambda value: (np.roll(value, 1, 0) + value + np.roll(value, -1, 0)) / 3),
        lambda walk: states(walk, lambda value: np.roll(value, -3, 0)),
        lambda walk: states(walk, lambda value: (value + np.roll(value, -1, 0)) / 2),
        lambda walk: changed(walk, angular_velocity=np.roll(walk.values("angular_velocity"), 10, 0)),
        lambda walk: changed(walk, command=walk.values("command") * [1, 0, 0]),
        filtered,
    ],
    ids=["rounded", "noisy", "smooth", "late", "half a row late", "late gyroscope", "yaw not logged", "filter"],
)
def test_a_log_that_differs_by_what_a_logger_does_is_read_although_the_others_are_exact(policies, walks, change):
    for number in range(3):
        rows = list(zip(policies, walks, strict=True))
        rows[number] = (policies[number], change(walks[number]))
        check(rows)


def test_where_no_log_agrees_nothing_is_refused(policies, walks):
    """The runner may do something to the targets, of which nobody here knows."""
    a, b, c = policies
    check([(b, walks[0]), (c, walks[0])])
    check([(a, filtered(walks[2])), (b, filtered(walks[1]))])


def test_more_rows_that_differ_than_agree_say_nothing(policies, walks):
    a, b, _ = policies
    off = changed(walks[1], joint_target=walks[1].values("joint_target") * -1.0)
    check([(a, walks[0]), (b, off), (b, changed(off, joint_target=off.values("joint_target") * 1.1))])


def test_a_few_seconds_of_another_policy_in_a_log_are_not_its_walk(policies, walks):
    """Swapped while it walked, and cut by hand."""
    own, other = walks[0].values("joint_target"), walks[2].values("joint_target")
    some = np.arange(len(own))[:, None] < len(own) // 3
    check([(policies[0], changed(walks[0], joint_target=np.where(some, other, own))), (policies[1], walks[1])])


def test_a_fall_says_nothing(policies, walks):
    with pytest.raises(RecordingError):
        check([(policies[1], walks[0]), (policies[2], walks[2])])
    check([(policies[1], walks[0].replace(fell=True)), (policies[2], walks[2])])


def test_a_robot_that_stands_says_nothing(policies, walks):
    still = states(walks[0], lambda value: np.broadcast_to(value[:1], value.shape))
    target = np.broadcast_to(walks[0].values("joint_target")[:1] + 0.3, walks[0].values("joint_target").shape)
    check([(policies[0], changed(still, joint_target=target)), (policies[2], walks[2])])


def test_rows_that_explore_say_nothing(robot, policies, walks, tmp_path):
    loaded = load_policy(robot.pretrained_policy())
    card = replace(loaded.card, exploration_std=(0.3,) * 12, policy_hash="e" * 64)
    exploring = to_onnx(Policy(loaded.tensors, card), tmp_path / "exploring.onnx")
    check([(exploring, walks[2]), (policies[1], walks[1])])
