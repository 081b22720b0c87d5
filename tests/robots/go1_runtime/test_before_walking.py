"""What is asked and said before a robot walks: heat that nobody sees, and a policy that never walked there."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import os
import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from hts_go1_runtime import cli
from hts_go1_runtime.bundle import load_bundle
from hts_go1_runtime.first_run import FILE, never_walked
from hts_go1_runtime.question import begun_long_ago
from hts_go1_runtime.trained import beyond, turns
from hts_go1_runtime.when import BOOT_ID

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)
NEW = "Never walked from this bundle, nor slowly first (--first-run):"
UNGUARDED = "Not measured, so that nothing stops the robot for it:"


def giving(**values):
    return scripted.ScriptedLink(lambda state: dataclasses.replace(state, **values))


# ---------------------------------------------------------------------- heat


def test_motors_that_all_give_0_degrees_are_not_read_and_nobody_walks(visit, capsys):
    link = giving(temperature=np.zeros(12))
    assert visit("--yes", link=link) == 2
    assert "All motors give 0 degC: their temperature is not being read" in capsys.readouterr().err
    assert not any(command.kp.any() for _, command in link.sent)
    one_cold = np.where(np.arange(12) == 3, 21.0, 0.0)
    assert visit("--yes", link=giving(temperature=one_cold)) == 0


def test_what_nobody_measures_and_so_stops_nobody_is_said_before_the_robot_moves(visit, capsys):
    assert visit("--yes", link=giving(temperature=np.full(12, np.nan), voltage=np.nan)) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"{UNGUARDED} heat of the motors, low voltage of the pack. It walks about" in said


def test_nothing_is_said_where_everything_is_measured(visit, capsys):
    assert visit("--yes") == 0
    assert UNGUARDED not in " ".join(capsys.readouterr().out.split())


# ---------------------------------------------------------------------- the first time


def test_a_policy_that_never_walked_here_is_named_until_it_had_its_first_run(bundle, visit, capsys):
    assert visit("--yes", "--rows", "00") == 0
    assert f"{NEW} policies/00-walk.onnx. " in " ".join(capsys.readouterr().out.split())
    events = [json.loads(line) for line in (bundle / "logs" / "events.jsonl").read_text().splitlines()]
    assert {"policies": ["policies/00-walk.onnx"]}.items() <= next(
        one for one in events if one["what"] == "no first run"
    ).items()
    loaded = load_bundle(bundle)  # the first has a log now, so it has walked
    assert never_walked(loaded, loaded.rows) == ["policies/01-noisy.onnx"]
    assert visit("--yes", "--rows", "01", "--first-run") == 0
    assert NEW not in " ".join(capsys.readouterr().out.split())
    assert never_walked(loaded, loaded.rows) == []
    assert visit("--yes") == 0
    assert NEW not in " ".join(capsys.readouterr().out.split())


def test_each_policy_of_a_first_run_is_known_and_one_that_was_stopped_is_not(change, visit):
    bundle = change(lambda manifest: manifest["first_runs"].__setitem__("seconds", 1.0))
    stops = scripted.ScriptedLink(
        lambda state: dataclasses.replace(state, current=40.0) if state.stamp > 5.3 else state
    )  # the second walks then
    assert visit("--yes", "--first-run", link=stops) == 3
    loaded = load_bundle(bundle)
    assert json.loads((bundle / "logs" / FILE).read_text()) == [loaded.rows[0].policy_hash]
    assert visit("--yes", "--first-run") == 0
    assert json.loads((bundle / "logs" / FILE).read_text()) == sorted(row.policy_hash for row in loaded.rows)


@pytest.mark.parametrize("content", ["{", "3", "[3, null]", '{"a": 1}'])
def test_a_damaged_list_of_first_runs_says_nothing(bundle, content):
    (bundle / "logs" / FILE).write_text(content)
    loaded = load_bundle(bundle)
    assert len(never_walked(loaded, loaded.rows)) == 2


# ---------------------------------------------------------------------- beyond what was trained


def asking(row: int, trained=None, **command):
    """An edit of the manifest: what a row commands, and what its policy was trained for."""

    def edit(manifest) -> None:
        manifest["rows"][row]["schedule"]["commands"][0].update(command)
        for policy in manifest["policies"]:
            policy["trained"] = trained

    return edit


RANGES = {"commands": {"vx": [0.2, 1.5], "vy": [-0.2, 0.2], "yaw_rate": [-0.5, 0.5]}}


def test_a_row_that_asks_for_more_than_was_trained_is_told_before_the_robot_moves(change, visit, capsys):
    bundle = change(asking(1, RANGES, vy=0.3))
    words = "policies/01-noisy.onnx: 0.3 m/s to the left (rows 01), trained for -0.2 to 0.2"
    assert cli.main(["check", str(bundle)]) == 0
    assert f"more than trained for: {words}" in capsys.readouterr().out
    assert visit("--yes") == 0
    assert f"More than trained for: {words}. " in " ".join(capsys.readouterr().out.split())
    events = [json.loads(line) for line in (bundle / "logs" / "events.jsonl").read_text().splitlines()]
    assert next(one for one in events if one["what"] == "more than trained for")["rows"] == [words]


@pytest.mark.parametrize(
    ("trained", "command"),
    [
        (RANGES, {"vx": 1.5, "vy": -0.2, "yaw_rate": 0.5}),
        (RANGES, {"vx": 0.0}),  # standing, and slower than trained
        (None, {"vx": 2.5}),  # nobody knows
        ({"commands": {"vx": [-2.0, 3.0]}}, {"vx": 2.5, "vy": 1.0}),  # nothing is said of vy
    ],
    ids=["at the ends", "slower", "unknown", "of one axis alone"],
)
def test_what_was_trained_or_is_not_known_is_not_told(change, trained, command):
    loaded = load_bundle(change(asking(0, trained, **command)))
    assert beyond(loaded.rows, loaded.policies) == []


def test_the_most_is_told_of_each_policy_and_direction(change):
    def edit(manifest) -> None:
        asking(0, RANGES, vx=-0.3, yaw_rate=0.6)(manifest)
        first, second = manifest["rows"]
        first["schedule"]["commands"] += [{**first["schedule"]["commands"][0], "vx": vx} for vx in (-0.4, 1.5, 1.7)]
        second.update(first, log="01", trim=False, role="collection")

    loaded = load_bundle(change(edit))
    policy, ranges = "policies/00-walk.onnx", "trained for 0.2 to 1.5"
    assert beyond(loaded.rows, loaded.policies, fastest=1.6) == [
        f"{policy}: 0.4 m/s backwards (rows 00, 01), {ranges}",
        f"{policy}: 1.7 m/s forward (rows 00, 01), {ranges}",  # a row whose speed is held ends at 1.6
        f"{policy}: 0.6 rad/s to the left (rows 00, 01), trained for -0.5 to 0.5",
    ]
    assert beyond(loaded.rows[:1], loaded.policies, fastest=1.5) == [
        f"{policy}: 0.4 m/s backwards (rows 00), {ranges}",
        f"{policy}: 0.6 rad/s to the left (rows 00), trained for -0.5 to 0.5",
    ]


@pytest.mark.parametrize(("vx", "scale", "most"), [(1.4, 0.5, 0.5), (1.7, 1.0, 1.5)], ids=["slower", "untrimmed"])
def test_a_first_run_is_told_what_its_own_commands_ask_for(change, visit, capsys, vx, scale, most):
    def edit(manifest) -> None:
        asking(0, {"commands": {"vx": [0.0, most]}}, vx=vx)(manifest)
        manifest["first_runs"].update(speed_scale=scale, seconds=1.0)

    change(edit)
    assert visit("--yes", "--first-run", "--rows", "00") == 0
    words = f"policies/00-walk.onnx: {scale * vx:g} m/s forward (rows 00), trained for 0 to {most:g}"
    assert f"More than trained for: {words}. " in " ".join(capsys.readouterr().out.split())


def test_a_command_that_trimming_finds_beyond_what_was_trained_is_an_event(change, visit):
    bundle = change(asking(0, {"commands": {"vx": [0.2, 0.6]}}, vx=0.6))
    assert visit("--yes", "--rows", "00") == 0
    events = [json.loads(line) for line in (bundle / "logs" / "events.jsonl").read_text().splitlines()]
    told = next(one for one in events if one["what"] == "trimmed to more than was trained for")
    assert (told["log"], told["trained"]) == ("00", [0.2, 0.6])
    assert not any(one["what"] == "more than trained for" for one in events)


@pytest.mark.parametrize(
    ("ranges", "limits"),
    [
        ({}, (-1.0, 1.0)),
        ({"yaw_rate": [-0.3, 0.4]}, (-0.3, 0.4)),
        ({"yaw_rate": [-2.0, 2.0]}, (-1.0, 1.0)),
        ({"yaw_rate": [0.2, 0.4]}, (0.0, 0.4)),
    ],
)
def test_a_heading_is_kept_with_yaw_rates_that_were_trained(ranges, limits):
    assert turns(ranges, 1.0) == limits


# ---------------------------------------------------------------------- sessions of two days


def logged(bundle, log: str, hours_ago: float) -> None:
    path = bundle / "logs" / f"{log}.csv"
    path.parent.mkdir(exist_ok=True)
    path.touch()
    then = time.time() - 3600 * hours_ago
    os.utime(path, (then, then))


BEGUN = "Begun long ago, so that blocks far apart would be compared (move its logs away to walk all):"


def test_a_session_whose_other_blocks_were_walked_on_another_day_is_told(bundle, visit, capsys):
    logged(bundle, "00", hours_ago=26.0)
    assert visit("--yes") == 0
    session = load_bundle(bundle).rows[1].session
    assert f"{BEGUN} {session} (26.0 h, logs 00). " in " ".join(capsys.readouterr().out.split())
    events = [json.loads(line) for line in (bundle / "logs" / "events.jsonl").read_text().splitlines()]
    told = next(one for one in events if one["what"] == "sessions go on that were begun long ago")
    assert told["sessions"] == [f"{session} (26.0 h, logs 00)"]


@pytest.mark.parametrize("hours", [0.0, 0.4])
def test_a_session_that_goes_on_soon_is_not_told(bundle, hours):
    logged(bundle, "00", hours)
    loaded = load_bundle(bundle)
    assert begun_long_ago(loaded, loaded.rows[1:], time.time()) == []


def described(bundle, log: str, began: object) -> None:
    path = bundle / "logs" / "mappings" / f"{log}.yaml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps({"recording": {"notes": {"began_at": began}}}))


def test_logs_that_were_copied_yesterdays_way_are_as_old_as_they_say(bundle):
    logged(bundle, "00", 0.1)  # copied just now
    loaded, now = load_bundle(bundle), time.time()
    described(bundle, "00", datetime.fromtimestamp(now - 86400, UTC).isoformat())
    assert begun_long_ago(loaded, loaded.rows[1:], now) == [f"{loaded.rows[1].session} (24.0 h, logs 00)"]
    for nothing in (None, "yesterday", 3, {}):
        described(bundle, "00", nothing)
        assert begun_long_ago(loaded, loaded.rows[1:], now) == []


def test_a_clock_that_was_set_back_between_two_visits_is_told(bundle):
    logged(bundle, "00", -30.0)
    loaded = load_bundle(bundle)
    (said,) = begun_long_ago(loaded, loaded.rows[1:], time.time())
    assert said == f"{loaded.rows[1].session} (by a clock that was set back since, logs 00)"


@pytest.mark.parametrize("simulated", [True, False])
def test_a_log_says_when_it_was_recorded_where_its_clock_is_a_real_one(bundle, visit, simulated):
    link = scripted.ScriptedLink()
    link.simulated = simulated
    before = time.time()
    assert visit("--yes", "--rows", "00", link=link) == 0
    notes = json.loads((bundle / "logs" / "mappings" / "00.yaml").read_text())["recording"]["notes"]
    assert ("began_at" in notes) is not simulated
    if not simulated:
        assert before - 0.001 <= datetime.fromisoformat(notes["began_at"]).timestamp() <= time.time()
        assert notes.get("boot", "none") == (BOOT_ID.read_text().strip() if BOOT_ID.exists() else "none")


def test_other_sessions_and_recordings_that_compare_nothing_are_not_told(change):
    def apart(manifest) -> None:
        manifest["rows"][1]["session"] = "another"

    def collected(manifest) -> None:
        for row in manifest["rows"]:
            row.update(session="one", role="collection")

    for edit in (apart, collected):
        bundle = change(edit)
        logged(bundle, "00", 26.0)
        loaded = load_bundle(bundle)
        assert begun_long_ago(loaded, loaded.rows[1:], time.time()) == []
