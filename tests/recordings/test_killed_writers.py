"""Writers of a recording store that are killed, disturbed, or out of disk leave nothing or everything."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
import zarr.storage._local as local_storage
from walker_recording import a_recording
from zarr.core.buffer import Buffer

from hts.errors import RecordingError
from hts.recordings import RecordingStore, partial

WRITER = """
import os, signal, sys
sys.path.insert(0, {tests!r})
from walker_recording import a_recording
from hts.recordings import RecordingStore
store = RecordingStore({store!r}, create=True)
rename = os.rename
def deadly(old, new):
    if {when!r} == "after":
        rename(old, new)
    os.kill(os.getpid(), signal.SIGKILL)
os.rename = deadly
store.write(a_recording())
"""


def run_python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=False)


@pytest.mark.parametrize("when", ["before", "after"])
def test_a_killed_writer_leaves_nothing_or_everything(store: RecordingStore, when: str) -> None:
    done = run_python(WRITER.format(tests=str(Path(__file__).parent), store=str(store.path), when=when))
    assert done.returncode == -9, done.stderr
    reader = RecordingStore(store.path)
    assert len(reader.ids()) == (1 if when == "after" else 0)
    assert reader.validate() == []
    assert len(list(store.path.glob(".partial-*"))) == (0 if when == "after" else 1)  # reading cleans nothing
    writer = RecordingStore(store.path)
    recording_id = writer.write(a_recording())
    assert writer.ids() == (recording_id,)
    assert sorted(os.listdir(store.path)) == sorted([recording_id, "zarr.json"])


BUSY_WRITER = """
import sys
sys.path.insert(0, {tests!r})
from walker_recording import a_recording
from hts.recordings import RecordingStore
store = RecordingStore({store!r}, create=True)
for block in range(100_000):
    store.write(a_recording(block=block))
"""


@pytest.mark.parametrize("milliseconds", [3, 37, 71])
def test_a_writer_killed_at_any_moment_leaves_only_whole_recordings(store: RecordingStore, milliseconds: int) -> None:
    code = BUSY_WRITER.format(tests=str(Path(__file__).parent), store=str(store.path))
    with subprocess.Popen([sys.executable, "-c", code]) as writer:
        while not store.ids():
            assert writer.poll() is None
            time.sleep(0.001)
        time.sleep(milliseconds / 1000)
        writer.kill()
    assert store.ids() and store.validate() == []
    blocks = sorted(store.read(recording_id).block for recording_id in store.ids())
    assert blocks == list(range(len(blocks)))  # none before the last one is lost


def test_a_writer_at_work_is_not_cleaned_away(store: RecordingStore) -> None:
    with partial.partial_folder(store.path) as alive:
        RecordingStore(store.path, create=True).write(a_recording())
        assert alive.is_dir()
    assert not alive.exists()


def test_a_store_half_made_when_its_writer_was_killed_is_made_whole(tmp_path: Path) -> None:
    (tmp_path / "data.zarr" / ".partial-0123").mkdir(parents=True)
    RecordingStore(tmp_path / "data.zarr", create=True)
    assert os.listdir(tmp_path / "data.zarr") == ["zarr.json"]


def test_two_writers_of_one_recording_do_not_disturb_each_other(
    store: RecordingStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    publish = partial.publish

    def after_another(folder: Path, final: Path) -> bool:
        monkeypatch.setattr(partial, "publish", publish)
        RecordingStore(store.path).write(a_recording())
        return publish(folder, final)

    monkeypatch.setattr(partial, "publish", after_another)
    recording_id = store.write(a_recording())
    assert sorted(os.listdir(store.path)) == sorted([recording_id, "zarr.json"])
    assert store.validate() == []


@pytest.mark.parametrize(
    ("number", "remedy"), [(errno.ENOSPC, "The disk is full: free some space"), (errno.EROFS, "choose another place")]
)
@pytest.mark.parametrize("place", ["mkdir", "fsync", "rename"])
def test_a_full_or_read_only_disk_leaves_nothing_behind(
    store: RecordingStore, monkeypatch: pytest.MonkeyPatch, number: int, remedy: str, place: str
) -> None:
    kept = store.write(a_recording())

    def fail(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr(partial.os, place, fail)
        with pytest.raises(RecordingError, match=remedy) as refused:
            store.write(a_recording(block=3))
    assert str(store.path) in str(refused.value)
    assert sorted(os.listdir(store.path)) == sorted([kept, "zarr.json"])
    store.write(a_recording(block=3))
    assert store.validate() == []


def test_when_one_of_two_writes_fails_the_other_is_not_left_running(
    store: RecordingStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """zarr writes the metadata of an array and of its group side by side, each in a thread."""
    put, ended = local_storage._put, []

    def full(path: Path, value: Buffer, exclusive: bool = False, **others: object) -> int:
        if exclusive:
            time.sleep(0.3)
            ended.append(path.name)
        elif path.parts[-2:] != ("time", "zarr.json"):
            return put(path, value)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr(local_storage, "_put", full)
    with pytest.raises(RecordingError, match="The disk is full"):
        store.write(a_recording())
    assert ended == ["zarr.json"]


def test_an_array_that_does_not_fit_on_the_disk_leaves_nothing_behind(store: RecordingStore) -> None:
    """A real failing write inside zarr: the kernel refuses files above 20 kB in the child process."""
    code = f"""
import resource, signal, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from walker_recording import a_recording
from hts.errors import RecordingError
from hts.recordings import RecordingStore
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
store = RecordingStore({str(store.path)!r})
recording = a_recording(10_000)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
try:
    store.write(recording)
except RecordingError as error:
    print(error)
"""
    done = run_python(code)
    assert "writing a recording failed (File too large)" in done.stdout, done.stdout + done.stderr
    assert os.listdir(store.path) == ["zarr.json"]
