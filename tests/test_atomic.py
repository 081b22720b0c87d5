"""One way to write a file: whole or not at all, on the disk when it returns, an error that names the file."""

from __future__ import annotations

import errno
import os
import stat
from contextlib import nullcontext

import pytest

from hts.atomic import atomic_write, temporary_of


def test_a_file_appears_with_its_folders_and_nothing_is_left_beside_it(tmp_path):
    path = atomic_write(tmp_path / "new" / "a.json", "µ\n")
    assert path.read_bytes() == "µ\n".encode()
    assert [entry.name for entry in path.parent.iterdir()] == ["a.json"]


def test_what_a_killed_writer_left_is_overwritten(tmp_path):
    left = temporary_of(tmp_path / "a.bin")
    left.write_text("half of")
    atomic_write(tmp_path / "a.bin", b"whole")
    assert (tmp_path / "a.bin").read_bytes() == b"whole" and not left.exists()


@pytest.mark.parametrize("where", ["fsync", "replace"])
def test_a_full_disk_leaves_the_old_file_and_names_it(tmp_path, monkeypatch, where):
    path = atomic_write(tmp_path / "a.json", "old")

    def full(*given):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(os, where, full)
        with pytest.raises(OSError, match=r"No space left on device: '.*a\.json'") as caught:
            atomic_write(path, "new")
    assert caught.value.errno == errno.ENOSPC and caught.value.filename == str(path)
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.json"]


def test_a_folder_that_is_a_file_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file/a.json"):
        atomic_write(tmp_path / "file" / "a.json", "text")


def test_everything_is_flushed_before_it_is_moved(tmp_path, monkeypatch):
    order = []
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda handle: order.append("fsync") or fsync(handle))
    monkeypatch.setattr(os, "replace", lambda *given: order.append("replace") or replace(*given))
    atomic_write(tmp_path / "a", "text")
    assert order == ["fsync", "replace", "fsync"]  # the file, then the folder that names it


@pytest.mark.parametrize(("number", "raises"), [(errno.EINVAL, False), (errno.EIO, True)])
def test_a_folder_that_its_file_system_cannot_sync_is_no_fault_and_a_broken_disk_is_one(
    tmp_path, monkeypatch, number, raises
):
    fsync = os.fsync

    def files_alone(handle):
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError(number, os.strerror(number))
        fsync(handle)

    monkeypatch.setattr(os, "fsync", files_alone)
    with pytest.raises(OSError, match="Input/output error") if raises else nullcontext():
        atomic_write(tmp_path / "a", "text")
    assert (tmp_path / "a").read_text() == "text" and [entry.name for entry in tmp_path.iterdir()] == ["a"]
