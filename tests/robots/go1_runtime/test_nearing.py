"""A robot that grows hot, whose pack runs low or whose sensors end sits down before a limit lets it fall."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
import json
import math
from pathlib import Path

import numpy as np
import pytest

from hts_go1_runtime.bundle import load_bundle
from hts_go1_runtime.errors import RuntimeFault
from hts_go1_runtime.events import Events
from hts_go1_runtime.fake import standing
from hts_go1_runtime.frozen import Missing
from hts_go1_runtime.loop import Loop
from hts_go1_runtime.machine import Limits
from hts_go1_runtime.nearing import STILL_HEAT, STILL_VOLTS, Nearing
from hts_go1_runtime.session import Options, Session

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)
PERIOD = 0.02
WALKS = 11.0  # s on the link's clock, when the second row of the bundle is being recorded


def growing(**values):
    """A robot whose numbers are functions of the time since the second row began."""

    def spoil(state):
        since = max(state.stamp - WALKS, 0.0)
        return dataclasses.replace(state, **{name: value(since) for name, value in values.items()})

    return scripted.ScriptedLink(spoil)


def warm(degrees):
    return lambda since: np.where(np.arange(12) == 7, degrees(since), 40.0)


@pytest.mark.parametrize(
    ("link", "words"),
    [
        (growing(temperature=warm(lambda since: 74.8 + 0.5 * since)), "RR_thigh_joint at 75 degC, and at 80"),
        (growing(voltage=lambda since: 19.1 - 0.05 * since), "V at the pack in the mean of about 1 s, and at 18.6"),
        (growing(foot_force=lambda since: np.full(4, math.nan if since > 0 else 30.0)), "foot_force has no numbers"),
    ],
    ids=["temperature", "voltage", "feet that are lost"],
)
def test_it_sits_down_and_is_not_let_fall(change, visit, link, words, capsys):
    bundle = change(lambda manifest: manifest["rows"][1]["schedule"]["commands"][0].__setitem__("seconds", 6.0))
    assert visit("--yes", link=link) == 2
    assert words in capsys.readouterr().err
    events = [json.loads(line) for line in (bundle / "logs" / "events.jsonl").read_text().splitlines()]
    what = [one["what"] for one in events]
    assert "sat down" in what and "stopped" not in what
    assert (bundle / "logs" / "00.csv").exists() and not (bundle / "logs" / "01.csv").exists()


def test_a_sensor_by_which_it_is_stopped_may_not_go_while_it_walks_unrecorded(bundle, tmp_path):
    """As in a first run: no heat would stop it any more."""
    link = scripted.ScriptedLink(
        lambda state: dataclasses.replace(state, temperature=np.full(12, 40.0 if state.stamp < 1 else 0.0))
    )
    made, loop = load_bundle(bundle), Loop(link, PERIOD, Limits())
    with contextlib.closing(Events(tmp_path / "events.jsonl")) as events:
        session = Session(made, link, loop, Options(), events)
        session._meet(made.rows)
        loop.resume()
        with pytest.raises(RuntimeFault, match=r"motor_temperature has no numbers any more, since time 0\.9\d\d"):
            session._stroll(made.policies["policies/00-walk.onnx"], [(6.0, 0.3, 0.0, 0.0)])
    assert link.now() == pytest.approx(4.0, abs=0.05)


@pytest.mark.parametrize(
    ("channel", "there", "lost"),
    [
        ("motor_temperature", {"temperature": np.full(12, 40.0)}, {"temperature": np.zeros(12)}),
        ("battery_current", {"current": 3.0}, {"current": math.nan}),
        ("base_velocity", {"velocity": np.ones(3)}, {"velocity": np.array([1.0, math.nan, 0.0])}),
    ],
)
def test_a_channel_may_be_away_for_less_than_three_seconds(channel, there, lost):
    missing = Missing([channel])
    for received, values in ((0.0, lost), (2.9, lost), (2.98, there), (5.9, lost)):
        missing.see(state(received=received, **values))
    with pytest.raises(RuntimeFault, match=f"{channel} has no numbers any more, since time 2.980"):
        missing.see(state(received=5.98, **lost))


def test_one_that_is_too_warm_or_too_empty_to_begin_does_not_move(visit, capsys):
    for values in ({"temperature": np.full(12, 77.0)}, {"voltage": 18.9}):
        link = scripted.ScriptedLink(lambda state, values=values: dataclasses.replace(state, **values))
        assert visit("--yes", link=link) == 2
        assert "is let fall: the visit ends here" in capsys.readouterr().err
        assert not any(command.kp.any() for _, command in link.sent)


def see_often(nearing, one, times):
    for _ in range(times):
        nearing.see(one)


def state(**values):
    return dataclasses.replace(standing(0, 0.0), **{"voltage": 22.0, "temperature": np.full(12, 40.0), **values})


def test_a_step_that_draws_the_pack_down_for_tenths_of_a_second_is_no_empty_pack():
    nearing = Nearing(Limits(), PERIOD)
    for number in range(2000):
        nearing.see(state(voltage=18.7 if number % 25 > 19 else 20.5))  # 20.1 V in the mean


def test_the_mean_voltage_is_that_of_about_a_second():
    nearing = Nearing(Limits(), PERIOD)
    nearing.see(state(voltage=22.0))
    seconds = math.log((22.0 - 18.7) / (19.0 - 18.7))  # until an exponential mean is down to 19.0
    see_often(nearing, state(voltage=18.7), math.floor(seconds / PERIOD) - 2)
    with pytest.raises(RuntimeFault, match=r"19\.00 V|18\.9\d V"):
        see_often(nearing, state(voltage=18.7), 5)


def test_what_is_not_measured_is_not_looked_at():
    nearing = Nearing(Limits(), PERIOD)
    see_often(nearing, state(voltage=math.nan, temperature=np.full(12, math.nan)), 100)
    nearing.see(state(voltage=22.0))


@pytest.mark.parametrize(("limit", "degrees"), [(80.0, 75.0), (60.0, 55.0)])
def test_it_is_five_degrees_below_whatever_limit_is_asked_for(limit, degrees):
    nearing = Nearing(Limits(temperature=limit), PERIOD)
    nearing.see(state(temperature=np.full(12, degrees - 0.1)))
    with pytest.raises(RuntimeFault, match=f"at {degrees:g} degC, and at {limit:g}"):
        nearing.see(state(temperature=np.full(12, degrees)))


@pytest.mark.parametrize(("channel", "seconds"), [("battery_voltage", STILL_VOLTS), ("motor_temperature", STILL_HEAT)])
@pytest.mark.parametrize("still", [None, 0.0, 400.0])
def test_charge_and_heat_that_stand_still_while_it_walks_are_not_being_read(channel, seconds, still):
    looks, noise = Nearing(Limits(), PERIOD, still), np.random.default_rng(0)
    limit = math.inf if still == 0 else max(seconds, still or 0.0)

    def walk(until: float) -> None:
        for number in range(round(until / PERIOD)):
            state = dataclasses.replace(standing(number, number * PERIOD), received=number * PERIOD)
            moves = {"voltage": 22.0 + 0.01 * noise.standard_normal(), "temperature": state.temperature + number % 7}
            moves.pop("voltage" if channel == "battery_voltage" else "temperature")
            looks.see(dataclasses.replace(state, **moves))

    if limit > 500.0:
        walk(500.0)
        return
    with pytest.raises(RuntimeFault, match=rf"^{channel} has been .* s of walking.*no limit of it would stop") as told:
        walk(500.0)
    assert f"to the last digit for {limit:.1f} s of walking" in str(told.value)


def test_a_pause_before_it_walks_is_no_walking():
    looks = Nearing(Limits(), PERIOD)
    for at in (0.0, 3600.0, 3600.02, 9000.0, 8000.0):
        looks.see(dataclasses.replace(standing(0, at), received=at))
