"""A robot that tips over in a head-to-head: the half row is kept and says so, and the next visit goes on after it."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest

from hts import plugins
from hts.contracts import HoldSpeed
from hts.recordings.commanded import check_commanded
from hts.recordings.mapping import load_mapping
from hts.recordings.reading import read_log
from hts.worlds import field_holding
from hts_go1_runtime.bundle import load_bundle
from hts_go1_runtime.errors import Stopped
from hts_go1_runtime.events import Events
from hts_go1_runtime.fake import failing
from hts_go1_runtime.loop import Loop
from hts_go1_runtime.machine import Limits
from hts_go1_runtime.session import Options, Session

SPEC = importlib.util.spec_from_file_location("scripted", Path(__file__).with_name("scripted.py"))
scripted = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(scripted)

WALKS, TRIMS = 6.3, 5.0  # s: the first row is walked then (3.7 s until it stands, 2 s of trimming), or trimmed


def visit(bundle: Path, fault: str = "tilt", at: float = float("inf")) -> Session:
    """One visit to a robot that fails after so many seconds of its clock."""
    link = scripted.ScriptedLink(lambda state: failing(state, fault) if state.stamp > at else state)
    link.speed = 0.55
    options = Options(idle_seconds=0.2, warmup_seconds=0.0, mass_kg=13.0)
    return Session(
        load_bundle(bundle), link, Loop(link, 0.02, Limits()), options, Events(bundle / "logs" / "events.jsonl")
    )


def read(bundle: Path, name: str):
    files, registry = [bundle / "logs" / f"{name}.csv"], plugins.load()
    mapping = load_mapping(bundle / "logs" / "mappings" / f"{name}.yaml")
    recording = read_log(registry, files, mapping, registry.make_robot("go1"))
    check_commanded(recording, files)
    return recording


def test_a_fall_in_a_row_is_its_log_and_the_next_visit_goes_on_after_it(bundle):
    found = visit(bundle, at=WALKS)
    with pytest.raises(Stopped, match="tilt"):
        found.run()
    assert found.done == ["00"]
    recording = read(bundle, "00")
    assert recording.fell and 0.1 < recording.seconds < 1.0
    held = field_holding.held([Path("00.csv")], recording, HoldSpeed((0.2, 1.5), 2.0), True)
    assert held.notes["held_saturated"] == "false"
    found.events.close()
    said = [json.loads(line) for line in (bundle / "logs" / "events.jsonl").read_text().splitlines()]
    assert [one["log"] for one in said if one["what"].startswith("fell")] == ["00"]
    again = visit(bundle)
    assert again.run() == ["01"] and not read(bundle, "01").fell


def test_a_fall_while_a_command_is_trimmed_is_the_rows_log_too(bundle):
    found = visit(bundle, at=TRIMS)
    with pytest.raises(Stopped, match="tilt"):
        found.run()
    recording = read(bundle, "00")
    assert recording.fell and recording.notes["fell_while_trimmed"] == "true"
    moved = recording.values("command")[:, 0]
    assert moved.max() - moved.min() > 2 * field_holding.STEADY  # as it is while a command is looked for
    held = field_holding.held([Path("00.csv")], recording, HoldSpeed((0.2, 1.5), 2.0), True)
    assert float(held.notes["held_command"]) == pytest.approx(0.6, abs=0.1)
    field_holding.check_one_command([held, held.replace(notes={**recording.notes, "held_command": "1.0"})])
    assert not (bundle / "logs" / "held.json").exists()
    assert visit(bundle).run() == ["01"]


@pytest.mark.parametrize("fault", ["joint limit", "over-current"])
def test_any_other_stop_leaves_the_row_to_be_walked_again(bundle, fault):
    found = visit(bundle, fault, WALKS)
    with pytest.raises(Stopped, match=fault):
        found.run()
    assert found.done == [] and not (bundle / "logs" / "00.csv").exists()
    assert visit(bundle).run() == ["00", "01"]


def test_data_for_learning_are_walked_again(change):
    def collection(manifest):
        for row in manifest["rows"]:
            row["role"] = "collection"

    bundle = change(collection)
    with pytest.raises(Stopped, match="tilt"):
        visit(bundle, at=4.5).run()
    assert not list((bundle / "logs").glob("*.csv"))
