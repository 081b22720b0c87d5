"""Folders that no library expects: one that is gone, and one whose name is no text."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys

import pytest

from hts.cli.main import main


def test_in_a_folder_that_was_deleted_a_command_says_so(tmp_path):
    (tmp_path / "gone").mkdir()
    hts = f"{sys.executable} -m hts.cli.main run --objective power --robot go1 --preset smoke --out {tmp_path}/run"
    script = f"cd {tmp_path}/gone; rmdir ../gone; {hts}"
    done = subprocess.run(["sh", "-c", script], capture_output=True, text=True, check=False)  # libraries would abort
    said = "The folder in which hts is typed was moved away or deleted. `cd` to one that is there."
    assert (done.returncode, done.stderr) == (2, f"error: {said}\n")
    assert list(tmp_path.iterdir()) == []


def bound_by_permissions():
    """Not even root opens what its mode forbids, in the program that is started next: Linux lets root give that up
    (PR_CAPBSET_DROP of CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH, linux/prctl.h and linux/capability.h)."""
    if os.geteuid() == 0:
        for capability in (1, 2):
            ctypes.CDLL(None).prctl(24, capability, 0, 0, 0)


@pytest.mark.skipif(not sys.platform.startswith("linux") and os.geteuid() == 0, reason="root may enter every folder")
@pytest.mark.parametrize("closed", [".", "here"])
def test_in_a_folder_that_may_not_be_entered_a_command_says_so(tmp_path, closed):
    here = tmp_path / "above" / "here"
    here.mkdir(parents=True)
    shut = here.parent / closed
    script = f"cd {here}; chmod 600 {shut}; {sys.executable} -m hts.cli.main new objective quiet"
    done = subprocess.run(
        ["sh", "-c", script], capture_output=True, text=True, check=False, preexec_fn=bound_by_permissions
    )
    shut.chmod(0o700)
    said = (
        f"{here}: the folder in which hts is typed cannot be entered (Permission denied). `cd` to another one, or "
        "change the owner or mode of it or of a folder above it."
    )
    assert (done.returncode, done.stderr) == (2, f"error: {said}\n")
    assert list(here.iterdir()) == []


def test_a_run_folder_whose_name_is_no_text_is_to_be_renamed_and_nothing_in_it_deleted(tmp_path, capsys):
    folder = tmp_path / os.fsdecode(b"b\xffd")
    folder.mkdir()
    (folder / "config.yaml").touch()
    assert main(["resume", str(folder)]) == 2
    assert "a name in this path is no text (bytes that are not UTF-8). Rename it" in capsys.readouterr().err
