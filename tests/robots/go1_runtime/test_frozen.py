"""A sensor that repeats its last number: the robot is stopped, or sits down where it is the pack's monitor."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from hts_go1_runtime.bundle import FrozenSeconds, load_bundle
from hts_go1_runtime.errors import RuntimeFault, Stopped
from hts_go1_runtime.fake import noisy, standing
from hts_go1_runtime.frozen import Frozen, Repeats, RowSensors
from hts_go1_runtime.link import NOTHING, Command
from hts_go1_runtime.loop import Loop
from hts_go1_runtime.machine import STAND, Limits
from hts_go1_runtime.safety import Guard

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)
FREEZES = 5.0  # s: the robot walks by then
FIELDS = {
    "angular_velocity": "gyro",
    "projected_gravity": "quaternion",
    "joint_position of FL_thigh_joint": "q",
    "joint_velocity of FL_thigh_joint": "dq",
}
FL_THIGH = 4


class Freezing:
    """spoil of a scripted robot: from `FREEZES` on one field, of one joint where it is the joints', repeats itself."""

    def __init__(self, field: str, index: int | None = None, until: float = np.inf) -> None:
        self.field, self.index, self.until = field, index, until
        self.kept = None

    def __call__(self, state):
        if not FREEZES <= state.stamp < self.until:
            return state
        now = {"gyro": state.gyro, "quaternion": state.quaternion, "q": state.q, "dq": state.dq}[self.field]
        self.kept = now if self.kept is None else self.kept
        values = self.kept if self.index is None else np.where(np.arange(12) == self.index, self.kept, now)
        return dataclasses.replace(state, **{self.field: values})


@pytest.mark.parametrize("channel", FIELDS)
def test_a_sensor_that_freezes_while_a_row_is_recorded_stops_the_robot_and_is_named(channel, bundle, visit, capsys):
    index = FL_THIGH if "joint" in channel else None
    link = scripted.ScriptedLink(Freezing(FIELDS[channel], index))
    assert visit("--yes", link=link) == 3
    said = " ".join(capsys.readouterr().err.split())
    assert f"stopped: frozen sensor: {channel} has been " in said
    assert "to the last digit for 1" in said and "of moving, since time 5.00" in said and "restart the robot" in said
    stopped = next(at for at, command in link.sent if at > FREEZES and not command.kp.any())
    assert 0.099 <= stopped - FREEZES <= 0.2
    assert not list((bundle / "logs").glob("*.csv"))  # the row is walked again
    events = [json.loads(line) for line in (bundle / "logs" / "events.jsonl").read_text().splitlines()]
    assert next(one for one in events if one["what"] == "stopped")["reason"] == "frozen sensor"


def test_a_sensor_that_stands_still_for_a_moment_stops_nobody(visit):
    assert visit("--yes", link=scripted.ScriptedLink(Freezing("gyro", until=FREEZES + 0.08))) == 0


def test_0_seconds_let_a_sensor_stand_still_for_ever(visit):
    assert visit("--yes", "--frozen-seconds", "0", link=scripted.ScriptedLink(Freezing("gyro"))) == 0


def guarded(command, seconds=2.0, **kept):
    """What a guard says of a robot whose fields are kept, given command(second) every 20 ms."""
    guard, random = Guard(Limits(least_torque_share=0.0)), np.random.default_rng(0)
    for number in range(round(seconds / 0.004)):
        now = 0.004 * number
        if number % 5 == 0:
            guard.sent(command(now), now)
        state = dataclasses.replace(noisy(standing(number, now), random), received=now, **kept)
        if fault := guard.state(state):
            return now, fault
    return None


def swinging(joints):
    """Targets of some joints swing by 0.2 rad twice a second; the others' stay."""
    moved = np.isin(np.arange(12), joints)
    return lambda now: Command(STAND + 0.2 * moved * np.sin(4 * np.pi * now), np.full(12, 30.0), np.full(12, 0.6))


def test_a_robot_that_stands_still_may_repeat_itself():
    """A joint that holds its pose shows one number, as an encoder of a robot that is not moved does."""
    still = {"q": STAND, "dq": np.zeros(12), "gyro": np.zeros(3), "quaternion": np.array([1.0, 0, 0, 0])}
    assert guarded(swinging([]), **still) is None
    assert guarded(lambda now: NOTHING, **still) is None


def test_speeds_that_come_in_coarse_words_are_not_frozen():
    """A joint that moves by less than its word tells shows 0 all the time, whatever its target does."""
    assert guarded(swinging(range(12)), dq=np.zeros(12)) is None


def test_a_joint_is_frozen_only_while_its_own_target_moves():
    alone = np.arange(12) == 5
    random = np.random.default_rng(1)
    guard = Guard(Limits(least_torque_share=0.0))
    for number in range(500):
        now = 0.004 * number
        guard.sent(swinging([0, 1, 2])(now), now)
        state = noisy(standing(number, now), random)
        state = dataclasses.replace(state, received=now, q=np.where(alone, STAND, state.q))
        assert guard.state(state) is None


def test_what_is_constant_by_nature_is_no_frozen_sensor():
    """Feet, charge, voltage, current and temperatures of `standing` never change, nor does a torque at its limit."""
    assert guarded(swinging(range(12)), tau=np.full(12, 23.7)) is None


def test_frozen_is_said_once_the_targets_have_moved_and_of_all_that_stands_still():
    kept = {"gyro": np.array([0.1, 0.2, 0.3]), "quaternion": np.array([1.0, 0.0, 0.0, 0.0])}
    at, (reason, said) = guarded(lambda now: swinging(range(12))(max(0.0, now - 1.0)), **kept)
    assert reason == "frozen sensor" and 1.0 < at < 1.1
    assert said.startswith(
        "angular_velocity (and 1 more channels) has been (0.100, 0.200, 0.300) to the last digit for"
    )


def test_a_stamp_that_stands_still_is_a_lost_link_that_says_so():
    link = scripted.ScriptedLink(lambda state: dataclasses.replace(state, stamp=min(state.stamp, 0.3)))
    loop = Loop(link, 0.02, Limits())
    loop.start()

    def walk():
        for _ in range(100):
            loop.tick(lambda state: Command(STAND, np.full(12, 30.0), np.full(12, 0.6)))

    with pytest.raises(Stopped, match=r"lost link: states arrive 28 ms late, at most 24: their stamp stands at 0\.3"):
        walk()


# ---------------------------------------------------------------------- what only the robot gives


def said_of_log(bundle):
    """The mapping beside a bundle's first log, which is JSON."""
    return json.loads(min((bundle / "logs" / "mappings").glob("*.yaml")).read_text())


def test_a_pack_current_that_repeats_itself_for_seconds_of_a_row_ends_the_visit_sitting(change, visit, capsys):
    def edit(manifest):
        manifest["frozen"]["real_seconds"] = 0.4
        manifest["channels"]["battery_current"] = {"unit": "A", "size": 0, "real": True}

    bundle = change(edit)
    link = scripted.ScriptedLink(
        lambda state: dataclasses.replace(state, current=3.5) if state.stamp > FREEZES else state
    )
    assert visit("--yes", link=link) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "battery_current has been 3.5 to the last digit for 0.4 s of a row, since time " in said
    assert "reads it again" in said and "--frozen-real-seconds" in said
    assert '"sat down"' in (bundle / "logs" / "events.jsonl").read_text()
    assert not list((bundle / "logs").glob("*.csv"))
    assert visit("--yes", "--frozen-real-seconds", "0", link=scripted.ScriptedLink(link._spoil)) == 0
    assert said_of_log(bundle)["frozen_real_seconds"] == 0.0  # for who reads it


@pytest.mark.parametrize(("asked_for", "options"), [(False, ()), (True, ("--external", "battery_current"))])
def test_a_current_that_nobody_asked_for_or_that_another_sensor_logs_may_repeat_itself(
    change, visit, asked_for, options
):
    def edit(manifest):
        manifest["frozen"]["real_seconds"] = 0.4
        if asked_for:
            manifest["channels"]["battery_current"] = {"unit": "A", "size": 0, "real": True}

    change(edit)
    link = scripted.ScriptedLink(
        lambda state: dataclasses.replace(state, current=3.5) if state.stamp > FREEZES else state
    )
    assert visit("--yes", *options, link=link) == 0


def test_a_slow_monitor_and_one_that_nobody_reads_are_let_be():
    current = Repeats("battery_current", 3.0)
    for number in range(1000):
        current.see(3.0 + number // 50, 0.02 * number)  # one reading a second
        current.see(float("nan"), 0.02 * number)
    for number in range(1000, 1100):
        current.see(22.0, 0.02 * number)
    with pytest.raises(RuntimeFault, match=r"has been 22 to the last digit for 3\.0 s of a row, since time 19\.000"):
        current.see(22.0, 22.0)


STEPS = 0.02
"""s."""


def until_refused(velocity, speed=lambda now: 2.0, seconds=8.0, may=3.0):
    """When a row ends whose trunk has velocity(now), (3,), and whose joints all have speed(now); None: not at all."""
    sensors = RowSensors(["base_velocity"], 0.0, may)
    for number in range(round(seconds / STEPS)):
        now = STEPS * number
        shown = {"velocity": np.array(velocity(now)), "dq": np.full(12, speed(now))}
        try:
            sensors.see(dataclasses.replace(standing(number, now), received=now, **shown))
        except RuntimeFault as fault:
            return now, str(fault)
    return None


def test_a_speed_of_the_trunk_that_repeats_itself_while_the_joints_move_ends_the_row():
    at, said = until_refused(lambda now: (min(now, 2.0), 0.25, 0.0))
    assert at == pytest.approx(5.0)
    assert said.startswith("base_velocity has been (2, 0.25, 0) to the last digit for 3.0 s of a row, since time 2.000")
    assert "See that its sensor sees the robot all along the track" in said and "--frozen-real-seconds" in said
    assert until_refused(lambda now: (0.5, 0.0, now)) is None  # one of its numbers changes
    assert until_refused(lambda now: (int(now), 0.0, 0.0)) is None  # a camera of one a second
    assert until_refused(lambda now: (0.5, 0.0, 0.0), may=0.0) is None
    assert until_refused(lambda now: (np.nan,) * 3, seconds=2.9) is None  # who has none at all is told so


def test_seconds_in_which_the_robot_stands_are_no_reason_for_its_speed_to_change():
    """It stands from 1 to 5 s, and of these still walks in the mean over the last second until 1.94."""
    stops = (lambda now: (0.0, 0.0, 0.0)), (lambda now: 2.0 * (not 1.0 <= now < 5.0))
    assert until_refused(*stops, seconds=5.0) is None
    at, said = until_refused(*stops)
    assert 5.9 < at < 6.2 and "3.0 s of a row, since time 0.000" in said


def still_from(moment):
    return lambda state: dataclasses.replace(state, velocity=np.full(3, 0.5)) if state.stamp > moment else state


WALKING = 6.5
"""s: the trimming of the first row is over."""


def test_a_tracker_that_loses_the_robot_within_a_row_ends_the_visit_sitting(change, visit, capsys):
    bundle = change(lambda manifest: manifest["frozen"].__setitem__("real_seconds", 0.4))
    assert visit("--yes", link=scripted.ScriptedLink(still_from(WALKING))) == 2
    shown = capsys.readouterr()
    assert "base_velocity has been (0.5, 0.5, 0.5) to the last digit for 0.4 s of a row" in shown.err
    assert "sat down" in shown.out and not list((bundle / "logs").glob("*.csv"))


def test_first_data_are_not_compared_so_their_speed_may_repeat_itself(change, visit):
    def edit(manifest):
        manifest["frozen"]["real_seconds"] = 0.4
        for row in manifest["rows"]:
            row["role"] = "collection"

    change(edit)
    assert visit("--yes", link=scripted.ScriptedLink(still_from(0.5))) == 0


# ---------------------------------------------------------------------- the bundle's word


def test_a_bundle_of_before_the_key_is_read_with_the_defaults(change):
    assert load_bundle(change(lambda manifest: manifest.pop("frozen"))).frozen == FrozenSeconds(0.1, 3.0)


@pytest.mark.parametrize("value", [-1.0, float("nan"), 601.0, "long", None])
def test_seconds_that_make_no_sense_are_refused_with_the_bundle(change, value):
    with pytest.raises(RuntimeFault, match=r"frozen\.seen_seconds .*expected 0|not a whole manifest"):
        load_bundle(change(lambda manifest: manifest["frozen"].__setitem__("seen_seconds", value)))


def test_a_bundle_says_how_long_a_sensor_may_stand_still(change, visit):
    change(lambda manifest: manifest["frozen"].__setitem__("seen_seconds", 0.0))
    assert visit("--yes", link=scripted.ScriptedLink(Freezing("gyro"))) == 0


def test_frozen_looks_at_nothing_before_a_command_holds_a_position():
    frozen = Frozen(0.1)
    assert [frozen.state(dataclasses.replace(standing(n, 0.0), received=0.1 * n)) for n in range(5)] == [""] * 5
