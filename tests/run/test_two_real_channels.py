"""An objective that scores current and voltage, and a selector that sees how candidates were made."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from hts.channels import Channel
from hts.cli import import_
from hts.cli.plugin_page import plugin_data
from hts.contracts import WorldContext
from hts.errors import ConfigError, RecordingError, UnfitWorldError
from hts.plugins import load
from hts.recordings.needs import check_recorded
from hts.recordings.recording import Recording, Series
from hts.testing.made_up_recordings import made_up_recording
from hts.testing.packages import kit_installed, on_path, write_package
from hts.testing.tiny_run import tiny_run
from hts.worlds.field import make_field

PLUGIN = '''
from hts import hookimpl
from hts.channels import Channel
from hts.contracts import Comparison, Objective, Selector

HTS_API = 2
SEEN = []


class Energy(Objective):
    """Electrical power: the model predicts the current, the score multiplies it with the voltage."""

    name, unit = "energy", "1"
    inputs = ("joint_torque", "joint_velocity")
    target = Channel("supply_current", "A")
    also_measured = (Channel("supply_voltage", "V"),)

    def reward(self, prediction):
        return -prediction

    def score(self, segments):
        current, voltage = (segments.values(channel.name) for channel in self.real_channels)
        return {"power": ((current - segments.idle("supply_current")[:, None]) * voltage).mean(axis=1)}

    def compare(self, policy, reference):
        saved = 1.0 - policy["power"] / reference["power"]
        return Comparison(saved, saved, {"watts": policy["power"]})


class Curious(Selector):
    """Tests everybody, keeps what it saw."""

    def elites(self, candidates, count):
        SEEN.extend(candidates)
        return [one.id for one in candidates]

    def best(self, tested):
        SEEN.extend(tested)
        return tested[0].id if tested else None


@hookimpl
def hts_objectives(register):
    register("energy", lambda settings: Energy())


@hookimpl
def hts_selectors(register):
    register("curious", lambda settings: Curious())
'''


@pytest.fixture(autouse=True)
def installed(tmp_path):
    package = write_package(tmp_path / "site", "energy-demo", {"energy_demo.py": PLUGIN}, {"energy": "energy_demo"})
    with kit_installed(), on_path(package):
        yield


def test_a_run_scores_two_channels_and_its_selector_sees_how_candidates_were_made(tmp_path):
    run = tiny_run(tmp_path / "run", "energy", selector="curious", settings={"sweep.weights.energy": [0.5, 2.0]})
    import energy_demo

    (speed,) = run.summary["final"]["objectives"]["energy"]["speeds"].values()
    assert speed["improvement"] == pytest.approx(0.2, abs=1e-5)  # current saves 20 %, voltage is what it was
    _, simulated, tested = energy_demo.SEEN[:4], energy_demo.SEEN[4:6], energy_demo.SEEN[6:]  # made-up ones first
    assert [one.made.weights for one in simulated] == [{"energy": 0.5}, {"energy": 2.0}]
    rows = {row["id"]: row for row in run.summary["iterations"][0]["candidates"]}
    for one in (*simulated, *tested):
        row = rows[one.id]
        assert (one.made.kl_bound, one.made.anchor) == (1.0, "pretrained")
        assert one.made.kl == row["kl"] and one.made.task_reward == pytest.approx(row["task_reward"])
        assert math.isfinite(one.made.pretrained_task_reward)
    assert {one.id for one in tested} == set(rows)


def test_its_page_names_both_channels():
    (page,) = plugin_data(load(), "energy")
    assert [row["name"] for row in page["channels"]] == ["supply_current", "supply_voltage"]
    assert page["facts"]["also measured"] == ["supply_voltage"]
    (robot,) = plugin_data(load(), "tiny")
    rows = {row["name"]: row["for"] for row in robot["real_channels"]}
    assert rows["supply_voltage"] == ["also scored by energy"]


def context(folder: Path) -> WorldContext:
    return WorldContext("tiny", {}, {"energy": {}}, 0, folder)


def test_the_field_asks_for_both_and_refuses_a_mapping_without_the_second(tmp_path):
    asked = yaml.safe_load(make_field({}, context(tmp_path))._template())["channels"]
    assert (asked["supply_current"]["unit"], asked["supply_voltage"]["unit"]) == ("A", "V")
    mapping = tmp_path / "mapping.yaml"
    names = [*load().make_robot("tiny").channels(), "supply_current"]
    mapping.write_text("channels:\n" + "".join(f"  {name}: {{columns: a, unit: A}}\n" for name in names))
    with pytest.raises(ConfigError, match="objective 'energy' needs 'supply_voltage'"):
        make_field({"mapping": str(mapping)}, context(tmp_path)).check()
    with pytest.raises(ConfigError, match="objective 'energy' needs 'supply_voltage'"):
        import_.command([tmp_path / "log.csv"], "tiny", mapping, tmp_path / "data.zarr", objective=["energy"])


def recorded(*channels: Channel) -> Recording:
    made = made_up_recording({}, {channel.name: channel for channel in channels})
    return made.replace(channels={**made.channels})


def test_a_recording_without_the_second_channel_or_in_another_unit_is_refused_before_it_is_kept():
    energy = load().make_objective("energy")
    current, voltage = energy.real_channels
    check_recorded([energy], [recorded(current, voltage)])
    with pytest.raises(RecordingError, match="measures 'supply_voltage', which was not recorded"):
        check_recorded([energy], [recorded(current)])
    with pytest.raises(RecordingError, match="measures 'supply_voltage' in V, recorded is mV"):
        check_recorded([energy], [recorded(current, Channel("supply_voltage", "mV"))])
    several = recorded(current)
    wide = Series(Channel("supply_voltage", "V", (2,)), np.ones((several.num_samples, 2)))
    with pytest.raises(RecordingError, match=r"shape \(\), recorded is \(2,\)"):
        check_recorded([energy], [several.replace(channels={**several.channels, "supply_voltage": wide})])


def test_a_twin_whose_instruments_lack_the_second_channel_is_refused(tmp_path):
    from hts.worlds.twin.process import Twin

    with on_path(write_package(tmp_path / "more", "half-demo", {"half_demo.py": HALF}, {"half": "half_demo"})):
        start = {"settings": {}, "robot": "tiny", "robot_settings": {}, "objectives": {"half": {}}, "seed": 0}
        with pytest.raises(UnfitWorldError, match="'half' wants 'supply_voltage', which no instrument"):
            Twin({**start, "name": "twin", "spool": str(tmp_path / "spool.zarr")}).check()


HALF = '''
from energy_demo import Energy
from hts import hookimpl
from hts.testing.examples.objective.objective import TARGET

HTS_API = 2


class Half(Energy):
    """Its instrument gives the target and no voltage."""

    name, target, instrument = "half", TARGET, "fake_meter"


@hookimpl
def hts_objectives(register):
    register("half", lambda settings: Half())
'''


def test_a_score_that_is_not_finite_names_all_channels_that_it_may_have_read(hts_fake_objective):
    from hts.errors import EvaluationError
    from hts.evaluation.scoring import scored

    hts_fake_objective.also_measured = (Channel("voltage", "V"),)
    hts_fake_objective.score = lambda segments: {"power": np.array([1.0, math.nan])}
    with pytest.raises(
        EvaluationError, match=r"in 1 of 2 segments of the policy\. Look at channels '.*' and 'voltage'"
    ):
        scored(hts_fake_objective, [0, 1], "policy")
