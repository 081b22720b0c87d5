"""A twin that is the machine of a reality's file: what it takes of it, says of it and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hts.contracts import WorldContext
from hts.errors import ConfigError, UnfitWorldError
from hts.worlds.base import request_id, walking
from hts.worlds.realities.batch import parameters_of
from hts.worlds.realities.draw import draw
from hts.worlds.twin.parameters import TwinSettings, resolved_settings
from hts.worlds.twin.reality import Reality, locate, read, sha256
from hts.worlds.twin.world import make_twin

DATA = Path(__file__).resolve().parents[1] / "data"


def written(folder: Path, registry, parameters, index: int = 0, **changes) -> Path:
    drawn = draw(parameters, "test", index)
    reality = Reality(
        name="mine",
        robot="go1",
        seed="test",
        index=index,
        switches=drawn.switches,
        parameters=parameters_of(drawn, registry),
    ).model_copy(update=changes)
    path = folder / "mine.json"
    path.write_text(reality.model_dump_json())
    return path


def context(folder: Path, robot: str = "go1", objective: str = "power") -> WorldContext:
    return WorldContext(robot, {}, {objective: {}}, 7, folder)


def test_a_run_keeps_a_realitys_name_and_hash_and_none_of_its_parameters(tmp_path, registry, parameters):
    path = written(tmp_path, registry, parameters)
    settings = TwinSettings(reality=str(path))
    assert settings.model_dump(mode="json") == {
        "reality": str(path),
        "reality_sha256": sha256(path),
        "warmup_seconds": 20.0,
        "block_seconds": 80.0,
        "unsteady_seconds": 2.0,
        "max_worlds": 6,
        "processes": 0,
    }
    assert TwinSettings.model_validate(settings.model_dump(mode="json")) == settings
    world = make_twin({"reality": str(path)}, context(tmp_path))
    assert world.identity() == {"reality": str(path), "reality_sha256": sha256(path)}
    assert make_twin({}, context(tmp_path)).identity() == {}
    assert world.settings.dynamics == TwinSettings().dynamics  # this side of it knows the default only


def test_sessions_on_two_realities_are_drawn_apart_and_on_the_default_twin_as_ever(tmp_path, registry, parameters):
    worlds = [make_twin({"reality": name}, context(tmp_path)) for name in ("dev-00", "dev-01", "dev-00")]
    first, second, again = (world._request("collect", [None], 1) for world in worlds)
    assert first == again != second
    assert make_twin({}, context(tmp_path))._request("collect", [None], 1) == request_id("collect", 7, [None], 1)


def test_the_twins_process_is_the_machine_that_the_file_says(tmp_path, registry, parameters):
    path = written(tmp_path, registry, parameters)
    content = json.loads(path.read_text())["parameters"]
    resolved = resolved_settings(TwinSettings(reality=str(path), block_seconds=5), "go1")
    assert resolved.dynamics.model_dump(mode="json") == content["dynamics"]
    assert resolved.instruments == content["instruments"]
    assert resolved.block_seconds == 5
    assert resolved_settings(TwinSettings(), "go1") == TwinSettings()


def test_a_file_that_has_changed_since_is_refused(tmp_path, registry, parameters):
    path = written(tmp_path, registry, parameters)
    settings = TwinSettings(reality=str(path)).model_dump(mode="json")
    written(tmp_path, registry, parameters, index=1)
    for use in (lambda: TwinSettings.model_validate(settings), lambda: read(str(path), settings["reality_sha256"])):
        with pytest.raises(ConfigError, match="begun with") as error:
            use()
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("reference", "said"),
    [("dev-0x", r"No reality named 'dev-0x'"), ("nowhere/mine.json", "no such file"), ("mine.json", "no such file")],
)
def test_an_unknown_reality_is_one_line(tmp_path, registry, reference, said):
    with pytest.raises(ConfigError, match=said) as error:
        registry.make_world("twin", {"reality": reference}, context(tmp_path))
    assert "\n" not in str(error.value)


def test_a_file_that_is_not_there_is_said_with_the_place_and_that_a_run_needs_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=r"A run that was begun needs its own: put it there") as error:
        locate("nowhere/mine.json")
    assert f" as {tmp_path}/nowhere/mine.json." in str(error.value)


def test_a_reality_and_parameters_beside_it_are_refused(tmp_path, registry, parameters):
    path = written(tmp_path, registry, parameters)
    with pytest.raises(ConfigError, match=r"world\.dynamics: world\.reality=") as error:
        registry.make_world("twin", {"reality": str(path), "dynamics": {"gear_loss": 0.0}}, context(tmp_path))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", ["{", '{"name": "x"}', '{"format": 2}', "[]"])
def test_a_broken_file_is_one_line(tmp_path, content):
    path = tmp_path / "mine.json"
    path.write_text(content)
    with pytest.raises(ConfigError, match=r"mine\.json") as error:
        read(str(path))
    assert "\n" not in str(error.value)


def test_a_file_of_another_kind_is_told_what_it_is(tmp_path, registry):
    robot = registry.make_robot("go1")
    files = {
        robot.pretrained_policy().with_suffix(".json"): "is the card of a policy for robot 'go1', expected a reality.",
        DATA / "measurement-model-v1.json": "is the card of a measurement model, expected a reality.",
        robot.pretrained_policy(): "is not JSON",
    }
    summary = tmp_path / "summary.json"
    summary.write_text('{"objectives": ["power"], "robot": "go1", "final": {}, "iterations": []}')
    files[summary] = "is the summary of a run for robot 'go1', expected a reality."
    provenance = tmp_path / "provenance.json"
    provenance.write_text('{"packages": {}, "hardware": {}, "seed": 0}')
    files[provenance] = "is the provenance of a run, expected a reality."
    asked = tmp_path / "asked.json"
    asked.write_text('{"robot": "go1", "config": {}}')
    files[asked] = "is what was asked of a pretraining for robot 'go1', expected a reality."
    for path, said in files.items():
        with pytest.raises(ConfigError) as caught:
            read(str(path))
        text = str(caught.value)
        assert text.startswith(f"reality {path}: {said}") and "`hts realities draw`" in text and "\n" not in text


def test_a_reality_of_another_robot_is_refused(tmp_path, registry, parameters):
    path = written(tmp_path, registry, parameters, robot="other")
    with pytest.raises(UnfitWorldError, match="'other'"):
        resolved_settings(TwinSettings(reality=str(path)), "go1")


def test_recordings_of_a_reality_say_which_it_was_and_the_sessions_charge(tmp_path, registry, parameters):
    path = written(tmp_path, registry, parameters)
    world = make_twin({"reality": str(path), "processes": 1}, context(tmp_path / "run"))
    try:
        first, second = world.collect([None, None], walking(0.0, 0.5))
    finally:
        world.close()
    for recording in (first, second):
        assert recording.notes["reality_sha256"] == sha256(path)
        assert 30 <= float(recording.notes["state_of_charge"]) <= 100
        assert recording.values("state_of_charge")[0] == pytest.approx(float(recording.notes["state_of_charge"]), abs=1)
    assert first.notes["state_of_charge"] != second.notes["state_of_charge"]


def test_torque_follows_a_supply_that_nobody_reads(tmp_path, registry, parameters):
    index = next(i for i in range(20) if "sag" in draw(parameters, "test", i).switches)
    path = written(tmp_path, registry, parameters, index)
    world = make_twin({"reality": str(path), "processes": 1}, context(tmp_path / "run", objective="noise"))
    try:
        (recording,) = world.collect([None], walking(0.0, 0.2))
    finally:
        world.close()
    assert "sound_level" in recording.channels and "battery_current" not in recording.channels
    assert "state_of_charge" in recording.notes  # so the instrument that sags is there
