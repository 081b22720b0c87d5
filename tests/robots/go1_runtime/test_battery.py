"""A battery monitor that misses readings, and one that is not there: what a visit does about it."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from hts import plugins
from hts.recordings.mapping import load_mapping
from hts.recordings.reading import read_log
from hts_go1_runtime.fake import standing
from hts_go1_runtime.log import measured

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)

NAN = float("nan")


def missing(when):
    """A robot whose current is no number in the states for which when(sequence) holds."""
    return scripted.ScriptedLink(
        lambda state: dataclasses.replace(state, current=NAN) if when(state.sequence) else state
    )


def real(manifest):
    """As an objective that is scored by the battery asks for it."""
    for name in ("battery_current", "battery_voltage"):
        manifest["channels"][name] = {"unit": "", "size": 0, "real": True}


def refused(capsys) -> str:
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("refused: ")
    return line


def read(bundle, name):
    registry = plugins.load()
    mapping = load_mapping(bundle / "logs" / "mappings" / f"{name}.yaml")
    return read_log(registry, [bundle / "logs" / f"{name}.csv"], mapping, registry.make_robot("go1"))


@pytest.mark.parametrize(
    "when",
    [lambda at: at < 4, lambda at: 30 <= at < 40, lambda at: at % 5 == 0, lambda at: at == 1500],
    ids=["first states", "while idle", "every fifth", "while walking"],
)
def test_a_reading_that_is_missing_spoils_no_visit(change, visit, when):
    bundle = change(real)
    assert visit("--yes", link=missing(when)) == 0
    for name in ("00", "01"):
        found = read(bundle, name)
        assert found.idle == pytest.approx({"battery_current": 3.0, "battery_voltage": 22.0}, abs=0.2)
        assert np.isfinite(found.values("battery_current")).all()


def test_too_few_readings_make_no_idle_level(change, visit, capsys):
    change(real)
    link = missing(lambda number: number > 30)
    assert visit("--yes", link=link) == 2
    assert not any(command.kp.any() for _, command in link.sent)  # it never stood up
    line = refused(capsys)
    assert "battery_current: " in line and "of 10 readings while idle are numbers, expected half of them" in line


def test_a_channel_for_which_the_rows_are_walked_has_to_be_there(change, visit, capsys):
    bundle, never = change(real), lambda number: True
    link = missing(never)
    assert visit("--yes", link=link) == 2
    assert link.sent == []
    assert "The link gives no battery_current, for which the rows are walked" in refused(capsys)
    assert visit("--yes", "--external", "battery_curent", link=missing(never)) == 2
    assert "--external battery_curent: the bundle's channels are " in refused(capsys)
    assert visit("--yes", "--external", "battery_current", link=missing(never)) == 0
    channels = json.loads((bundle / "logs" / "mappings" / "00.yaml").read_text())["channels"]
    assert "battery_current" not in channels and "battery_voltage" in channels


def test_a_first_run_records_nothing_and_needs_no_battery_monitor(change, visit):
    change(real)
    assert visit("--yes", "--first-run", link=missing(lambda number: True)) == 0


def test_a_channel_is_there_if_any_of_the_first_states_has_all_of_it():
    states = [standing(number, 0.004 * number) for number in range(3)]
    lost = [dataclasses.replace(one, current=NAN, velocity=np.array([0.0, NAN, 0.0])) for one in states]
    assert "battery_current" not in measured(lost) and "base_velocity" not in measured(lost)
    assert "battery_current" in measured([*lost, states[0]]) and "base_velocity" in measured([*lost, states[0]])
