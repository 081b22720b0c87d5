"""provenance.json: the sources by commit and hash; what was changed in them only for who asks."""

from __future__ import annotations

import hashlib
import json

import pytest

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
