"""Figures of a lab's own recordings, and draws that are held against them instead of public facts."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from hts import plugins
from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.contracts import Reading, WorldContext
from hts.errors import RecordingError, RunError
from hts.recordings.recording import Recording, Series
from hts.recordings.store import RecordingStore
from hts.worlds.realities import batch as batch_module
from hts.worlds.realities.batch import Asked, draw_many, exported_policy
from hts.worlds.realities.check import check
from hts.worlds.realities.like import MOST, likeness, recorded, table, tolerance
from hts.worlds.realities.posterior import accepted
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


def test_the_tolerance_is_where_the_next_stretch_lies():
    # s = 1 over four values, t_3 = 3.182: 3.182 x 1 x sqrt(1 + 1/4) = 3.558
    values = [99.0, 101.0, 99.0, 101.0]
    s = np.std(values, ddof=1)
    assert tolerance(values) == pytest.approx(max(3.1824 * s * np.sqrt(1.25), 5.0), rel=1e-3)
    assert tolerance([20.0, 22.0, 18.0, 20.0, 21.0]) == pytest.approx(2.776 * 1.4832 * np.sqrt(1.2), rel=1e-3)
    assert tolerance([100.0]) == 5.0 and tolerance([100.0, 100.0]) == 5.0
    assert tolerance([50.0, 150.0]) == MOST * 100.0


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


def test_a_draw_whose_idle_level_is_another_is_dropped_before_anything_is_simulated(tmp_path):
    registry = plugins.load()
    robot = registry.make_robot("go1")
    gauge = registry.make_instrument("battery_gauge", {}, robot)
    level = gauge.idle()["battery_current"] * gauge.idle()["battery_voltage"]
    walk = made([4.0, 5.0])
    power = {"battery_current": walk.channels["current"], "battery_voltage": walk.channels["voltage"]}
    idle = {"battery_current": 1.3 * level / 25.0, "battery_voltage": 25.0}
    asked = likeness([walk.replace(channels=power, idle=idle)], "go1", WALKER, {"battery_gauge": gauge})
    verdict = check(robot, TwinSettings(), {"battery_gauge": gauge}, tmp_path / "no policy.onnx", asked)
    assert not verdict.kept and verdict.why.startswith("idle power")


# ------------------------------------------------------------------------------------------ a folder of draws


def test_a_folder_is_gone_on_with_only_by_the_figures_it_was_begun_with(tmp_path, monkeypatch):
    def in_order(asked, first, processes):
        for index in range(first, 100):
            yield {"index": index, "kept": False, "why": "idle power 30 W", "measured": {}}, ""

    monkeypatch.setattr(batch_module, "_in_order", in_order)
    ours = like(made([4.0, 5.0]))
    asked = Asked(1, "s", "go1", "mine", "", ours)
    draw_many(asked, tmp_path / "mine")
    heading = json.loads((tmp_path / "mine/draws.jsonl").read_text().splitlines()[0])
    assert [one["name"] for one in heading["like"]["figures"]] == [one.name for one in ours.figures]
    assert accepted(tmp_path / "mine") == "kept 0 of 100 draws (0.00%); ended by idle power (100)"
    draw_many(asked, tmp_path / "mine")
    with pytest.raises(RunError, match="was begun with other figures of a robot"):
        draw_many(dataclasses.replace(asked, like=ours.model_copy(update={"schedule": None})), tmp_path / "mine")
    with pytest.raises(RunError, match="was begun with other figures of a robot"):
        draw_many(dataclasses.replace(asked, like=None), tmp_path / "mine")


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
    from hts.policies.deploy import DeployedPolicy
    from hts.worlds.twin.reality import read

    recordings = [store.read(one) for one in store.ids()]
    said = recorded(recordings, "go1", DeployedPolicy(policy).card.policy_hash, registry)
    assert "net power at 0.8 m/s" in table(said.figures) and said.schedule == schedule

    def verdict(settings):
        made = {name: registry.make_instrument(name, given, robot) for name, given in settings.instruments.items()}
        return check(robot, settings, made, Path(policy), said)

    own = verdict(TwinSettings.model_validate(dict(read("dev-04").parameters)))
    assert own.kept, own.why
    assert not verdict(TwinSettings.model_validate({"instruments": {"battery_gauge": {"idle_power": 24.0}}})).kept
