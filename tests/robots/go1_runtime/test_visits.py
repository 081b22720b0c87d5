"""What ends a visit before the robot moves, or keeps what two visits wrote apart."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from hts_go1_runtime import cli, log, session
from hts_go1_runtime.bundle import load_bundle
from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.fake import standing
from hts_go1_runtime.gated import check_whose
from hts_go1_runtime.link import DAMPING, Command, State
from hts_go1_runtime.lock import alone
from hts_go1_runtime.machine import SIT, STAND
from hts_go1_runtime.meeting import check_attitude, check_lies
from hts_go1_runtime.posture import carried

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)
ScriptedLink = scripted.ScriptedLink


def refused(capsys) -> str:
    """The one line that was said."""
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("refused: ")
    return line


# ---------------------------------------------------------------------- the robot's first words


def test_a_battery_that_nobody_reads_is_said_and_not_called_empty(visit, capsys):
    link = ScriptedLink(lambda state: dataclasses.replace(state, current=0.0, voltage=0.0))
    assert visit("--yes", link=link) == 2
    assert link.sent == []
    assert "battery monitor gives 0 V and 0 A: it is not being read" in refused(capsys)


@pytest.mark.parametrize("quaternion", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.5, 0.0, 0.0), (1.1, 0.0, 0.0, 0.0)])
def test_an_imu_that_is_not_read_is_no_upright_robot(visit, capsys, quaternion):
    link = ScriptedLink(lambda state: dataclasses.replace(state, quaternion=np.array(quaternion)))
    assert visit("--yes", link=link) == 2
    assert link.sent == []
    line = refused(capsys)
    assert "not fit to start: orientation, the IMU's quaternion" in line
    assert "a rotation's is 1" in line and "estart the robot" in line


def turned(degrees: float, x: float, y: float, z: float) -> np.ndarray:
    """A rotation about an axis, (w, x, y, z)."""
    half = np.radians(degrees) / 2
    return np.array([np.cos(half), *(np.sin(half) * np.array([x, y, z]))])


def down(quaternion: np.ndarray) -> np.ndarray:
    return dataclasses.replace(standing(0, 0.0), quaternion=quaternion).gravity


@pytest.mark.parametrize("attitude", [turned(35.0, 0, 0, 1), turned(-30.0, 1, 0, 0) * [-1, -1, 1, 1]])
def test_a_quaternion_in_another_order_is_seen_by_the_accelerometer(visit, capsys, attitude):
    """A robot that stands turned by 35 degrees seems to lean by that; one that leans, to be upright."""
    link = ScriptedLink(
        lambda state: dataclasses.replace(state, quaternion=np.roll(attitude, -1), acc=-9.6 * down(attitude))
    )
    assert visit("--yes", link=link) == 2
    assert link.sent == []
    line = refused(capsys)
    assert "directions down that are 3" in line and "(w, x, y, z)" in line


@pytest.mark.parametrize("attitude", [turned(25.0, 0, 1, 0), turned(170.0, 0, 0, 1)])
@pytest.mark.parametrize("scale", [-9.6, 9.6, -1.0, math.nan])
def test_an_accelerometer_that_agrees_or_says_nothing_refuses_nobody(attitude, scale):
    """Down may be either way of it, and its unit another: nothing else is made of it."""
    check_attitude([dataclasses.replace(standing(0, 0.0), quaternion=attitude, acc=scale * down(attitude) + 0.3)] * 3)


# Knee of a leg that carries a quarter of 12 kg in the default pose: 29.4 N x 0.213 m x sin 0.9 = 4.9 N m.
LOADED = np.tile([0.0, 0.5, 4.9], 4)


def states(q: np.ndarray, tau: np.ndarray) -> list[State]:
    noise = np.random.default_rng(0)
    return [
        dataclasses.replace(standing(number, 0.004 * number), q=q, tau=tau + 0.7 * noise.standard_normal(12))
        for number in range(25)
    ]


def test_legs_carry_the_robot_unless_they_are_folded_or_slack():
    assert carried(states(STAND, np.where(np.arange(12) == 5, 4.9, 0.0))).startswith("FL_calf_joint gives 5.1 N·m")
    assert carried(states(STAND, np.zeros(12))) == ""  # on a stool
    assert carried(states(SIT, LOADED)) == ""  # folded: it has nowhere to fall
    assert carried(states(np.where(np.arange(12) < 9, SIT, STAND), LOADED)) != ""  # three legs are folded
    assert carried(states(np.tile([0.0, 0.4, -0.9], 4), -LOADED)) != ""  # long legs, torques counted the other way


def test_a_standing_robot_is_not_dropped(visit, capsys):
    link = ScriptedLink(lambda state: dataclasses.replace(state, tau=state.tau + LOADED))
    assert visit("--yes", link=link) == 2
    assert link.sent == []
    line = refused(capsys)
    assert "legs carry it" in line and "Lay it down first" in line
    with pytest.raises(RuntimeFault, match="Lay it down first"):
        check_lies(states(STAND, LOADED))


# ---------------------------------------------------------------------- the gate's result

REFUSAL = "00-03 is refused by the gate: FL_calf_joint is at 90% of its 35.55 N·m"


def failing_gate(manifest, passed=False):
    found = {"passed": passed, "failed": ["torque"], "refused": REFUSAL, "worst": {}}
    manifest["policies"][1]["gate"] = {"policy_hash": "e" * 64, **found}


def test_a_policy_that_failed_the_gate_is_not_walked(change, visit, capsys):
    bundle, link = change(failing_gate), ScriptedLink()
    assert visit("--yes", link=link) == 2
    assert link.sent == []
    line = refused(capsys)
    assert "policies/01-noisy.onnx" in line and REFUSAL in line and "--vouch eeeeeeeeeeee" in line
    assert cli.main(["check", str(bundle)]) == 2
    said = capsys.readouterr()
    assert "policies/01-noisy.onnx  eeeeeeeeeeee  explores, FAILED the gate: torque" in said.out
    assert "policies/00-walk.onnx" in said.out and "gate not tried" in said.out
    assert said.err.startswith("refused: ") and "failed the gate" in said.err


def test_rows_of_other_policies_are_walked(change, visit):
    change(failing_gate)
    assert visit("--yes", "--rows", "00") == 0


def test_a_person_may_vouch_for_a_policy_that_failed_the_gate(change, visit, capsys):
    bundle = change(failing_gate)
    assert visit("--yes", "--vouch", "eeeeeeeeeeee") == 0
    assert "Failed the gate, vouched for: policies/01-noisy.onnx." in capsys.readouterr().out
    events = [json.loads(line) for line in (bundle / "logs" / "events.jsonl").read_text().splitlines()]
    (vouched,) = [one for one in events if one["what"] == "vouched for"]
    assert (vouched["policy"], vouched["gate"]) == ("policies/01-noisy.onnx", REFUSAL)
    assert cli.main(["check", str(bundle), "--vouch", "e" * 64]) == 0


@pytest.mark.parametrize("digits", ["eeeeeeeeeee", "abcdefabcdef", ""])
def test_a_person_vouches_for_a_policy_by_its_hash(change, visit, capsys, digits):
    change(failing_gate)
    assert visit("--yes", "--vouch", digits) == 2
    line = refused(capsys)
    assert f"--vouch '{digits}'" in line and "eeeeeeeeeeee" in line


def test_who_vouched_for_one_command_is_asked_again_by_the_next_and_told_why(change, visit, capsys):
    bundle = change(failing_gate)
    assert cli.main(["check", str(bundle), "--vouch", "eeeeeeeeeeee"]) == 0
    assert visit("--yes", "--vouch", "eeeeeeeeeeee") == 0
    capsys.readouterr()
    assert cli.main(["check", str(bundle)]) == 2
    line = refused(capsys)
    assert "Each command and each bundle asks anew" in line and "whoever is beside the robot now" in line


def test_a_policy_that_passed_the_gate_says_so(change, visit, capsys):
    bundle = change(lambda manifest: failing_gate(manifest, True))
    assert cli.main(["check", str(bundle)]) == 0
    assert "explores, passed the gate" in capsys.readouterr().out
    assert visit("--yes") == 0


@pytest.mark.parametrize(
    ("whose", "said"),
    [({"policy_hash": "a" * 64}, "is of policy aaaaaaaaaaaa…"), ({}, "does not say of which policy it is")],
)
def test_a_gate_result_of_another_policy_is_not_believed(change, whose, said):
    folder = change(lambda manifest: manifest["policies"][1].__setitem__("gate", {"passed": True, **whose}))
    with pytest.raises(RuntimeFault, match=f"01-noisy.onnx: its gate result {said}, the graph is eeeeeeeeeeee…"):
        load_bundle(folder)


def test_what_the_gate_found_of_a_policy_holds_with_commands_of_held_speeds_in_front():
    card = {"policy_hash": "e" * 64, "made": {"held": {"policy_hash": "a" * 64}}}
    for whose in ("e", "a"):
        check_whose({"passed": True, "policy_hash": whose * 64}, card, "here")
    with pytest.raises(RuntimeFault, match="here: its gate result is of policy bbbbbbbbbbbb…"):
        check_whose({"passed": True, "policy_hash": "b" * 64}, card, "here")


@pytest.mark.parametrize("gate", [{"passed": "false"}, {"passed": None}, {}, "passed", [True], {"passed": 0}])
def test_a_gate_that_does_not_say_whether_it_was_passed_is_refused(change, gate):
    folder = change(lambda manifest: manifest["policies"][1].__setitem__("gate", gate))
    with pytest.raises(RuntimeFault, match=r"01-noisy.onnx: gate .* expected null, or `passed` true or false"):
        load_bundle(folder)


# ---------------------------------------------------------------------- commands that were found


@pytest.mark.parametrize(
    "content",
    [
        '{"s1 reference h 0.6": [NaN, false]}',
        '{"s1 reference h 0.6": [Infinity, false]}',
        '{"s1 reference h 0.6": [1.6, false]}',  # beyond the commands that the bundle allows: 0.2 to 1.5
        '{"s1 reference h 0.6": [-0.6, false]}',
        '{"s1 reference h 0.6": [0.6]}',
        '{"s1 reference h 0.6": [0.6, false, 1]}',
        '{"s1 reference h 0.6": {"command": 0.6}}',
        '{"s1 reference h 0.6": ["0.6", false]}',
        '{"s1 reference h 0.6": [true, false]}',
        '{"s1 reference h 0.6": [0.6, "false"]}',
        '{"s1 reference h 0.6": 0.6}',
        "[0.6, false]",
        "0.6",
        "{",
        "[" * 100_000,
        b"\xff\xfe",
        None,
    ],
)
def test_commands_that_cannot_have_been_found_are_refused(bundle, visit, capsys, content):
    path = bundle / "logs" / "held.json"
    if content is None:
        path.mkdir()
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    link = ScriptedLink()
    assert visit("--yes", link=link) == 2
    assert link.sent == []
    line = refused(capsys)
    assert line.startswith(f"refused: {path}: ") and "Move it away" in line
    assert len(line) < 600


def test_commands_that_were_found_are_taken(bundle, visit):
    digest = load_bundle(bundle).rows[1].policy_hash
    found = {f"s1 policy {digest} 0.6": [0.7, False], "another": [1.5, True]}
    (bundle / "logs" / "held.json").write_text(json.dumps(found))
    assert visit("--yes", "--rows", "00") == 0
    kept = json.loads((bundle / "logs" / "held.json").read_text())
    assert kept[f"s1 policy {digest} 0.6"] == [0.7, False] and len(kept) == 3


# ---------------------------------------------------------------------- two at once


def test_two_runtimes_do_not_record_into_one_bundle(bundle, visit, capsys):
    link = ScriptedLink()
    with alone(bundle / "logs"):
        assert visit("--yes", link=link) == 2
    assert link.sent == []
    assert re.search(r"logs/.lock: another runtime .* Wait until it has ended", refused(capsys))
    assert visit("--yes") == 0
    assert cli.main(["check", str(bundle)]) == 0


def test_a_folder_that_takes_no_lock_is_named(tmp_path):
    (tmp_path / "logs").write_text("")
    with pytest.raises(RuntimeFault, match=r"logs/.lock: cannot be made"), alone(tmp_path / "logs"):
        pass


def test_a_log_whose_name_was_taken_meanwhile_is_not_called_recorded(bundle, visit, capsys, monkeypatch):
    real = log.RowLog._work

    def late(self):
        (bundle / "logs" / "00.csv").write_text("somebody else's\n")
        real(self)

    monkeypatch.setattr(log.RowLog, "_work", late)
    assert visit("--yes", "--rows", "00") == 2
    said = capsys.readouterr()
    assert "recorded log=00" not in said.out.replace("not recorded log=00", "")
    (line,) = said.err.splitlines()
    assert line.startswith(f"refused: {bundle}/logs/00.csv: ") and ".00.csv.partial" in line
    assert (bundle / "logs" / "00.csv").read_text() == "somebody else's\n"
    assert len((bundle / "logs" / ".00.csv.partial").read_text().splitlines()) == 51


# ---------------------------------------------------------------------- what nobody foresaw


def test_an_error_that_nobody_foresaw_is_one_line_after_the_robot_is_damped(bundle, visit, capsys, monkeypatch):
    def broken(self, clock, values, noted):
        raise ZeroDivisionError("float division by zero\nin two lines")

    monkeypatch.setattr(session.RowLog, "write", broken)
    link = ScriptedLink()
    assert visit("--yes", link=link) == 2
    line = refused(capsys)
    assert "unexpected ZeroDivisionError: float division by zero in two lines (test_visits.py, line" in line
    assert "damped" in line and "Traceback" not in line
    assert link.sent[-1][1] is DAMPING
    said = (bundle / "logs" / "events.jsonl").read_text()
    assert said.index('"broken off, it sits down", "why": "ZeroDivisionError') < said.index("sat down")


def test_an_error_while_it_sits_down_still_ends_damped(visit, capsys, monkeypatch):
    def broken(self):
        raise IndexError("nothing there")

    monkeypatch.setattr(session.Session, "_sit_down", broken)
    link = ScriptedLink()
    assert visit("--yes", link=link) == 2
    assert "IndexError: nothing there" in refused(capsys)
    assert link.sent[-1][1] is DAMPING
    assert isinstance(link.sent[0][1], Command)
