"""A run keeps which machine it was begun on, and is not resumed on another one."""

from __future__ import annotations

import json

import pytest

from hts.errors import RunError
from hts.run import resume_run
from hts.testing.known_world import KnownWorld
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run


def test_the_identity_of_a_world_is_kept_and_another_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(KnownWorld, "identity", lambda self: {"serial": "7"}, raising=False)
    with kit_installed():
        run = tiny_run(tmp_path / "run")
        assert run.summary is not None and run.summary["world_identity"] == {"serial": "7"}
        assert json.loads((tmp_path / "run" / "provenance.json").read_text())["world"] == {"serial": "7"}
        monkeypatch.setattr(KnownWorld, "identity", lambda self: {"serial": "8"})
        with pytest.raises(RunError, match="another machine .serial 7, now serial 8.") as error:
            resume_run(tmp_path / "run")
        assert "\n" not in str(error.value)
        monkeypatch.setattr(KnownWorld, "identity", lambda self: {"serial": "7"})
        resume_run(tmp_path / "run")


def test_a_file_that_was_moved_is_the_same_machine_and_one_of_another_hash_is_not(tmp_path, monkeypatch):
    def lies(where: str, sha256: str) -> None:
        machine = {"reality": where, "reality_sha256": sha256}
        monkeypatch.setattr(KnownWorld, "identity", lambda self: machine, raising=False)

    lies("/first/place/mine.json", "a" * 64)
    with kit_installed():
        tiny_run(tmp_path / "run")
        lies("/second/place/mine.json", "a" * 64)
        resume_run(tmp_path / "run")
        lies("/second/place/mine.json", "b" * 64)
        with pytest.raises(RunError, match="reality /first/place/mine.json, reality_sha256 a{12}, now .* b{12}"):
            resume_run(tmp_path / "run")
