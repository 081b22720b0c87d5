"""The truth on a reality: no noise in it, the same for any number of processes, and out of reach of what learns."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from hts import plugins
from hts.cli.main import main
from hts.contracts import HoldSpeed, Instrument, WorldContext
from hts.errors import ConfigError, UnfitWorldError
from hts.evaluation.evaluate import in_sessions
from hts.evaluation.held import ask_to_hold
from hts.worlds.realities import truth as truth_module
from hts.worlds.realities.batch import exported_policy
from hts.worlds.realities.truth import Exact, Truth, Walked, truth
from hts.worlds.twin.world import make_twin

pytest.importorskip("hts_go1", reason="the robot of these sessions is not installed")
pytest.importorskip("hts_power", reason="their objective is not installed")


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    """The shipped policy against itself, as short as it can be."""
    policy = str(exported_policy("go1", tmp_path_factory.mktemp("policy")))
    return Truth("go1", "power", {}, policy, policy, "dev-03", (0.8,), 2, warmup=2.0, trimming=4.0, block=5.0)


@pytest.fixture(scope="module")
def found(asked):
    return truth(asked)


def test_a_policy_saves_nothing_against_itself(found):
    at = found["speeds"]["0.8"]
    assert found["unit"] == "1" and at["sessions"] == found["sessions"] == 2
    assert abs(at["improvement"]) < 0.1  # four blocks of 3 s are noisy walks, though nothing measures them wrongly
    assert at["improvement_ci95"][0] < at["improvement"] < at["improvement_ci95"][1]
    assert at["mean_speed"] == pytest.approx(0.8, abs=0.05) and at["falls"] == at["at_limit"] == 0
    assert set(at["metrics"]) >= {"net_reduction", "cost_of_transport_reduction"}


def test_who_is_simulated_together_does_not_hang_on_the_machine(asked, monkeypatch):
    groups = []

    def fake(given, group):
        groups.append(group)
        row = {"net_power": 50.0, "gross_power": 80.0, "cost_of_transport": 0.5, "speed": 0.8, "falls": 1.0}
        row["pieces"] = 8.0
        means = {"policy": {**row, "saturated": 0.0}, "reference": {**row, "net_power": 100.0, "saturated": 1.0}}
        counted = {"policy": np.array([60.0, 90.0, 0.6]), "reference": np.array([80.0, 110.0, 0.8])}
        return [(0.8, Walked(means, counted, {"policy": 6, "reference": 8})) for _ in group]

    monkeypatch.setattr(truth_module, "one_group", fake)
    at = truth(replace(asked, sessions=13))["speeds"]["0.8"]
    assert groups == [range(6), range(6, 12), range(12, 13)]
    assert (at["sessions"], at["falls"], at["at_limit"]) == (13, 13, 13)
    assert at["improvement"] == 0.5 and at["improvement_ci95"] == pytest.approx([0.5, 0.5])
    assert at["counted"] == {
        "improvement": 0.25,
        "improvement_ci95": pytest.approx([0.25, 0.25]),
        "valid": 0.75,
        "reference_valid": 1.0,
    }


def test_pieces_that_no_head_to_head_would_count_are_in_the_truth_and_not_in_what_is_counted(asked):
    strict = truth(replace(asked, tolerance=0.03))["speeds"]["0.8"]
    loose = truth(replace(asked, tolerance=1.0))["speeds"]["0.8"]
    assert strict["improvement"] == loose["improvement"]
    assert 0.0 < strict["counted"]["valid"] < loose["counted"]["valid"] == 1.0
    assert strict["counted"]["improvement"] != strict["improvement"]
    none = truth(replace(asked, tolerance=0.0))["speeds"]["0.8"]
    assert none["counted"] is None and none["improvement"] == strict["improvement"]


def test_fewer_than_two_sessions_are_no_truth(asked):
    with pytest.raises(ConfigError, match="two at least"):
        truth(replace(asked, sessions=1))


def test_an_instrument_that_cannot_tell_is_named():
    class Silent(Instrument):
        channels = ()

        def reset(self, num_worlds, rng): ...
        def step(self, sample): ...
        def read(self):
            return {}

        def idle(self):
            return {}

    with pytest.raises(UnfitWorldError, match="Instrument 'ear' does not tell its quantity"):
        Exact("ear", Silent())


@pytest.mark.parametrize("name", ["battery_gauge", "microphone"])
def test_our_instruments_tell_what_objectives_measure(name):
    registry = plugins.load()
    if name not in registry.instruments:
        pytest.skip(f"instrument {name} is not installed")
    made = registry.make_instrument(name, {}, registry.make_robot("go1"))
    made.reset(3, np.random.default_rng(0))
    exact = Exact(name, made)
    assert {channel.name: exact.read()[channel.name].shape for channel in exact.channels} == dict.fromkeys(
        made.idle(), (3,)
    )


def test_the_command_gives_it_as_json(asked, monkeypatch, capsys):
    seen = []

    def fake(given, processes, tell):
        seen.append(given)
        return {"unit": "1", "sessions": given.sessions, "speeds": {}}

    monkeypatch.setattr(truth_module, "truth", fake)
    call = ["realities", "truth", asked.policy, "--reality", "dev-03", "--objective", "power", "--sessions", "3"]
    assert main(call) == 0
    assert json.loads(capsys.readouterr().out)["sessions"] == 3
    assert (seen[0].speeds, seen[0].reality, seen[0].robot) == ((0.5, 0.8, 1.1), "dev-03", "go1")


# ------------------------------------------------------------------------------------- sessions of an evaluation


def test_each_session_is_another_one_with_commands_of_its_own(asked, tmp_path):
    settings = {"reality": "dev-03", "warmup_seconds": 1.0, "block_seconds": 3.0, "processes": 1}
    world = make_twin(settings, WorldContext("go1", {}, {"power": {}}, 0, tmp_path))
    try:
        ask_to_hold(world, HoldSpeed((0.2, 1.5), 4.0))
        recordings = in_sessions(world, asked.policy, asked.policy, (0.8,), 2)
    finally:
        world.close()
    assert len(recordings) == 8 and len({one.session for one in recordings}) == 2
    held = {one.session: one.notes["held_command"] for one in recordings if one.role == "policy"}
    assert len(set(held.values())) == 2
    assert len({one.notes.get("ambient", one.notes.get("state_of_charge")) for one in recordings}) == 2
