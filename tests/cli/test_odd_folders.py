"""Folders that no library expects: one that is gone, and one whose name is no text."""

from __future__ import annotations

import os
import subprocess
import sys

from hts.cli.main import main


def test_in_a_folder_that_was_deleted_a_command_says_so(tmp_path):
    (tmp_path / "gone").mkdir()
    hts = f"{sys.executable} -m hts.cli.main run --objective power --robot go1 --preset smoke --out {tmp_path}/run"
    script = f"cd {tmp_path}/gone; rmdir ../gone; {hts}"
    done = subprocess.run(["sh", "-c", script], capture_output=True, text=True, check=False)  # libraries would abort
    said = "The folder in which hts is typed was moved away or deleted. `cd` to one that is there."
    assert (done.returncode, done.stderr) == (2, f"error: {said}\n")
    assert list(tmp_path.iterdir()) == []


def test_a_run_folder_whose_name_is_no_text_is_to_be_renamed_and_nothing_in_it_deleted(tmp_path, capsys):
    folder = tmp_path / os.fsdecode(b"b\xffd")
    folder.mkdir()
    (folder / "config.yaml").touch()
    assert main(["resume", str(folder)]) == 2
    assert "a name in this path is no text (bytes that are not UTF-8). Rename it" in capsys.readouterr().err
