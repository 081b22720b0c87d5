"""What drifts while the command stays the same remembers minutes, and is told before anybody trusts its R²."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from hts.config import Command, ScheduleConfig
from hts.measurement import fit_report
from hts.measurement.drift import drift
from hts.recordings.on_schedule import NOT_STATED
from hts.recordings.recording import Series
from hts.testing.known_signals import HEAT, KnownHeat, known_heat


def rising(seed: int, seconds: float = 20.0, minute: float = 60.0):
    """Two stretches of 10 s, and the target of a body that warms up with a time constant of a minute, 0.05 of noise."""
    r = known_heat(seed, seconds=seconds)
    half = seconds / 2
    schedule = ScheduleConfig(commands=(Command(seconds=half, vx=0.5), Command(seconds=half, vx=0.8)))
    rise = 40.0 * (1.0 - np.exp(-(r.time - r.time[0]) / minute))
    noise = np.random.default_rng(seed).normal(0.0, 0.05, r.num_samples)
    return r.replace(channels={**r.channels, "heat": Series(HEAT, rise + noise)}, schedule=schedule)


def test_a_warming_body_drifts_and_a_gait_does_not():
    slow, gait = drift([rising(1), rising(2)], "heat"), drift([known_heat(1), known_heat(2)], "heat")
    assert slow.within > 0.99 and slow.remembers
    assert gait.within < 0.1 and not gait.remembers


def test_a_level_that_follows_the_command_is_no_drift():
    r = rising(1)
    steps = np.where(r.time - r.time[0] < 10.0, 5.0, 9.0) + np.random.default_rng(0).normal(0, 0.5, r.num_samples)
    assert not drift([r.replace(channels={**r.channels, "heat": Series(HEAT, steps)})], "heat").remembers


def test_a_slight_drift_of_what_speeds_decide_is_not_worth_a_line():
    r = rising(1)
    steps = np.where(r.time - r.time[0] < 10.0, 5.0, 9.0) + 0.01 * (r.time - r.time[0])
    found = drift([r.replace(channels={**r.channels, "heat": Series(HEAT, steps)})], "heat")
    assert found.within > 0.99 and not found.remembers


@pytest.mark.parametrize("at", [0.35, 0.5, 0.65])
def test_a_step_within_a_command_is_no_drift(at):
    """A robot that stands for a while before it walks, or a gauge that shows one step."""
    r = known_heat(1).replace(schedule=ScheduleConfig(commands=(Command(seconds=20.0, vx=0.5),)))
    steps = np.where(np.arange(r.num_samples) < at * r.num_samples, 2.0, 5.0)
    steps = steps + np.random.default_rng(0).normal(0, 0.2, r.num_samples)
    assert not drift([r.replace(channels={**r.channels, "heat": Series(HEAT, steps)})], "heat").remembers


def test_where_commands_are_not_stated_nothing_is_told():
    """A log that walks faster and faster has one made-up command."""
    assert drift([rising(1).replace(notes={"schedule": NOT_STATED})], "heat") is None


@pytest.mark.parametrize("rate", [0.3, 1.0, 50.0])
def test_a_slow_log_tells_it_or_nothing(rate):
    r = rising(1)
    keep = slice(None, None, round(50 / rate))
    channels = {name: replace(one, values=one.values[keep]) for name, one in r.channels.items()}
    found = drift([r.replace(channels=channels, time=r.time[keep], rate_hz=rate)], "heat")
    assert found is None if rate < 1.0 else found.remembers


def test_what_is_no_number_is_left_out():
    r = rising(1)
    values = r.values("heat").copy()
    values[[50, 300]] = np.nan, np.inf
    assert drift([r.replace(channels={**r.channels, "heat": Series(HEAT, values)})], "heat").within > 0.99


@pytest.mark.parametrize("seconds", [4.0, 8.0])
def test_too_short_stretches_and_constants_tell_no_drift(seconds):
    assert drift([rising(1, seconds=seconds)], "heat") is None
    r = known_heat(1)
    assert drift([r.replace(channels={**r.channels, "heat": Series(HEAT, np.ones(r.num_samples))})], "heat") is None
    assert drift([], "heat") is None


def a_report(r2: float | None, slow: bool = True):
    held = {"r2": r2, "linear": {"r2": r2}}
    found = {"within": 0.97, "of_all": 0.2} if slow else None
    return {"objective": "warm", "target": "heat", "held_out_r2": r2, "held_out": held, "drift": found}


@pytest.mark.parametrize("r2", [0.998, -0.5, None])
def test_a_high_r2_of_a_target_that_remembers_is_told_to_be_that_of_the_clock(r2):
    (line,) = fit_report.doubts(a_report(r2))
    assert "97% of what 'heat' changes by is a steady drift" in line and "the loss that heats instead" in line
    assert not any("drift" in one for one in fit_report.doubts(a_report(r2, slow=False)))


def test_a_fit_says_it_of_its_own_recordings(tmp_path, monkeypatch, capsys):
    from hts import plugins
    from hts.cli import data_use
    from hts.cli.main import main
    from hts.measurement.wanted import Wanted
    from hts.recordings.store import RecordingStore

    known = replace(plugins.load(), objectives={"cool": plugins.Entry("cool", lambda settings: KnownHeat(), "test")})
    monkeypatch.setattr(plugins, "load", lambda: known)
    store = RecordingStore(tmp_path / "data.zarr", create=True)
    for seed in (1, 2, 3):
        store.write(rising(seed))
    fit = ("fit", "--objective", "cool", "--data", str(store.path), "--out", str(tmp_path / "fit"))
    assert main([*fit, "--set", "objectives.cool.model=linear"]) == 0
    assert json.loads((tmp_path / "fit" / "fit.json").read_text())["drift"]["within"] > 0.99
    assert "is a steady drift" in capsys.readouterr().out
    lines, is_enough = data_use.show_enough(store.path, "cool", Wanted(), (), as_json=False)
    assert not is_enough and any("is a steady drift" in line and "do not help" in line for line in lines)
    assert "no sensor's lag" in data_use.show_lag(store.path, "cool", Wanted(), as_json=False)[-1]
