"""provenance.json: the sources by commit and hash; what was changed in them only for who asks."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from pathlib import Path

import pytest

from hts import api
from hts.config_loading import load_config, read_config
from hts.run import provenance

CHANGES = "diff --git a/x b/x\n+secret"


@pytest.fixture(params=[CHANGES, "", None], ids=["changed", "as committed", "no git"])
def changes(request, monkeypatch):
    answers = {"diff": request.param, "rev-parse": "4b1c0de"}
    monkeypatch.setattr(provenance, "_git", lambda what, *rest: answers[what])
    return request.param


def test_changed_sources_are_known_by_their_hash_alone(changes):
    found = provenance.collect(0, "mujoco", {})
    assert found["commit"] == "4b1c0de" and "secret" not in json.dumps(found) and "diff" not in found
    assert found["diff_sha256"] == (hashlib.sha256(CHANGES.encode()).hexdigest() if changes else None)


def test_the_changes_themselves_are_kept_for_who_asks(changes):
    assert provenance.collect(0, "mujoco", {}, diff=True)["diff"] == changes


def test_it_is_asked_for_by_a_setting_and_old_configurations_have_none(tmp_path):
    config = load_config(objectives=["x"], robot="y", overrides=["provenance.diff=true"])
    assert config.provenance.diff and not load_config(objectives=["x"], robot="y").provenance.diff
    from hts.config_loading import dump_config

    (tmp_path / "config.yaml").write_text(dump_config(config).replace("provenance:\n  diff: true\n", ""))
    assert not read_config(tmp_path / "config.yaml").provenance.diff


def test_an_environment_inside_somebody_elses_repository_says_nothing_of_that_repository(tmp_path, monkeypatch):
    def git(*arguments):
        named = ("-c", "user.name=x", "-c", "user.email=x@y.z")
        subprocess.run(["git", *named, *arguments], cwd=tmp_path, check=True, capture_output=True)

    place = tmp_path / ".venv" / "hts" / "run"
    place.mkdir(parents=True)
    copied = Path(shutil.copy(provenance.__file__, place))
    (tmp_path / ".gitignore").write_text(".venv\n")
    (tmp_path / "theirs.txt").write_text("a")
    git("init", "-q")
    git("add", ".")
    git("commit", "-qm", "theirs")
    (tmp_path / "theirs.txt").write_text("secret")
    monkeypatch.setattr(provenance, "__file__", str(copied))
    found = provenance.collect(0, "mujoco", {}, diff=True)
    assert (found["commit"], found["diff"], found["diff_sha256"]) == (None, None, None)
    git("add", "-f", str(copied))  # now it is of that repository
    assert "secret" in provenance.collect(0, "mujoco", {}, diff=True)["diff"]


def test_packages_of_another_version_than_a_run_was_begun_with_are_named(monkeypatch):
    kept = {"packages": {"our-power": "0.1.0", "our-robot": "2.0", "numpy": "1.0", "gone": "1"}}
    kept["plugins"] = {"power": "our-power", "robot": "our-robot", "new": "our-new", "gone": "gone"}
    now = {"our-power": "0.2.0", "our-robot": "2.0", "our-new": "1.0", "numpy": "2.0"}
    monkeypatch.setattr(provenance, "_version", now.get)
    assert provenance.other_versions(kept) == "our-power 0.1.0 (now 0.2.0)"
    assert provenance.other_versions({"packages": {"our-power": "0.1.0"}}) == ""
    now["our-power"] = "0.1.0"
    assert provenance.other_versions(kept) == ""


def test_a_run_that_is_resumed_under_another_version_says_so(broken_kit_run, capfd):
    path = broken_kit_run / "provenance.json"
    kept = json.loads(path.read_text())
    kept |= {"plugins": {"core": "hard-to-sim"}, "packages": {"hard-to-sim": "0.0.1"}}
    path.write_text(json.dumps(kept))
    api.resume(broken_kit_run)
    assert "was begun with" not in "".join(capfd.readouterr())  # it was finished: nothing follows
    for stage in ("final", "summary"):
        (broken_kit_run / f"{stage}.json").unlink()
    api.resume(broken_kit_run)
    said = " ".join("".join(capfd.readouterr()).split())
    assert "was begun with hard-to-sim 0.0.1 (now " in said and "of one version" in said
