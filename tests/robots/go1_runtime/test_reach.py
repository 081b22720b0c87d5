"""What the joints are told at most, and how a policy is walked for the first time."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from hts.config_gate import FirstRunConfig
from hts_go1_runtime import machine
from hts_go1_runtime.bundle import load_bundle
from hts_go1_runtime.errors import RuntimeFault, Stopped
from hts_go1_runtime.events import Events
from hts_go1_runtime.fake import standing
from hts_go1_runtime.first_run import FirstRun
from hts_go1_runtime.loop import Loop
from hts_go1_runtime.machine import Limits
from hts_go1_runtime.reach import Reach, reach_of
from hts_go1_runtime.session import Options, Session

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)

NARROW = {"hip": [-0.3, 0.3], "thigh": [0.5, 0.95], "calf": [-2.0, -1.75]}  # around the default pose


def narrow(manifest):
    manifest["robot"]["position_limit"] = [NARROW[name.split("_")[1]] for name in manifest["robot"]["joint_names"]]


def limits(**changed):
    """A manifest's robot that allows what the robot itself does."""
    return {
        "position_limit": np.stack([machine.POSITION_LOW, machine.POSITION_HIGH], axis=1).tolist(),
        "velocity_limit": machine.VELOCITY_LIMIT.tolist(),
        "torque_limit": machine.TORQUE_LIMIT.tolist(),
        **changed,
    }


def rows_of(log: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(log.read_text().splitlines()))


def test_no_joint_is_told_to_leave_the_range_of_the_manifest(change, visit):
    bundle, link = change(narrow), scripted.ScriptedLink()
    assert visit("--yes", link=link) == 0
    low, high = np.array([NARROW[name.split("_")[1]] for name in machine.JOINTS]).T
    told = np.array([command.q for _, command in link.sent if command.kp.any()])
    assert (told >= low).all() and (told <= high).all()
    rows = rows_of(bundle / "logs" / "00.csv")
    calf = [float(row["FR_calf_joint_target"]) for row in rows]
    assert min(calf) == pytest.approx(-2.0) or max(calf) == pytest.approx(-1.75)  # it would have gone further


def test_a_pose_outside_the_range_of_the_manifest_is_refused(change):
    def higher(manifest):
        narrow(manifest)
        manifest["robot"]["position_limit"][2] = [-2.0, -1.85]  # the default pose has -1.8

    with pytest.raises(RuntimeFault, match=r"default_pose -1.8 rad of FR_calf_joint, its range is -2 to -1.85"):
        load_bundle(change(higher))


def test_the_smaller_torque_limit_counts_in_every_row(change, visit):
    def weak(manifest):
        manifest["robot"]["torque_limit"] = [2.0] * 12

    bundle, link = change(weak), scripted.ScriptedLink()
    assert visit("--yes", "--rows", "00", link=link) == 0
    (row, *_) = load_bundle(bundle).rows
    policy, asked = load_bundle(bundle).policies[row.policy], []
    for one in rows_of(bundle / "logs" / "00.csv"):
        q, dq, target = (
            np.array([float(one[f"{joint}_{what}"]) for joint in machine.JOINTS])
            for what in ("position", "velocity", "target")
        )
        asked.append(np.abs(policy.kp * (target - q) - policy.kd * dq))
    assert np.max(asked) == pytest.approx(2.0, abs=1e-3)


@pytest.mark.parametrize("action", [np.inf, -np.inf, np.nan])
def test_a_target_that_is_no_number_is_not_weakened_to_one(bundle, tmp_path, action):
    loaded, link = load_bundle(bundle), scripted.ScriptedLink()
    for policy in loaded.policies.values():
        policy.targets = lambda state, command: np.full(12, action)
    with contextlib.closing(Events(tmp_path / "events.jsonl")) as events:
        options = Options(first_run=True, idle_seconds=0.2)
        with pytest.raises(Stopped, match="not finite"):
            Session(loaded, link, Loop(link, 0.02, Limits()), options, events).run()
    stiff = [command for _, command in link.sent if command.kp.any()]
    assert (stiff[-1].q == machine.STAND).all()


def test_a_joint_that_is_faster_than_the_manifest_allows_is_stopped(change, visit, capsys):
    """The robot's own limit is 20.06 rad/s of a calf; 1.2 times 5 rad/s are 6."""
    change(lambda manifest: manifest["robot"].__setitem__("velocity_limit", [5.0] * 12))

    def fast(state):
        return dataclasses.replace(state, dq=np.where(np.arange(12) == 5, 7.0, 0.1 * state.dq))

    assert visit("--yes", link=scripted.ScriptedLink(lambda state: fast(state) if state.stamp > 1.0 else state)) == 3
    assert "joint speed: FL_calf_joint at 7.0 rad/s, at most 6.0" in capsys.readouterr().err


def test_a_robot_sits_down_no_faster_than_the_manifest_allows(change, tmp_path):
    """From standing to sitting a calf bends by 0.7 rad; in 2 s that would be 0.55 rad/s in the middle."""
    bundle = load_bundle(change(lambda manifest: manifest["robot"].__setitem__("velocity_limit", [0.3] * 12)))
    link = scripted.ScriptedLink()
    loop = Loop(link, 0.02, Limits())
    with contextlib.closing(Events(tmp_path / "events.jsonl")) as events:
        loop.start()
        Session(bundle, link, loop, Options(), events)._sit_down()
    rates = np.diff([command.q for _, command in link.sent], axis=0) / 0.02
    assert 0.29 < np.abs(rates).max() < 0.302
    assert bundle.reach.blend_seconds(machine.STAND, machine.SIT, 2.0) == pytest.approx(np.pi / 2 * 0.7 / 0.3)


def test_the_narrower_of_both_limits_counts():
    found = reach_of(limits(torque_limit=[5.0] * 12), "here")
    assert found.low == pytest.approx(machine.TARGET_LOW) and found.high == pytest.approx(machine.TARGET_HIGH)
    assert found.torque == pytest.approx(5.0) and found.weaker and not reach_of(limits(), "here").weaker
    assert reach_of(limits(velocity_limit=[3.0] * 12), "here").velocity == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"position_limit": [[0.1, -0.1], *[[-0.6, -0.9]] * 11]}, "FR_hip_joint may go from 0.1 to -0.1 rad"),
        ({"position_limit": [[float("nan"), 0.1]] * 12}, "position_limit of FR_hip_joint is wider .* or no number"),
        ({"torque_limit": [0.0] * 12}, "with 0 N·m: nothing can be done"),
        ({"torque_limit": [float("nan")] * 12}, "torque_limit of FR_hip_joint is wider .* or no number"),
        ({"velocity_limit": [5.0] * 11}, "other than 12 joints"),
    ],
)
def test_limits_that_are_none_are_refused(changed, said):
    with pytest.raises(RuntimeFault, match=f"here: .*{said}"):
        reach_of(limits(**changed), "here")


def test_a_weakened_target_asks_for_no_more_than_its_share_of_the_torque():
    state, kp, kd = standing(0, 0.0), np.full(12, 30.0), np.full(12, 0.6)
    reach = Reach(machine.TARGET_LOW, machine.TARGET_HIGH, machine.TORQUE_LIMIT, machine.VELOCITY_LIMIT)
    asked = kp * (reach.weakened(state.q + 5.0, kp, kd, state, 0.6) - state.q) - kd * state.dq
    assert asked == pytest.approx(0.6 * machine.TORQUE_LIMIT)


# ---------------------------------------------------------------------- the first run


def scheduled(*commands):
    """A bundle's first row with (vx, vy, yaw_rate), 2 s each."""

    def edit(manifest):
        keys = ("vx", "vy", "yaw_rate")
        manifest["rows"][0]["schedule"]["commands"] = [
            {"seconds": 2.0, **dict(zip(keys, one, strict=True))} for one in commands
        ]

    return edit


def test_a_first_run_walks_every_command_of_its_rows_scaled_and_records_nothing(change, visit, monkeypatch):
    bundle = change(scheduled((0.0, 0.0, 0.0), (1.3, 0.0, 0.0), (0.8, -0.2, 0.4)))
    asked = []
    original = FirstRun.commands
    monkeypatch.setattr(FirstRun, "commands", lambda *given: asked.append(original(*given)) or asked[-1])
    assert visit("--yes", "--first-run") == 0
    assert not list((bundle / "logs").glob("*.csv"))
    share = 20.0 / 3
    expected = [(share, 0.0, 0.0, 0.0), (share, 0.4, -0.1, 0.2), (share, 0.65, 0.0, 0.0)]
    assert np.array(asked[0]) == pytest.approx(np.array(expected))
    said = [json.loads(line) for line in (bundle / "logs" / "events.jsonl").read_text().splitlines()]
    walked = {one["policy"]: one["commands"] for one in said if one["what"] == "first run"}
    assert walked["policies/00-walk.onnx"] == [[0.0, 0.0, 0.0], [0.4, -0.1, 0.2], [0.65, 0.0, 0.0]]
    assert walked["policies/01-noisy.onnx"] == [[0.3, 0.0, 0.0]]


@pytest.mark.parametrize("key", ["speed_scale", "torque_scale", "seconds"])
@pytest.mark.parametrize("value", [0.01, 0.05, 0.099, 0.1, 0.5, 0.999, 1.0, 1.001, 20.0, 600.0, 600.1, 900.0])
def test_hts_and_the_runtime_take_the_same_numbers_for_a_first_run(change, key, value):
    bundle = change(lambda manifest: manifest["first_runs"].__setitem__(key, value))
    taken = []
    for ask in (lambda: FirstRunConfig(**{key: value}), lambda: load_bundle(bundle)):
        try:
            ask()
            taken.append(True)
        except (ValueError, RuntimeFault):
            taken.append(False)
    assert taken[0] == taken[1]
