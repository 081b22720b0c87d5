"""A visit with `--straight`: what is recorded, what is read of it, and what is refused before the robot stands."""

from __future__ import annotations

import csv
import dataclasses
import importlib.util
import json
import math
from pathlib import Path

import numpy as np
import pytest

from hts import plugins
from hts.evaluation.segments import cut
from hts.recordings.mapping import load_mapping
from hts.recordings.reading import read_log
from hts_go1_runtime import lane, room, session
from hts_go1_runtime.fake import failing
from hts_go1_runtime.lane import TURNING

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)
ROW = 6.0  # s


@pytest.fixture
def longer(change):
    """The bundle with rows of ROW seconds."""

    def edit(manifest) -> None:
        for row in manifest["rows"]:
            row["schedule"]["commands"][0]["seconds"] = ROW

    return change(edit)


@pytest.fixture
def turning(monkeypatch):
    """turning(spoil): a robot that does what its lane commands; spoil: as the scripted robot's, given the lane."""
    lanes, told = [], [np.zeros(3)]

    class Heard(lane.Lane):
        def see(self, state, sent) -> None:
            told[0] = sent
            super().see(state, sent)

    def made(*given):
        lanes.append(room.lane_for(*given))
        return lanes[-1]

    monkeypatch.setattr(room, "Lane", Heard)

    monkeypatch.setattr(session, "lane_for", made)

    def robot(spoil=lambda state, its_lane: state):
        heading = [0.0]

        def turned(state):
            heading[0] += 0.004 * told[0][2]
            half, speed = heading[0] / 2, np.array([0.95 * told[0][0], 0.0, 0.0])
            w, x, y, z = state.quaternion
            c, s = math.cos(half), math.sin(half)
            quaternion = np.array([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])
            state = dataclasses.replace(state, quaternion=quaternion, velocity=state.velocity - [0.55, 0, 0] + speed)
            return spoil(state, lanes[-1] if lanes else None)

        return scripted.ScriptedLink(turned)

    return robot


def recordings(bundle: Path):
    registry = plugins.load()
    for name in ("00", "01"):
        mapping = load_mapping(bundle / "logs" / "mappings" / f"{name}.yaml")
        log = bundle / "logs" / f"{name}.csv"
        yield mapping, log, read_log(registry, [log], mapping, registry.make_robot("go1"))


def test_a_row_has_as_many_seconds_as_planned_and_its_turns_are_left_out(longer, visit, turning, capsys):
    assert visit("--yes", "--straight", "2.5", link=turning()) == 0
    said = capsys.readouterr().out
    assert "It walks to and fro on 2.5 m and turns round to the left at both ends, on the spot, about" in said
    assert "1.0 m free beyond both ends, 1.0 m to its left and 1.0 m to its right." in said
    for mapping, log, recording in recordings(longer):
        assert mapping["only"] == {"column": "phase", "number": 0}
        assert recording.seconds == pytest.approx(ROW, abs=0.05)
        assert recording.notes["straight"] == "to and fro on 2.5 m" and "rows_left_out" in recording.notes
        assert np.abs(recording.values("command")[:, 2]).max() < 0.3  # the turns were commanded 0.8
        assert np.ptp(recording.values("command")[:, 0]) < 1e-6
        with log.open() as file:
            phases = [int(float(row["phase"])) for row in csv.DictReader(file)]
        assert {*phases} == {0, 1, 2} and phases.count(0) == round(ROW * 50)
        pieces = cut([recording])
        assert (pieces.total, pieces.gaps) == (4, 0)


def test_without_it_logs_and_mappings_are_as_before_but_for_a_column(bundle, visit):
    assert visit("--yes") == 0
    for mapping, log, recording in recordings(bundle):
        assert "only" not in mapping and "straight" not in recording.notes
        assert log.read_text().splitlines()[1].endswith(",0")


def test_one_that_does_not_turn_ends_the_visit_sitting(longer, visit, capsys):
    assert visit("--yes", "--straight", "2.5") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("refused: Told to turn round at 0.8 rad/s, its heading changed by ")
    said = [json.loads(one)["what"] for one in (longer / "logs" / "events.jsonl").read_text().splitlines()]
    assert "sat down" in said and "stopped" not in said


def test_what_stops_a_robot_stops_it_in_a_turn_too(longer, visit, turning):
    def hot(state, way):
        return failing(state, "over-current") if way is not None and way.phase == TURNING else state

    link = turning(hot)
    assert visit("--yes", "--straight", "2.5", link=link) == 3
    assert not link.sent[-1][1].kp.any()


def test_a_fall_in_a_turn_is_that_rows_log(longer, visit, turning):
    def tips(state, way):
        return failing(state, "tilt") if way is not None and way.phase == TURNING else state

    assert visit("--yes", "--straight", "2.5", link=turning(tips)) == 3
    mapping = load_mapping(longer / "logs" / "mappings" / "00.yaml")
    assert mapping["recording"]["fell"] is True
    registry = plugins.load()
    recording = read_log(registry, [longer / "logs" / "00.csv"], mapping, registry.make_robot("go1"))
    assert recording.fell and recording.seconds < ROW


@pytest.mark.parametrize(
    ("edit", "straight", "said"),
    [
        (lambda row, policy: None, "1", "--straight 1: at 0.6 m/s (row 00) the robot settles for 2 s after each turn"),
        (
            lambda row, policy: row.update(yaw_rate=0.2),
            "4",
            "Row 00 commands 0.6 m/s forward, 0 to the left, 0.2 rad/s",
        ),
        (
            lambda row, policy: policy.update(trained={"commands": {"yaw_rate": [0.0, 0.0]}}),
            "4",
            "was trained with yaw rates from 0 to 0 rad/s, and to turn round at the end of a straight it needs 0.3",
        ),
        (lambda row, policy: None, "0.1", "argument --straight: '0.1', expected a number from 1 to 200"),
    ],
)
def test_what_cannot_be_walked_to_and_fro_is_refused_before_it_stands(change, visit, capsys, edit, straight, said):
    change(lambda m: edit(m["rows"][0]["schedule"]["commands"][0], m["policies"][0]))
    link = scripted.ScriptedLink()
    try:
        code = visit("--yes", "--straight", straight, link=link)
    except SystemExit as ended:
        code = ended.code
    assert code == 2 and not any(command.kp.any() for _, command in link.sent)
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line


def test_the_question_names_who_is_not_known_to_turn(change, visit, capsys, turning):
    change(lambda manifest: [policy.update(trained=None) for policy in manifest["policies"]])
    assert visit("--yes", "--straight", "4", link=turning()) == 0
    assert "Not known whether trained to turn: policies/00-walk.onnx" in capsys.readouterr().out


def test_a_first_run_turns_more_slowly(bundle, visit, turning):
    link = turning()
    assert visit("--yes", "--straight", "1.5", "--first-run", link=link) == 0
    said = (bundle / "logs" / "events.jsonl").read_text().splitlines()
    assert any(json.loads(one)["what"] == "turned round" for one in said)
    assert not list((bundle / "logs").glob("*.csv"))
