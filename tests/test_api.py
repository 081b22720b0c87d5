"""The commands from Python: each passes on what it was given and reads back what was written."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from hts import api
from hts.config_loading import dump_config, load_config
from hts.errors import ConfigError, PolicyError, RunError


@pytest.fixture
def folder(tmp_path):
    config = load_config(preset="smoke", objectives=["anything"], robot="any", seed=3)
    (tmp_path / "config.yaml").write_text(dump_config(config), encoding="utf-8")
    return tmp_path


def test_run_resolves_a_configuration_and_starts_in_the_folder(tmp_path, monkeypatch):
    import hts.run

    seen = {}
    monkeypatch.setattr(hts.run, "start_run", lambda config, out, registry: seen.update(config=config) or out)
    out = api.run("anything", "any", out=tmp_path / "new", preset="smoke", seed=5, settings={"finetune.num_envs": 16})
    assert out == tmp_path / "new"
    assert (seen["config"].seed, seen["config"].preset, seen["config"].finetune.num_envs) == (5, "smoke", 16)
    assert list(seen["config"].objectives) == ["anything"] and seen["config"].robot.name == "any"


def test_run_takes_several_objectives(tmp_path, monkeypatch):
    import hts.run

    monkeypatch.setattr(hts.run, "start_run", lambda config, out, registry: tuple(config.objectives))
    assert api.run(["one", "two"], "any", out=tmp_path / "new") == ("one", "two")


def test_run_refuses_a_folder_that_holds_something_before_it_looks_at_anything_else(folder):
    with pytest.raises(RunError, match="holds a run already"):
        api.run("anything", "any", out=folder)
    (folder / "mine").mkdir()
    (folder / "mine/notes.txt").touch()
    with pytest.raises(RunError, match="is not an empty folder. Choose another one"):
        api.run("anything", "any", out=folder / "mine")


def test_a_misspelt_setting_raises_what_the_command_line_prints(tmp_path):
    with pytest.raises(ConfigError, match="num_envs"):
        api.run("anything", "any", out=tmp_path, settings={"finetune.num_env": 16})


def test_resume_goes_on_in_the_folder_and_refuses_one_without_a_run(folder, tmp_path, monkeypatch):
    import hts.run

    monkeypatch.setattr(hts.run, "resume_run", lambda place: place)
    assert api.resume(str(folder)) == folder
    with pytest.raises(RunError, match="there is no such folder"):
        api.resume(tmp_path / "nothing")


def test_fit_returns_what_was_written(tmp_path, monkeypatch):
    from hts.measurement import fit_command

    def fake(objective, data, out, *, overrides, checks):
        file = out / "fit.json"
        file.write_text(
            json.dumps(
                {
                    "objective": objective,
                    "data": str(data),
                    "overrides": [[*list(one.path), one.value] for one in overrides],
                    "split": checks.split and [checks.split.kind, checks.split.share],
                    "best": checks.best,
                }
            ),
            encoding="utf-8",
        )
        return file

    monkeypatch.setattr(fit_command, "fit_store", fake)
    report = api.fit("anything", "walks.zarr", tmp_path, {"measurement.epochs": 2}, split="session=0.7", best=True)
    assert report == {
        "objective": "anything",
        "data": "walks.zarr",
        "overrides": [["measurement", "epochs", 2]],
        "split": ["session", 0.7],
        "best": True,
    }


def test_evaluate_passes_on_speeds_policy_world_seed_and_settings(folder, monkeypatch, capsys):
    from hts.evaluation import evaluate

    monkeypatch.setattr(evaluate, "evaluate_run", lambda place, **given: {"folder": place, **given})
    found = api.evaluate(folder, [0.8], policy="pretrained", seed=1, settings={"world.reality": "mine.json"})
    laid_over = [(".".join(one.path), one.value) for one in found.pop("overrides")]
    assert laid_over == [("world.reality", "mine.json")] and "twin" in found.pop("registry").worlds
    found.pop("say")("a note")
    assert found == {
        "folder": folder,
        "speeds": [0.8],
        "policy": "pretrained",
        "world": None,
        "seed": 1,
        "sessions": None,
    }
    assert capsys.readouterr() == ("", "a note\n")


SUMMARY = {
    "objectives": ["anything"],
    "robot": "any",
    "preset": "smoke",
    "engine": "mujoco",
    "seed": 3,
    "iterations": [],
    "final": None,
}


def test_load_gives_configuration_and_summary_of_a_finished_run(folder):
    (folder / "summary.json").write_text(json.dumps({**SUMMARY, "key_of_tomorrow": 1}), encoding="utf-8")
    run = api.load(folder)
    assert (run.folder, run.config.seed, run.summary) == (folder, 3, {**SUMMARY, "key_of_tomorrow": 1})


def test_an_unfinished_run_has_no_summary_and_a_damaged_one_is_an_error(folder):
    assert api.load(folder).summary is None
    (folder / "summary.json").write_text('{"seed":', encoding="utf-8")
    with pytest.raises(RunError, match="hts resume"):
        api.load(folder)


@pytest.mark.parametrize(
    ("written", "found"),
    [
        ("[1, 2]", "holds a list, expected an object"),
        ("null", "holds a NoneType, expected an object"),
        ("{}", "damaged .*objectives"),
        (json.dumps(SUMMARY | {"iterations": {}}), "damaged .*iterations"),
        (json.dumps({key: one for key, one in SUMMARY.items() if key != "final"}), "damaged .*final"),
    ],
)
def test_a_summary_that_no_run_writes_is_one_clear_error(folder, written, found):
    (folder / "summary.json").write_text(written, encoding="utf-8")
    with pytest.raises(RunError, match=rf"summary\.json: {found}.*hts resume") as refused:
        api.load(folder)
    assert "\n" not in str(refused.value)


def test_load_refuses_a_folder_without_a_run(tmp_path):
    with pytest.raises(RunError, match="no config.yaml"):
        api.load(tmp_path)


def test_a_run_gives_its_policies_by_name(folder):
    with pytest.raises(PolicyError, match="No policy named 'best'"):
        api.load(folder).policy()


def test_a_robot_is_made_by_name_with_its_settings(monkeypatch):
    from hts import plugins
    from hts.plugins import Entry, Registry
    from hts.testing.examples.robot.robot import Tiny

    class Wheels(Tiny):
        spec = replace(Tiny.spec, name="wheels")

        def __init__(self, settings):
            self.settings = settings

    made = Entry("wheels", Wheels, "hts-wheels")
    monkeypatch.setattr(plugins, "load", lambda: Registry(robots={"wheels": made}))
    assert api.robot("wheels").settings == {} and api.robot("wheels", {"size": 2}).settings == {"size": 2}
    with pytest.raises(ConfigError, match="No robot named 'wheel'. Did you mean 'wheels'?"):
        api.robot("wheel")
