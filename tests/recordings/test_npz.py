"""NPZ logs: numbers by name, nothing that could be code, no more memory than the file holds."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest

from hts.errors import RecordingError
from hts.recordings import npz_reader
from hts.recordings.npz_reader import make

STEPS = np.arange(30)


@pytest.fixture
def arrays():
    return {
        "t": 1000 + 20 * STEPS,
        "tau": np.stack([STEPS / 10, -STEPS / 10], axis=1),
        "amps": 2 + STEPS / 100,
        "run": np.repeat([1, 2, 5], 10),
    }


@pytest.fixture
def npz(mapping):
    mapping["reader"] = "npz"
    mapping["channels"]["joint_torque"]["columns"] = "tau[0..1]"
    del mapping["joints"]
    return mapping


@pytest.fixture
def read(tmp_path, npz, two_joints):
    def written(arrays):
        np.savez_compressed(tmp_path / "log.npz", **arrays)
        return make({}).read([tmp_path / "log.npz"], npz, two_joints)

    return written


def test_arrays_become_channels(read, arrays):
    recording = read(arrays)
    np.testing.assert_allclose(recording.values("joint_torque")[:, 1], -STEPS / 10, rtol=1e-6)
    np.testing.assert_allclose(recording.values("draw"), 2 + STEPS / 100, rtol=1e-6)


def test_dates_are_stamps(read, arrays, npz):
    npz["time"]["unit"] = "iso"
    arrays["t"] = np.datetime64("2026-03-01T12:00:00", "ms") + 20 * STEPS * np.timedelta64(1, "ms")
    assert read(arrays).num_samples == 30


def test_runs_are_told_apart_by_a_column_whose_clocks_begin_anew(tmp_path, arrays, npz, two_joints):
    arrays["t"] = np.tile(20 * np.arange(10), 3)
    np.savez(tmp_path / "log.npz", **arrays)
    npz["runs"] = {"column": "run", "take": [1, 5]}
    first, last = make({}).read_all([tmp_path / "log.npz"], npz, two_joints)
    assert (first.notes["run_run"], last.notes["run_run"]) == ("1", "5")
    np.testing.assert_allclose(last.values("draw"), 2 + np.arange(20, 30) / 100, rtol=1e-6)
    with pytest.raises(RecordingError, match="2 runs, where one recording is read"):
        make({}).read([tmp_path / "log.npz"], npz, two_joints)
    npz["runs"] = {"column": "run", "take": [7]}
    with pytest.raises(RecordingError, match="none of the runs in 'run' is asked for. It has 1, 2, 5"):
        make({}).read_all([tmp_path / "log.npz"], npz, two_joints)


class Boom:
    """What a pickle would run."""

    def __reduce__(self):
        return (pytest.fail, ("code from a log was run",))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"tau": np.array([Boom()] * 30, dtype=object)}, "arrays of objects are never opened, since they may be code"),
        ({"tau": np.array(["a"] * 30)}, "holds <U1, not numbers"),
        ({"tau": np.zeros((29, 2))}, r"'tau\[0\]' has 29 rows, the time 't' 30"),
        ({"tau": np.zeros((30, 1))}, r"no 'tau\[1\]': it has 1 numbers a row"),
        ({"tau": np.zeros((30, 2, 2))}, r"'tau' has shape \(30, 2, 2\)"),
        ({"amps": np.zeros((30, 3))}, r"Name its entries: 'amps\[0..2\]'"),
        ({"t": np.zeros(30)}, "time does not increase"),
        ({"tau": None}, "No column named"),
        (dict.fromkeys(("amps", "tau", "t"), np.array(["a"] * 30)), "'t' holds <U1"),  # the first that is asked for
    ],
)
def test_a_wrong_log_is_one_line_with_the_file(read, arrays, change, expected):
    whole = {name: values for name, values in {**arrays, **change}.items() if values is not None}
    with pytest.raises(RecordingError, match=expected) as refused:
        read(whole)
    assert "log.npz" in str(refused.value) and "\n" not in str(refused.value)


def header(shape: tuple[int, ...], dtype: str = "<f8") -> bytes:
    written = io.BytesIO()
    np.lib.format.write_array_header_1_0(written, {"descr": dtype, "fortran_order": False, "shape": shape})
    return written.getvalue()


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (header((1 << 40,)), "bytes, at most 1.07e.09 are read"),
        (header((1000,)) + b"\0" * 16, "8000 bytes, but 16 are there"),
        (b"\x93NUMPY\x09\x00", "not a whole NPZ file"),
        (b"hello", "not a whole NPZ file"),
    ],
)
def test_an_array_that_announces_more_than_is_there_gets_no_memory(
    tmp_path, arrays, npz, two_joints, content, expected
):
    np.savez(tmp_path / "log.npz", t=arrays["t"], amps=arrays["amps"])
    with zipfile.ZipFile(tmp_path / "log.npz", "a") as file:
        file.writestr("tau.npy", content)
    with pytest.raises(RecordingError, match=expected):
        make({}).read([tmp_path / "log.npz"], npz, two_joints)


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path, arrays, npz, two_joints, monkeypatch):
    """Zeros squeeze a thousandfold."""
    monkeypatch.setattr(npz_reader, "UNPACKED", 1 << 16)
    arrays["tau"] = np.zeros((30_000, 2))
    np.savez_compressed(tmp_path / "log.npz", **arrays)
    with pytest.raises(RecordingError, match="was squeezed into .*, as no log can be"):
        make({}).read([tmp_path / "log.npz"], npz, two_joints)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 and no more", b"\x80\x04K\x01."])
def test_a_file_that_is_no_npz_is_refused(tmp_path, npz, two_joints, content):
    (tmp_path / "log.npz").write_bytes(content)
    with pytest.raises(RecordingError, match="log.npz: not a whole NPZ file"):
        make({}).read([tmp_path / "log.npz"], npz, two_joints)
