"""A whole run: what it leaves behind, and that stopping it anywhere does not show."""

from __future__ import annotations

import importlib.util
import json
import math
import shutil
import sys
from pathlib import Path
from types import ModuleType

import pytest

from hts import api
from hts.errors import RunError
from hts.training.finetune import MOST_PROJECTIONS


def script(name: str) -> ModuleType:
    """A script beside the tests, as a module."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


kills = script("kill_and_resume")

pytestmark = pytest.mark.slow

STAGES = [
    "collect",
    "iterations/00/fit",
    "iterations/00/finetune",
    "iterations/00/simulate",
    "iterations/00/gate",
    "iterations/00/test",
    "final",
]


def forget(folder: Path, *stages: str) -> None:
    """As if the run had been stopped before these stages. The report stays: it takes longest and shows nothing here."""
    for stage in (*stages, "summary"):
        (folder / f"{stage}.json").unlink()


# ----------------------------------------------------------------------------------------------- what it leaves


def test_a_run_leaves_the_folder_that_was_promised(small_run):
    for name in (
        *("config.yaml", "provenance.json", "summary.json", "report.html", "data.zarr/zarr.json"),
        *("policies/pretrained.safetensors", "policies/pretrained.onnx", "policies/best.onnx"),
        *(f"iterations/00/{stage}.json" for stage in ("fit", "finetune", "simulate", "gate", "test")),
        *("iterations/00/models/power.safetensors", "iterations/00/candidates/00-01.onnx"),
    ):
        assert (small_run.folder / name).is_file(), name
    assert list((small_run.folder / "log").rglob("events.*"))
    assert list((small_run.folder / "figures").glob("*.svg"))
    left = [path for path in small_run.folder.rglob("*") if path.name.endswith((".tmp", ".partial", ".part"))]
    assert left == []
    assert not list(small_run.folder.rglob("checkpoint*")) and not list(small_run.folder.rglob(".partial*"))
    folders = [path for path in small_run.folder.iterdir() if path.is_dir()]
    assert [path.name for path in folders if not any(path.iterdir())] == []  # such as that of a world that kept nothing


def test_the_summary_has_what_others_read_of_it(small_run):
    summary = json.loads((small_run.folder / "summary.json").read_text())
    assert summary["objectives"] == ["power"]
    assert [summary[key] for key in ("robot", "world", "preset", "engine", "seed")] == [
        "go1",
        "twin",
        "smoke",
        "mujoco",
        0,
    ]
    assert summary["wall_seconds"] > 0
    (iteration,) = summary["iterations"]
    assert iteration["index"] == 0
    assert [candidate["id"] for candidate in iteration["candidates"]] == ["00-00", "00-01"]
    for candidate in iteration["candidates"]:
        assert candidate["anchor"] == "pretrained" and candidate["kl_bound"] == 1.0
        assert 0.0 <= candidate["kl"] <= 1.1
        assert (candidate["real"] is not None) == candidate["elite"] or "refused" in candidate
    assert sum(candidate["elite"] for candidate in iteration["candidates"]) == 1
    assert len(iteration["measurement_models"]["power"]["dataset"]) == 64


def test_steps_and_samples_are_counted(small_run):
    tuned = json.loads((small_run.folder / "iterations/00/finetune.json").read_text())
    judged = json.loads((small_run.folder / "iterations/00/simulate.json").read_text())
    batch = 2 * 2 * 24  # candidates x worlds x horizon; 8 of them, then one more each time the KL is measured
    assert tuned["steps"] in {(8 + extra) * batch for extra in range(1, MOST_PROJECTIONS + 2)}
    assert judged["steps"] == 3 * 2 * 150  # pretrained and two candidates, 2 worlds, 3 s at 50 Hz
    gated = json.loads((small_run.folder / "iterations/00/gate.json").read_text())
    assert gated["steps"] == 4 * 150 * (len(gated["policies"]) + (gated["pretrained"] is not None))  # 4 worlds, 3 s
    assert small_run.summary_of()["sim_steps"] == tuned["steps"] + judged["steps"] + gated["steps"]
    parts = [
        json.loads((small_run.folder / f"{name}.json").read_text())
        for name in ("collect", "iterations/00/test", "final")
    ]
    assert parts[0]["samples"] == 2 * 600  # 2 recordings of 12 s
    assert small_run.summary_of()["real_samples"] == sum(part["samples"] for part in parts)


def test_every_recording_is_whole_and_named_by_a_stage(small_run):
    from hts.recordings.store import RecordingStore

    store = RecordingStore(small_run.folder / "data.zarr")
    assert store.validate() == []
    named = []
    for name in ("collect", "iterations/00/test", "final"):
        named += json.loads((small_run.folder / f"{name}.json").read_text())["recordings"]
    assert sorted(named) == list(store.ids())
    assert {store.attributes(name)["world"] for name in named} == {"twin"}


def test_the_provenance_names_versions_plugins_and_hardware(small_run):
    found = json.loads((small_run.folder / "provenance.json").read_text())
    assert {"torch", "torchrl", "mujoco", "zarr", "hard-to-sim"} <= set(found["packages"])
    assert found["plugins"]["core"] == "hard-to-sim"
    assert found["packages"][found["plugins"]["go1"]]
    assert (found["seed"], found["engine"]) == (0, "mujoco")
    assert found["hardware"]["cores"] >= 1


def test_training_curves_have_a_row_a_batch_and_start_at_the_anchor(small_run):
    tuned = json.loads((small_run.folder / "iterations/00/finetune.json").read_text())
    for row in tuned["candidates"]:
        assert [point["steps"] for point in row["curve"]] == [48 * batch for batch in range(1, 9)]
        assert all(math.isfinite(point["kl"]) for point in row["curve"])
        assert row["stopped"] is None


# ------------------------------------------------------------------------------------------------- going on


def test_resuming_a_finished_run_writes_nothing(small_run, broken_run):
    files = kills.stage_files(broken_run)
    assert api.resume(broken_run) == broken_run
    assert kills.stage_files(broken_run) == files


def test_a_run_never_goes_into_a_folder_that_holds_something(broken_run):
    before = (broken_run / "summary.json").read_bytes()
    with pytest.raises(RunError, match=f"hts resume {broken_run}"):
        api.run("power", "go1", out=broken_run, preset="smoke")
    assert (broken_run / "summary.json").read_bytes() == before


def test_a_run_that_was_killed_before_it_had_a_configuration_may_be_started_again(tmp_path, monkeypatch):
    from hts.run import algorithm

    (tmp_path / ".config.yaml.tmp").write_text("preset: smo")
    monkeypatch.setattr(algorithm, "run", lambda config, folder, registry: folder)
    assert api.run("power", "go1", out=tmp_path, preset="smoke") == tmp_path
    assert api.load(tmp_path).config.preset == "smoke"
    assert [path.name for path in tmp_path.iterdir()] == ["config.yaml"]


def test_stages_done_again_give_what_they_gave_before(small_run, broken_run):
    forget(broken_run, "iterations/00/fit", "iterations/00/simulate", "final")
    shutil.rmtree(broken_run / "iterations/00/models")
    api.resume(broken_run)
    assert small_run.summary_of(broken_run) == small_run.summary_of()
    for name in ("iterations/00/simulate.json", "final.json"):
        assert (broken_run / name).read_bytes() == (small_run.folder / name).read_bytes(), name


def test_fine_tuning_stopped_in_the_middle_ends_as_if_undisturbed(small_run, broken_run, monkeypatch):
    from hts.training import finetune

    forget(broken_run, "iterations/00/finetune")
    shutil.rmtree(broken_run / "iterations/00/candidates")
    saved = []
    really = finetune.save_checkpoint

    def save_and_stop(*arguments):
        saved.append(really(*arguments))
        if len(saved) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(finetune, "CHECKPOINT_SECONDS", 0.0)
    monkeypatch.setattr(finetune, "save_checkpoint", save_and_stop)
    with pytest.raises(KeyboardInterrupt):
        api.resume(broken_run)
    assert (broken_run / "iterations/00/checkpoint-0").is_file()
    monkeypatch.setattr(finetune, "save_checkpoint", really)

    api.resume(broken_run)
    for name in ("iterations/00/finetune.json", "iterations/00/candidates/00-01.json"):
        assert (broken_run / name).read_bytes() == (small_run.folder / name).read_bytes(), name
    assert small_run.summary_of(broken_run) == small_run.summary_of()
    assert not list((broken_run / "iterations/00").glob("*checkpoint*"))


def test_a_run_killed_while_it_collects_goes_on_as_if_undisturbed(small_run, broken_run, tmp_path):
    store = broken_run / "data.zarr"
    collected = json.loads((broken_run / "collect.json").read_text())["recordings"]
    forget(broken_run, "collect")
    for name in collected:
        shutil.rmtree(store / name)

    def moment() -> bool:
        return any((store / name).exists() for name in collected)

    expected = kills.outcome(small_run.folder)
    trial = kills.kill_and_resume(["resume", broken_run], broken_run, expected, moment, tmp_path / "log", api.resume)
    assert trial.wrong == []


def test_a_run_killed_while_it_fine_tunes_goes_on_from_its_checkpoint(small_run, broken_run, tmp_path):
    forget(broken_run, "iterations/00/finetune", "iterations/00/simulate")
    shutil.rmtree(broken_run / "iterations/00/candidates")

    def moment() -> bool:
        return (broken_run / "iterations/00/checkpoint-0").exists()

    expected = kills.outcome(small_run.folder)
    trial = kills.kill_and_resume(["resume", broken_run], broken_run, expected, moment, tmp_path / "log", api.resume)
    assert trial.wrong == []
    assert trial.checkpoint
