"""The twin holds a speed: commands are trimmed by what the sensors show, then frozen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hts import plugins
from hts.contracts import HoldSpeed, WorldContext
from hts.policies.export import to_onnx
from hts.policies.files import load_policy
from hts.worlds.twin.programme import Kept, head_to_head, session_seconds
from hts.worlds.twin.trimming import HeldCommand, Trimming
from hts.worlds.twin.world import make_twin

HOLD = HoldSpeed((0.3, 1.4), seconds=12.0)
SHORT = HoldSpeed((0.3, 1.4), seconds=4.0)


def trimmed(asked: float, hold: HoldSpeed, fall_at: int | None = None, noise: float = 0.03) -> HeldCommand:
    """A robot that walks 0.9 x command - 0.02 m/s, half a second late, seen by a camera with noise, m/s."""
    rng, speed = np.random.default_rng(0), 0.0
    trimming = Trimming(np.array([asked]), hold, 0.02)
    for step in range(round(hold.seconds * 50)):
        speed += 0.02 / 0.5 * (0.9 * trimming.command[0] - 0.02 - speed)
        if step == fall_at:
            trimming.fell(np.array([True]))
            speed = 0.0
        trimming.see(np.array([speed + noise * rng.standard_normal()]))
    return trimming.found()[0]


@pytest.mark.parametrize("asked", [0.5, 0.8, 1.1])
def test_trimming_finds_the_command_that_gives_the_asked_speed(asked):
    found = trimmed(asked, HOLD)
    assert 0.9 * found.command - 0.02 == pytest.approx(asked, abs=0.005)  # the camera's noise leaves 0.0015
    assert (found.saturated, found.falls) == (False, 0)


def test_a_command_that_would_leave_its_range_stays_at_the_limit_and_says_so():
    assert trimmed(0.8, HoldSpeed((0.4, 0.85))) == HeldCommand(0.85, True)  # 0.911 would be needed
    assert trimmed(0.8, HoldSpeed((0.95, 1.2))) == HeldCommand(0.95, True)


@pytest.mark.parametrize(
    ("speeds", "commands"), [((0.5, 0.8), (0.0, 1.5)), ((-0.4,), (-1.5, 0.0)), ((0.5, -0.4), (-1.5, 1.5))]
)
def test_nobody_is_told_to_walk_the_other_way_whatever_was_trained(speeds, commands):
    assert HoldSpeed((-1.5, 1.5)).within(*speeds) == commands
    assert HoldSpeed((0.2, 1.5)).within(*(abs(speed) for speed in speeds)) == (0.2, 1.5)


def test_trimming_forward_ends_at_standing():
    """A robot that walks 0.5 m/s at command 0 would need a command of -0.3 m/s."""
    fast = Trimming(np.array([0.2, -0.2]), HoldSpeed((-1.5, 1.5)), 0.02)
    for _ in range(600):
        fast.see(np.array([0.5, -0.5]) + fast.command)
    assert fast.found() == [HeldCommand(0.0, True), HeldCommand(0.0, True)]


def test_a_fall_while_trimming_is_counted_and_does_not_spoil_the_command():
    found = trimmed(0.8, HOLD, fall_at=400)
    assert found.falls == 1
    assert 0.9 * found.command - 0.02 == pytest.approx(0.8, abs=0.01)


def blocks_of(session):
    return [
        (block.policy, block.schedule.commands[0].vx, block.schedule.seconds, block.speed, block.recorded)
        for block in session.blocks
    ]


def test_the_reference_trims_while_it_warms_up_and_the_policy_just_before_its_first_block():
    session = head_to_head(["p"], "r", [0.8], warmup=20.0, block=80.0, session="s", hold=HOLD)
    assert blocks_of(session) == [
        (None, 0.0, 1.0, "open", False),
        ("r", 0.8, 3.0, "open", False),
        ("r", 0.8, 17.0, "trim", False),
        ("p", 0.8, 12.0, "trim", False),
        ("r", 0.8, 80.0, "held", True),
        ("p", 0.8, 80.0, "held", True),
        ("p", 0.8, 80.0, "held", True),
        ("r", 0.8, 80.0, "held", True),
    ]
    assert session_seconds(1, 1, 20.0, 80.0, HOLD) == 20 + 12 + 4 * 80
    assert session_seconds(1, 1, 20.0, 80.0, None) == 20 + 4 * 80
    assert session_seconds(1, 1, 1.0, 80.0, HOLD) == 0.5 + 12 + 12 + 4 * 80  # a warm-up too short to trim in


def test_at_the_next_speed_both_trim_again_and_nobody_warms_up():
    session = head_to_head(["p"], "r", [0.5, 0.8], warmup=20.0, block=20.0, session="s", hold=HOLD)
    second = blocks_of(session)[8:]
    assert second[:2] == [("r", 0.8, 12.0, "trim", False), ("p", 0.8, 12.0, "trim", False)]
    assert [row[0] for row in second[2:]] == ["r", "p", "p", "r"]
    assert session_seconds(1, 2, 20.0, 20.0, HOLD) == 20 + 12 + 80 + 24 + 80
    assert len({block.session for block in session.blocks if block.recorded}) == 2  # a name for each speed


def test_who_was_trimmed_before_is_not_trimmed_again():
    kept = [Kept(policy=name, asked=0.8, command=0.85, saturated=False) for name in ("r", "p")]
    session = head_to_head(["p", "q"], "r", [0.8], warmup=20.0, block=15.0, session="s", hold=HOLD, kept=kept)
    assert [row[0] for row in blocks_of(session) if row[3] == "trim"] == ["q"]


# ------------------------------------------------------------------------------------------- in its process


@pytest.fixture(scope="module")
def policies(tmp_path_factory):
    """The shipped policy, and one that saturates: it stands still whatever it is told."""
    robot, folder = plugins.load().make_robot("go1"), tmp_path_factory.mktemp("policies")
    policy = load_policy(robot.pretrained_policy())
    tensors = {
        name: value * 0 if "actor" in name or "mean" in name else value for name, value in policy.tensors.items()
    }
    still = type(policy)(tensors, policy.card)
    return to_onnx(policy, folder / "walk.onnx"), to_onnx(still, folder / "still.onnx")


@pytest.fixture
def twin(tmp_path):
    settings = {"processes": 1, "warmup_seconds": 1, "block_seconds": 3}
    world = make_twin(settings, WorldContext("go1", {}, {"power": {}}, 7, tmp_path))
    yield world
    world.close()


def ids(rows):
    return [[recording.id for recording in row] for row in rows]


def test_a_held_block_keeps_the_asked_speed_in_its_schedule_and_sends_the_frozen_command(twin, policies):
    walk, _ = policies
    before = twin.head_to_head(walk, walk, [0.8])
    assert twin.hold_speed(SHORT) is True
    held = twin.head_to_head(walk, walk, [0.8])
    assert {recording.schedule.commands[0].vx for recording in held} == {0.8}
    for recording in held:
        sent = recording.values("command")[:, 0]
        assert np.ptp(sent) == 0.0
        assert sent[0] == pytest.approx(float(recording.notes["held_command"]))
        assert sent[0] != pytest.approx(0.8, abs=1e-4)
        assert recording.notes["held_saturated"] == "false"
    # 1 s of standing up, 0.5 s of walking, 4 s each of trimming reference and policy
    assert [recording.notes["unrecorded_seconds"] for recording in held] == ["9.5", "0", "0", "0"]
    assert sum(recording.robot_samples for recording in held) == round((9.5 + 4 * 3) * 50)
    walked = np.mean([recording.values("base_velocity")[50:, 0].mean() for recording in held])
    assert walked == pytest.approx(0.8, rel=0.03)  # 4 s of trimming are few

    assert twin.hold_speed(None) is False
    again = twin.head_to_head(walk, walk, [0.8])
    assert [recording.id for recording in again] == [recording.id for recording in before]
    assert not {recording.session for recording in held} & {recording.session for recording in again}
    assert "held_command" not in again[0].notes


def test_what_was_walked_in_vain_is_walked_anew_and_not_told_again(twin, policies):
    walk, _ = policies
    found = []
    for again in (0, 1, 2):
        twin.hold_speed(replace(SHORT, again=again))
        found.append({recording.session for recording in twin.head_to_head(walk, walk, [0.8])})
    assert not found[0] & found[1] and not found[1] & found[2] and not found[0] & found[2]


def test_one_machine_walks_all_speeds_of_a_session(twin, policies):
    walk, still = policies
    twin.hold_speed(SHORT)
    (row,) = twin.head_to_heads_in_session([still], walk, [0.5, 0.8], 2.0)
    assert [recording.role for recording in row] == ["reference", "policy", "policy", "reference"] * 2
    assert [recording.schedule.commands[0].vx for recording in row] == [0.5] * 4 + [0.8] * 4
    assert len({recording.session for recording in row[:4]}) == 1
    assert len({recording.session for recording in row}) == 2
    assert row[4].time[0] - row[3].time[-1] == pytest.approx(4.0 + 4.0 + 0.02)  # trimming of both, no new warm-up
    assert {recording.notes["held_saturated"] for recording in row if recording.role == "policy"} == {"true"}
    assert {recording.notes["held_command"] for recording in row if recording.role == "policy"} == {"1.4"}


def test_rounds_keep_the_commands_of_the_first_and_come_out_the_same_when_asked_again(twin, policies):
    walk, still = policies
    twin.hold_speed(SHORT)

    def race():
        return [twin.head_to_head_round([walk, still], walk, 0.8, number, 2.0) for number in (0, 1)]

    first, again = race(), race()
    assert [ids(rows) for rows in first] == [ids(rows) for rows in again]
    found = [
        {(index, r.role, r.notes["held_command"]) for index, row in enumerate(rows) for r in row} for rows in first
    ]
    assert found[0] == found[1] and len(found[0]) == 4  # one command each, and the reference is in both lists
    waited = [{float(r.notes["unrecorded_seconds"]) for row in rows for r in row} for rows in first]
    assert [max(one) for one in waited] == [1.0 + 0.5 + 4.0 + 4.0 + 4.0, 1.0 + 1.0]
