"""A run goes on with the config.yaml that it was begun with, and with no other."""

from __future__ import annotations

import hashlib
import json
import shutil

import pytest

from hts.errors import RunError
from hts.run import resume_run
from hts.run.provenance import check_config
from hts.testing.packages import kit_installed
from hts.testing.tiny_run import tiny_run


def test_a_config_that_was_edited_in_the_midst_of_a_run_is_refused_until_it_is_put_back(tmp_path):
    folder = tmp_path / "run"
    with kit_installed():
        tiny_run(folder)
        config, provenance = folder / "config.yaml", folder / "provenance.json"
        written, kept = config.read_text(), json.loads(provenance.read_text())
        begun = hashlib.sha256(config.read_bytes()).hexdigest()
        assert kept["config_sha256"] == begun
        for stage in ("final.json", "summary.json"):
            (folder / stage).unlink()
        config.write_text(written.replace("seed: 0", "seed: 5", 1))
        edited = hashlib.sha256(config.read_bytes()).hexdigest()
        with pytest.raises(RunError, match=f"config.yaml: its SHA-256 is {edited[:12]}…, .* {begun[:12]}…") as error:
            resume_run(folder)
        assert f"`hts run --config {config} --out DIR`" in str(error.value) and "\n" not in str(error.value)
        assert not (folder / "final.json").exists()
        config.write_text(written)
        before = shutil.copytree(folder, tmp_path / "before")  # begun by an hts that did not keep it
        del kept["config_sha256"]
        (before / "provenance.json").write_text(json.dumps(kept))
        (before / "config.yaml").write_text(written + "# a note\n")
        for one in (folder, before):
            resume_run(one)
            assert json.loads((one / "summary.json").read_text())["seed"] == 0


def test_an_oracle_is_begun_anew_by_its_own_command(tmp_path):
    (tmp_path / "config.yaml").write_text("preset: smoke\n")
    with pytest.raises(RunError, match="`hts oracle --config"):
        check_config(tmp_path, "0" * 64, "oracle")
