"""A run goes on with the config.yaml that it was begun with, and with no other."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from hts import api, plugins
from hts.cli.main import main
from hts.config import RunConfig
from hts.config_base import Named
from hts.config_loading import dump_config, load_config
from hts.errors import RunError
from hts.run import resume_run
from hts.run.provenance import check_config, config_sha256
from hts.testing.packages import kit_installed


@pytest.fixture
def begun(finished, tmp_path):
    """The folder of a run whose final is to be made again."""
    folder = shutil.copytree(finished.folder, tmp_path / "run")
    for stage in ("final.json", "summary.json"):
        (folder / stage).unlink()
    with kit_installed():
        yield folder


def edit(folder: Path, before: str, after: str) -> None:
    path = folder / "config.yaml"
    written = path.read_text()
    assert before in written
    path.write_text(written.replace(before, after, 1))


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_config_that_was_edited_in_the_midst_of_a_run_is_refused_until_it_is_put_back(begun):
    (begun / "policies/pretrained.safetensors").unlink()  # is made of what config.yaml says
    kept = json.loads((begun / "provenance.json").read_text())["config_sha256"]
    edit(begun, "seed: 0", "seed: 5")
    config, as_it_was = begun / "config.yaml", contents(begun)
    with pytest.raises(RunError, match=rf"^{config}: the SHA-256 of its settings .* begun with {kept[:12]}…") as error:
        resume_run(begun)
    assert f"`hts run --config {config} --out DIR`" in str(error.value) and "\n" not in str(error.value)
    assert contents(begun) == as_it_was
    edit(begun, "seed: 5", "seed: 0")
    resume_run(begun)
    assert json.loads((begun / "summary.json").read_text())["seed"] == 0


def test_the_policy_to_start_from_is_not_made_again_of_another_one(begun):
    (begun / "policies/pretrained.safetensors").unlink()
    provenance = begun / "provenance.json"
    kept = json.loads(provenance.read_text())
    provenance.write_text(json.dumps({**kept, "pretrained_policy": "0" * 64}))  # as if the robot's was another since
    with pytest.raises(
        RunError, match=f"holds policy {kept['pretrained_policy'][:12]}, the run was begun with 0{{12}}"
    ):
        resume_run(begun)
    assert not (begun / "policies/pretrained.safetensors").exists()
    provenance.write_text(json.dumps(kept))
    resume_run(begun)
    assert (begun / "summary.json").exists()


def test_a_run_of_before_the_hash_was_kept_goes_on_and_a_note_is_no_setting(begun, tmp_path):
    edit(begun, "seed: 0", "seed: 0  # a note")
    before = shutil.copytree(begun, tmp_path / "before")
    kept = json.loads((before / "provenance.json").read_text())
    del kept["config_sha256"]
    (before / "provenance.json").write_text(json.dumps(kept))
    for one in (begun, before):
        resume_run(one)
        assert (one / "summary.json").exists()


def test_where_files_lie_may_be_written_anew_and_nothing_else(tmp_path):
    registry = plugins.load()
    (tmp_path / "provenance.json").write_text("{}")

    def settings(**world) -> RunConfig:
        made = load_config(objectives=["power"], robot="go1", preset="smoke", engine="mujoco")
        found = made.model_copy(update={"world": Named(name="twin", **world)})
        (tmp_path / "config.yaml").write_text(dump_config(found))
        return found

    first = settings(reality="/first/place/mine.json")
    begun = {"config_sha256": config_sha256(tmp_path, first, registry)}
    (tmp_path / "provenance.json").write_text(json.dumps(begun))
    check_config(tmp_path, settings(reality="second/mine.json"), registry)
    for other in ({"reality": "dev-03"}, {}, {"reality": "second/mine.json", "block_seconds": 5.0}):
        with pytest.raises(RunError, match="the SHA-256 of its settings"):
            check_config(tmp_path, settings(**other), registry)


def test_an_oracle_is_begun_anew_by_its_own_command(tmp_path):
    config = load_config(objectives=["power"], robot="go1", preset="smoke", oracle=True)
    (tmp_path / "config.yaml").write_text(dump_config(config))
    (tmp_path / "provenance.json").write_text(json.dumps({"config_sha256": "0" * 64}))
    with pytest.raises(RunError, match="`hts oracle --config"):
        check_config(tmp_path, config, plugins.load())


def test_nor_is_an_edited_one_evaluated_and_the_line_says_how_it_is_meant(tmp_path, capsys):
    config = load_config(objectives=["power"], robot="go1", preset="smoke")
    (tmp_path / "config.yaml").write_text(dump_config(config))
    (tmp_path / "provenance.json").write_text(json.dumps({"config_sha256": "0" * 64}))
    with pytest.raises(RunError, match="the SHA-256 of its settings .* `hts evaluate DIR --set evaluation.KEY=VALUE`"):
        api.evaluate(tmp_path)
    assert main(["evaluate", str(tmp_path)]) == 2
    assert "--set world.KEY=VALUE" in capsys.readouterr().err
    assert not (tmp_path / "evaluation").exists()


def test_a_report_of_an_edited_one_is_made_and_says_so(finished, tmp_path, capsys):
    shutil.copytree(finished.folder, tmp_path / "run")
    with kit_installed():
        capsys.readouterr()
        assert main(["report", str(tmp_path / "run")]) == 0
        assert "warning" not in capsys.readouterr().err
        edit(tmp_path / "run", "seed: 0", "seed: 5")
        assert main(["report", str(tmp_path / "run")]) == 0
    said = capsys.readouterr().err
    assert "warning: " in said and "The page shows these settings beside results of those" in said
