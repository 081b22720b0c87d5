"""A lock that another process holds, and a file system that knows none."""

from __future__ import annotations

import errno
import fcntl

import pytest
from rich.console import Console

from hts.errors import RunError
from hts.locks import take_lock
from hts.run.progress import Progress
from hts.run.stages import Stages
from hts.worlds.realities.folder import only_one


@pytest.fixture(params=[errno.ENOLCK, errno.EOPNOTSUPP], ids=["ENOLCK", "EOPNOTSUPP"])
def no_locks(request, monkeypatch):
    """Here no lock can be taken at all."""

    def refuse(handle, operation):
        raise OSError(request.param, "no locks here")

    monkeypatch.setattr(fcntl, "flock", refuse)


def test_a_lock_is_one_handles_until_it_is_closed(tmp_path):
    path = tmp_path / ".lock"
    with path.open("w") as first, path.open("r+") as second:
        assert take_lock(first) and take_lock(first)
        assert not take_lock(second)
        first.close()
        assert take_lock(second) and take_lock(second, wait=True)


def test_where_there_are_no_locks_nobody_else_holds_one(tmp_path, no_locks):
    with (tmp_path / ".lock").open("w") as file:
        assert take_lock(file) and take_lock(file, wait=True)


@pytest.mark.parametrize("number", [errno.EACCES, errno.EWOULDBLOCK])
def test_a_lock_that_is_refused_is_anothers(tmp_path, monkeypatch, number):
    """EACCES is how network shares of Windows say it, flock(2)."""

    def refuse(handle, operation):
        raise OSError(number, "held")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with (tmp_path / ".lock").open("w") as file:
        assert not take_lock(file)


def test_a_faulty_disk_is_neither(tmp_path, monkeypatch):
    def fail(handle, operation):
        raise OSError(errno.EIO, "I/O error")

    monkeypatch.setattr(fcntl, "flock", fail)
    with (tmp_path / ".lock").open("w") as file, pytest.raises(OSError, match="I/O error"):
        take_lock(file)


def test_a_run_goes_on_where_there_are_no_locks(tmp_path, no_locks):
    stages = Stages(tmp_path, Progress(1, Console(quiet=True)))
    assert stages.do("collect", "collect", lambda report: [1]) == [1]
    stages.close()


def test_realities_are_drawn_where_there_are_no_locks(tmp_path, no_locks):
    with only_one(tmp_path / "drawn"):
        assert (tmp_path / "drawn").is_dir()


def test_one_process_at_a_time_draws_and_works(tmp_path):
    stages = Stages(tmp_path, Progress(1, Console(quiet=True)))
    with pytest.raises(RunError, match="another process is working in it"):
        Stages(tmp_path, Progress(1, Console(quiet=True)))
    stages.close()
    with only_one(tmp_path / "drawn"), pytest.raises(RunError, match="another process draws into it"):  # noqa: SIM117
        with only_one(tmp_path / "drawn"):
            pass
