"""A run's folder that goes away while the run works in it."""

from __future__ import annotations

import shutil

import pytest

from hts.errors import RunError
from hts.run import algorithm, resume_run
from hts.testing.packages import kit_installed


def test_what_fails_because_the_folder_was_moved_says_that_it_was(finished, tmp_path, monkeypatch):
    folder, elsewhere = shutil.copytree(finished.folder, tmp_path / "run"), tmp_path / "elsewhere"
    with kit_installed():
        (folder / "report.html").unlink()

        def report(where):
            where.rename(elsewhere)
            (where / "report.html").read_text()

        with monkeypatch.context() as patched:
            patched.setattr(algorithm, "write_report", report)
            with pytest.raises(RunError, match="run: was moved, renamed or deleted"):
                resume_run(folder)
        assert not folder.exists()
        resume_run(elsewhere)
    assert (elsewhere / "report.html").exists()
