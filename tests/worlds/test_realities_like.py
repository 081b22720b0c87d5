"""Figures of a lab's own recordings, and draws that are held against them instead of public facts."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hts import plugins
from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.contracts import Reading, WorldContext
from hts.errors import RecordingError
from hts.recordings.recording import Recording, Series
from hts.recordings.store import RecordingStore
from hts.worlds.realities.batch import exported_policy
from hts.worlds.realities.check import Tried
from hts.worlds.realities.like import MOST, likeness, of_store, recorded, table, tolerance
from hts.worlds.realities.misfit import free_distance, misfit
from hts.worlds.twin.parameters import TwinSettings
from hts.worlds.twin.world import make_twin

RATE = 50.0
WALKER = "a" * 64


class Meter:
    """An instrument of current and voltage that never comes to be stepped."""

    def readings(self):
        channels = ("current", "voltage")
        return (
            Reading("idle power", "W", channels, lambda c, idle: idle["current"] * idle["voltage"], idle=True),
            Reading("gross power", "W", channels, lambda c, idle: float((c["current"] * c["voltage"]).mean())),
        )


def made(amps, *, speeds=(0.5, 0.8), seconds=8.0, hash_=WALKER, moving=5.0, **changes) -> Recording:
    """A recording of so many amperes at each speed; 25 V, idle 1 A; the first 3 s of each stretch are nonsense."""
    commands = tuple(Command(seconds=seconds, vx=speed) for speed in speeds)
    rows = [np.full(round(seconds * RATE), level, float) for level in amps]
    for row in rows:
        row[: round(3 * RATE)] = 900.0
    current = np.concatenate(rows)
    count = len(current)
    velocity = np.zeros((count, 3))
    velocity[:, 0] = np.repeat(speeds, round(seconds * RATE)) * 0.9
    series = {
        "current": Series(Channel("current", "A"), current),
        "voltage": Series(Channel("voltage", "V"), np.full(count, 25.0)),
        "base_velocity": Series(Channel("base_velocity", "m/s", (3,)), velocity),
        "joint_velocity": Series(Channel("joint_velocity", "rad/s", (2,)), np.full((count, 2), moving)),
    }
    one = Recording(
        robot="go1",
        world="field",
        policy_hash=hash_,
        iteration=0,
        joint_names=("a", "b"),
        kp=(1.0, 1.0),
        kd=(1.0, 1.0),
        rate_hz=RATE,
        schedule=ScheduleConfig(commands=commands),
        idle={"current": 1.0, "voltage": 25.0},
        clock="monotonic",
        time=np.arange(count) / RATE,
        channels=series,
    )
    return dataclasses.replace(one, **changes)


def found(*recordings):
    return {one.name: one for one in like(*recordings).figures}


def like(*recordings):
    return likeness(recordings, "go1", WALKER, {"meter": Meter()})


def test_figures_are_means_over_stretches_without_their_beginnings():
    one = found(made([4.0, 5.0]), made([4.2, 5.0]))
    assert one["idle power"].value == 25.0 and one["idle power"].idle
    assert one["gross power at 0.5 m/s"].value == pytest.approx(102.5)  # (4.0 + 4.2) / 2 A x 25 V
    assert one["gross power at 0.8 m/s"].value == pytest.approx(125.0)
    assert one["speed at 0.8 m/s"].value == pytest.approx(0.72, abs=1e-3)
    assert (one["gross power at 0.5 m/s"].stretches, one["gross power at 0.5 m/s"].speed) == (2, 0.5)
    assert "standing" not in " ".join(one)


def test_a_stretch_is_found_by_the_clock_where_samples_are_missing():
    whole = made([4.0, 5.0], speeds=(0.5, 0.8))
    there = np.r_[:200, 350:800]  # from 4 s to 7 s nothing was received: 2 s of the first stretch are left to read
    cut = {name: Series(one.channel, one.values[there]) for name, one in whole.channels.items()}
    one = found(whole.replace(time=whole.time[there], channels=cut))
    assert one["gross power at 0.5 m/s"].value == pytest.approx(100.0)
    assert one["gross power at 0.8 m/s"].value == pytest.approx(125.0)


def test_the_tolerance_is_where_the_next_stretch_lies_and_a_share_for_what_no_twin_has():
    # t_4 = 2.776, s = 1.4832: 2.776 x 1.4832 x sqrt(1 + 1/5) = 4.510, and 5 % of 40.2
    values = [40.0, 42.0, 38.0, 40.0, 41.0]
    assert tolerance(values) == pytest.approx(4.510 + 2.01, rel=1e-3)
    assert tolerance(values, 0.02) == pytest.approx(4.510 + 0.804, rel=1e-3)
    assert tolerance([100.0]) == 5.0 and tolerance([100.0, 100.0]) == 5.0 and tolerance([100.0], 0.4) == 40.0
    assert tolerance([50.0, 150.0]) == MOST * 100.0


def test_what_the_ends_of_a_figure_are_is_said_below_the_table(tmp_path, monkeypatch, capsys):
    from hts.cli.realities import _likeness
    from hts.worlds.realities import like

    nothing = like.Likeness(figures=(), schedule=None)
    monkeypatch.setattr(like, "of_store", lambda *given: nothing)
    assert _likeness(tmp_path, "go1", tmp_path / "policy", 0.05) is nothing
    said = capsys.readouterr().err
    assert "within a session and from one to the next taken together, and 5% of the mean on top" in said
    assert "not the error of a sensor" in said


def test_standing_is_a_command_of_zero_in_which_no_joint_moves():
    still = made([2.2], speeds=(0.0,), moving=0.01, hash_="")
    stepping = made([3.0], speeds=(0.0,), moving=4.0, hash_="")
    one = found(made([4.0, 5.0]), still, stepping)
    assert one["gross power standing"].value == pytest.approx(55.0) and one["gross power standing"].speed == 0.0


def test_recordings_of_head_to_heads_come_before_those_that_began_cold():
    one = found(made([4.0, 5.0]), made([4.4, 5.4], role="reference"))
    assert one["gross power at 0.5 m/s"].value == pytest.approx(110.0)
    assert like(made([4.0, 5.0]), made([4.4, 5.4], role="reference")).schedule is None


def test_of_collections_the_usual_schedule_counts_and_is_kept_to_walk_it_again():
    usual, other = made([4.0, 5.0]), made([9.0], speeds=(0.5,))
    both = like(usual, other, made([4.2, 5.0]))
    assert both.schedule == usual.schedule
    assert {one.name: one.value for one in both.figures}["gross power at 0.5 m/s"] == pytest.approx(102.5)


def test_what_was_sent_is_the_speed_of_a_figure_where_the_command_was_trimmed():
    recording = made([4.0], speeds=(0.8,))
    sent = np.zeros((recording.num_samples, 3))
    sent[:, 0] = 0.85
    with_command = {**recording.channels, "command": Series(Channel("command", "1", (3,)), sent)}
    one = found(recording.replace(channels=with_command))
    assert one["gross power at 0.85 m/s"].speed == 0.85


def test_other_policies_falls_and_turns_say_nothing():
    turning = made([9.0], speeds=(0.5,))
    turning = turning.replace(schedule=ScheduleConfig(commands=(Command(seconds=8.0, vx=0.5, yaw_rate=0.3),)))
    one = found(made([4.0, 5.0]), made([9.0, 9.0], hash_="b" * 64), made([9.0, 9.0], fell=True), turning)
    assert one["gross power at 0.5 m/s"].value == pytest.approx(100.0)


def test_a_store_that_can_say_nothing_is_refused_in_one_line():
    with pytest.raises(RecordingError, match="No recording of robot 'go1' that did not fall; found: go2"):
        found(made([4.0, 5.0], robot="go2"))
    with pytest.raises(RecordingError, match=f"the policy {WALKER[:12]} walked; found recordings of bbbbbbbbbbbb"):
        found(made([4.0, 5.0], hash_="b" * 64))
    with pytest.raises(RecordingError, match=r"hold nothing that an installed instrument shows.*battery_current"):
        recorded([made([4.0, 5.0])], "go1", WALKER, plugins.load())


def test_a_draw_whose_idle_level_is_another_is_dropped_before_anything_is_simulated():
    registry = plugins.load()
    robot = registry.make_robot("go1")
    gauge = registry.make_instrument("battery_gauge", {}, robot)
    level = gauge.idle()["battery_current"] * gauge.idle()["battery_voltage"]
    walk = made([4.0, 5.0])
    power = {"battery_current": walk.channels["current"], "battery_voltage": walk.channels["voltage"]}
    idle = {"battery_current": 1.3 * level / 25.0, "battery_voltage": 25.0}
    asked = likeness([walk.replace(channels=power, idle=idle)], "go1", WALKER, {"battery_gauge": gauge})
    # 0.3 / 1.3 of what was read off is 4.6 times the tolerance of 5 %
    assert free_distance(asked.figures, {"battery_gauge": gauge}) == pytest.approx(0.3 / 1.3 / 0.05, rel=1e-3)
    found = misfit(Tried(robot, TwinSettings(), {"battery_gauge": gauge}), "no policy.onnx", asked, 1.0)
    assert found.distance == np.inf and found.why.startswith("idle power")


@pytest.mark.slow
def test_a_reality_agrees_with_its_own_logs_and_the_default_twin_does_not(tmp_path):
    """Logs as hts collects them from a development reality; the figures, then both twins held against them."""
    registry = plugins.load()
    robot = registry.make_robot("go1")
    policy = exported_policy("go1", tmp_path)
    context = WorldContext("go1", {}, {"power": {}}, 3, tmp_path / "world", registry)
    world = make_twin({"reality": "dev-04"}, context)
    schedule = ScheduleConfig(commands=(Command(seconds=10.0, vx=0.5), Command(seconds=10.0, vx=0.8)))
    try:
        store = RecordingStore(tmp_path / "lab.zarr", create=True)
        for one in world.collect([policy] * 3, schedule):
            store.write(one)
    finally:
        world.close()
    from hts.worlds.twin.reality import read

    said = of_store(tmp_path / "lab.zarr", "go1", policy, registry)
    assert "net power at 0.8 m/s" in table(said.figures) and said.schedule == schedule

    def away(settings):
        made = {name: registry.make_instrument(name, given, robot) for name, given in settings.instruments.items()}
        return misfit(Tried(robot, settings, made), str(policy), said)

    own = away(TwinSettings.model_validate(dict(read("dev-04").parameters)))
    assert own.distance <= 1, own.why
    assert away(TwinSettings.model_validate({"instruments": {"battery_gauge": {"idle_power": 24.0}}})).distance > 1
