"""Realities: what is drawn, what is held against facts, and batches of draws."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hts import plugins
from hts.contracts import Fact
from hts.errors import ConfigError, RunError
from hts.worlds.realities import batch as batch_module
from hts.worlds.realities.batch import Asked, draw_many, parameters_of
from hts.worlds.realities.check import Tried, Verdict, check
from hts.worlds.realities.draw import draw
from hts.worlds.realities.posterior import narrowed, reasons
from hts.worlds.realities.quick import standing_values
from hts.worlds.realities.ranges import drawn_parameters, instruments_in, switches, table
from hts.worlds.twin.model import build
from hts.worlds.twin.parameters import TwinSettings
from hts.worlds.twin.reality import Reality, known_names, locate, read, sha256

ROOT = Path(__file__).parents[2]
SWITCHES = {
    *("motor_spread", "saturation", "transmission", "sag", "link", "floor", "payload", "wind"),
    *("converter", "own_regeneration", "idle_wander", "low_pass"),
}


# ----------------------------------------------------------------------------------------------- drawing


def test_the_same_seed_and_index_give_the_same_draw_and_others_do_not(parameters):
    assert draw(parameters, "a", 3) == draw(parameters, "a", 3)
    assert draw(parameters, "a", 3).values != draw(parameters, "a", 4).values
    assert draw(parameters, "a", 3).values != draw(parameters, "b", 3).values


def test_a_parameter_that_a_plugin_adds_changes_none_of_the_others(parameters):
    without = [one for one in parameters if not one.key.startswith("instruments.microphone")]
    whole, part = draw(parameters, "a", 0), draw(without, "a", 0)
    assert {key: whole.values[key] for key in part.values} == part.values


def test_every_parameter_with_a_range_is_drawn_inside_it(parameters):
    keys = {one.key for one in parameters}
    assert {"dynamics.floor_friction", "sensors.gyro_noise", "instruments.battery_gauge.phase_resistance"} <= keys
    assert not {"dynamics.physics_dt", "instruments.microphone.distance", "instruments.battery_gauge.cells"} & keys
    for index in range(40):
        values = draw(parameters, "inside", index).values
        for one in parameters:
            for value in np.atleast_1d(values.get(one.key, one.low)):
                assert one.low <= value <= one.high, one.key


def test_a_range_of_decades_is_drawn_evenly_in_its_logarithm(parameters):
    (one,) = [one for one in parameters if one.key == "instruments.battery_gauge.window"]
    drawn = np.array([draw([one], "log", index).values[one.key] for index in range(400)])
    assert np.median(drawn) == pytest.approx((0.003 * 0.5) ** 0.5, rel=0.2)
    (plain,) = [one for one in parameters if one.key == "dynamics.floor_friction"]
    drawn = np.array([draw([plain], "uniform", index).values[plain.key] for index in range(400)])
    assert drawn.mean() == pytest.approx(0.8, abs=0.05)


def test_each_structure_is_on_in_half_of_the_draws_and_off_means_its_default(parameters):
    assert set(switches(parameters)) == SWITCHES
    drawn = [draw(parameters, "coins", index) for index in range(300)]
    for name in SWITCHES:
        assert np.mean([name in one.switches for one in drawn]) == pytest.approx(0.5, abs=0.1), name
    fields = {name: [one.key for one in parameters if one.switch == name] for name in SWITCHES}
    assert {key.split(".")[0] for key in fields["motor_spread"]} == {"dynamics", "instruments"}
    for one in drawn[:20]:
        for name, keys in fields.items():
            assert all((key in one.values) == (name in one.switches) for key in keys)


def test_modes_are_as_many_frequencies_as_dampings_and_ascending(parameters):
    counts = set()
    for index in range(30):
        values = draw(parameters, "modes", index).values
        frequencies = values["instruments.microphone.frequencies"]
        assert len(frequencies) == len(values["instruments.microphone.dampings"])
        assert frequencies == sorted(frequencies)
        counts.add(len(frequencies))
    assert counts == {6, 7, 8, 9, 10}


def test_a_draw_is_a_whole_set_of_parameters_that_the_twin_and_its_instruments_take(registry, parameters):
    robot = registry.make_robot("go1")
    for index in range(6):
        drawn = draw(parameters, "whole", index)
        content = parameters_of(drawn, registry)
        settings = TwinSettings.model_validate(content)
        assert settings.dynamics.structure.torque_follows_supply == ("sag" in drawn.switches)
        gauge = registry.make_instrument("battery_gauge", settings.instruments["battery_gauge"], robot)
        assert gauge.describe()["idle_power"] == drawn.values["instruments.battery_gauge.idle_power"]
        assert content["instruments"]["battery_gauge"]["cells"] == 6  # also what is not drawn


def test_the_documented_ranges_are_those_of_the_fields(parameters):
    assert table(parameters) in (ROOT / "docs" / "realities.md").read_text(encoding="utf-8")


def test_a_plugins_instrument_brings_its_own_parameters(install):
    source = (
        "from pydantic import BaseModel, ConfigDict\n"
        "from hts import hookimpl\n"
        "from hts.contracts import parameter, structural\n"
        "HTS_API = 2\n"
        "class Meter(BaseModel):\n"
        "    model_config = ConfigDict(frozen=True, extra='forbid')\n"
        "    zero: float = parameter(0.0, -1.0, 1.0, 'K', 'E', 'zero error')\n"
        "    drifts: bool = structural('drift', 'E', 'whether it drifts')\n"
        "def make(settings, robot):\n"
        "    return Meter.model_validate(dict(settings))\n"
        "@hookimpl\n"
        "def hts_instruments(register):\n"
        "    register('thermometer', make)\n"
    )
    install("hts_heat", {"hts_heat": source}, {"heat": "hts_heat"})
    found = drawn_parameters(plugins.load())
    assert {"instruments.thermometer.zero", "instruments.thermometer.drifts"} <= {one.key for one in found}
    assert "drift" in switches(found) and instruments_in(found)[-1] == "thermometer"
    values = [draw(found, "x", index).values for index in range(20)]
    assert all(-1 <= one["instruments.thermometer.zero"] <= 1 for one in values)
    assert {one.get("instruments.thermometer.drifts", False) for one in values} == {True, False}


# ------------------------------------------------------------------------------------------------- facts


class Meter:
    """An instrument that shows one number, for facts about it."""

    def __init__(self, value, *facts):
        self.value, self._facts = value, facts
        self.channels = ()

    def facts(self):
        return self._facts

    def reset(self, num_worlds, rng):
        self.num = num_worlds

    def step(self, sample):
        self.torque = sample.motor_torque

    def read(self):
        return {"x": np.full(self.num, self.value)}

    def idle(self):
        return {}

    def settle(self):
        pass

    def conditions(self):
        return {}

    def supply(self):
        return None


def fact(low, high, speed=0.0) -> Fact:
    return Fact(f"x at {speed:g}", speed, low, high, "K", "E", lambda channels, idle: float(channels["x"].mean()))


def test_a_robot_in_a_single_module_brings_no_realities_and_hides_none(install):
    source = (
        "from hts import hookimpl\n"
        "HTS_API = 2\n"
        "def make(settings):\n"
        "    raise AssertionError\n"
        "@hookimpl\n"
        "def hts_robots(register):\n"
        "    register('alone', make)\n"
    )
    before = known_names()
    install("hts_alone", {"hts_alone": source}, {"alone": "hts_alone"})
    assert known_names() == before != {}


def test_statics_drop_a_draw_that_stands_far_outside_without_simulating_it(registry, tmp_path):
    twin = Tried(registry.make_robot("go1"), TwinSettings(), {"x": Meter(10.0, fact(1.0, 2.0))})
    verdict = check(twin, tmp_path / "no policy.onnx")
    assert not verdict.kept and verdict.why == "x at 0 10 K by statics"


def test_a_robot_of_which_there_is_no_twin_ends_the_draws_and_drops_none(registry, tmp_path):
    class Spoilt(type(registry.make_robot("go1"))):
        def mjcf(self):
            root = super().mjcf()
            root.find("joint", "FL_calf_joint").name = "FL_knee"
            return root

    robot = Spoilt(registry.make_robot("go1").settings)
    with pytest.raises(ConfigError, match="its model has no joint 'FL_calf_joint'"):
        check(Tried(robot, TwinSettings(), {}), tmp_path / "never_asked.onnx")


def test_statics_stand_as_the_default_twin_does_in_simulation(registry):
    robot = registry.make_robot("go1")
    gauge = registry.make_instrument("battery_gauge", {}, robot)
    values = standing_values(build(robot, TwinSettings().dynamics), {"battery_gauge": gauge}, gauge.facts(), 0.001)
    assert values["standing"] == pytest.approx(58.0, rel=0.05)  # docs/twin.md


def test_only_the_robot_that_facts_are_known_of_is_held_against_them(registry):
    gauge = registry.make_instrument("battery_gauge", {}, registry.make_robot("go1"))
    names = [one.name for one in gauge.facts()]
    assert names == ["standing", "idle share at 0.5 m/s", "idle share at 0.8 m/s", "idle share at 1.1 m/s"]
    bounds = {one.name: (one.low, one.high) for one in gauge.facts()}
    assert bounds["standing"] == (53.0, 65.0)
    assert bounds["idle share at 0.5 m/s"] == pytest.approx((0.2325, 0.3875))


# ------------------------------------------------------------------------------------------- many of them


def pretend(kept):
    """`one_draw` that keeps the indices of `kept`, and counts how often it is asked."""
    asked = []

    def one_draw(what, index):
        asked.append(index)
        line = {"index": index, "kept": index in kept, "why": "" if index in kept else "no", "values": {"a": index}}
        reality = Reality(name="", robot="go1", seed=what.seed, index=index, switches=(), parameters={})
        return line, reality.model_dump_json() if index in kept else ""

    return one_draw, asked


@pytest.fixture
def in_one_process(monkeypatch):
    """Draws without processes; returns a function that says which indices are kept."""

    def use(kept):
        one_draw, asked = pretend(kept)

        def in_order(what, first, processes):
            index = first
            while True:
                yield one_draw(what, index)
                index += 1

        monkeypatch.setattr(batch_module, "_in_order", in_order)
        return asked

    return use


ASKED = Asked(count=3, seed="s", robot="go1", name="some", policy="p.onnx")


def test_draws_go_on_until_enough_are_kept_and_say_why_the_others_are_not(tmp_path, in_one_process):
    in_one_process({2, 3, 7, 9})
    told = []
    files = draw_many(ASKED, tmp_path / "out", tell=lambda line, kept: told.append(kept))
    assert [path.name for path in files] == ["some-00.json", "some-01.json", "some-02.json"]
    assert [read(str(path)).index for path in files] == [2, 3, 7]
    assert [read(str(path)).name for path in files] == ["some-00", "some-01", "some-02"]
    lines = [json.loads(line) for line in (tmp_path / "out" / "draws.jsonl").read_text().splitlines()]
    assert [line["index"] for line in lines[1:]] == list(range(8))
    assert told == ["", "", "some-00", "some-01", "", "", "", "some-02"]


def test_draws_go_on_where_they_stopped(tmp_path, in_one_process):
    asked = in_one_process({2, 3, 7})
    draw_many(Asked(2, "s", "go1", "some", "p"), tmp_path / "out")
    with (tmp_path / "out" / "draws.jsonl").open("a") as file:
        file.write('{"index": 4, "kept": tr')  # killed in the midst of a line
    del asked[:]
    files = draw_many(ASKED, tmp_path / "out")
    assert asked == [4, 5, 6, 7]
    assert [read(str(path)).index for path in files] == [2, 3, 7]
    del asked[:]
    assert draw_many(ASKED, tmp_path / "out") == files
    assert asked == []


def test_killed_draws_leave_no_process_behind():
    worker = (
        "import os, time; from hts.worlds.realities.workers import end_with; "
        "end_with(os.getppid()); print(os.getpid(), flush=True); time.sleep(600)"
    )
    code = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {worker!r}])"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        child = int(parent.stdout.readline())
        parent.kill()
    for _ in range(600):
        try:
            if Path(f"/proc/{child}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z":
                return
        except OSError:  # it is gone, if need be while it is looked at
            return
        time.sleep(0.1)
    os.kill(child, signal.SIGKILL)
    pytest.fail("the worker was still there a minute after its parent was killed")


def test_draws_of_another_seed_do_not_mix(tmp_path, in_one_process):
    in_one_process({0, 1, 2})
    draw_many(ASKED, tmp_path / "out")
    with pytest.raises(RunError, match="another seed") as error:
        draw_many(Asked(3, "other", "go1", "some", "p"), tmp_path / "out")
    assert "\n" not in str(error.value)


def test_a_folder_with_other_things_in_it_is_left_alone(tmp_path, in_one_process):
    in_one_process({0})
    (tmp_path / "mine.txt").write_text("x")
    with pytest.raises(RunError, match="not empty"):
        draw_many(ASKED, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_a_range_that_the_facts_narrow_stands_out_and_others_do_not(parameters):
    lines = []
    for index in range(200):
        values = dict(draw(parameters, "narrow", index).values)
        kept = values["instruments.battery_gauge.phase_resistance"] < 0.115
        lines.append({"index": index, "kept": kept, "why": "" if kept else "standing 80 W", "values": values})
    first, *others = narrowed(parameters, lines)
    assert first.key == "instruments.battery_gauge.phase_resistance" and first.z < -6
    assert first.prior == pytest.approx((0.1225, 0.145, 0.1675))
    assert max(first.posterior) < 0.115
    assert np.mean([abs(one.z) < 2 for one in others]) > 0.9


@pytest.mark.parametrize(
    ("why", "kind"),
    [
        ("standing 79.9 W", "standing"),
        ("standing 79.9 W by statics", "standing, by statics"),
        ("idle share at 0.5 m/s 0.2 1 and idle share at 0.8 m/s 0.1 1", "idle share"),
        ("fell at 0.5, 0.8 m/s", "a fall"),
    ],
)
def test_reasons_are_counted_without_their_numbers(why, kind):
    assert dict(reasons([{"kept": False, "why": why}, {"kept": True, "why": ""}])) == {kind: 1, "kept": 1}


# ------------------------------------------------------------------------------------ the development ones


def test_the_development_realities_come_with_the_robot_and_are_what_was_drawn(registry, parameters):
    names = known_names()
    dev = [f"dev-{number:02d}" for number in range(16)]
    assert set(dev) <= set(names)
    lines = (ROOT / "docs" / "results" / "realities" / "draws.jsonl").read_text().splitlines()
    heading, *draws = (json.loads(line) for line in lines)
    kept = [one for one in draws if one["kept"]]
    assert len(kept) == 16
    hashes = dict(
        line.split()[::-1] for line in (ROOT / "docs" / "results" / "realities" / "SHA256SUMS").read_text().splitlines()
    )
    for name, line in zip(dev, kept, strict=True):
        reality = read(name)
        assert (reality.name, reality.robot, reality.seed, reality.index) == (
            name,
            "go1",
            heading["seed"],
            line["index"],
        )
        assert hashes[f"{name}.json"] == sha256(locate(name))
        assert all(one.low <= one.value <= one.high for one in reality.facts) and len(reality.facts) == 4
        drawn = draw(parameters, heading["seed"], line["index"])
        assert reality.parameters == parameters_of(drawn, registry)
        assert dict(drawn.values) == line["values"]


def test_a_verdict_without_a_reason_is_a_kept_one():
    assert Verdict((), "").kept and not Verdict((), "fell at 0.5 m/s").kept
