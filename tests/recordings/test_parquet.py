"""The reader `parquet`: columns, entries of lists, dates, and files that are none."""

from __future__ import annotations

import sys

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from hts.errors import RecordingError
from hts.plugins import load
from hts.recordings.parquet_reader import make
from hts.recordings.reading import read_log

STEPS = np.arange(20)


@pytest.fixture
def columns() -> dict[str, pa.Array]:
    return {
        "t": pa.array(1000 + 20 * STEPS),
        "H_tau": pa.array(-STEPS / 2, pa.float32()),
        "K_tau": pa.array(STEPS / 2, pa.float32()),
        "amps": pa.array(2 + STEPS / 10),
    }


@pytest.fixture
def read(tmp_path, two_joints, mapping):
    """read(columns, **changes of the mapping): the recording of a Parquet file with these columns."""

    def read(columns, **changes):
        file = tmp_path / "walk.parquet"
        parquet.write_table(pa.table(columns), file)
        return make({}).read([file], {**mapping, "reader": "parquet", **changes}, two_joints)

    return read


def test_columns_become_channels(read, columns):
    recording = read(columns)
    np.testing.assert_allclose(recording.values("joint_torque"), np.stack([-STEPS, STEPS], 1) / 2)
    np.testing.assert_allclose(recording.values("draw"), 2 + STEPS / 10, rtol=1e-6)
    np.testing.assert_allclose(recording.time, STEPS / 50)


def test_the_core_offers_it_and_mappings_choose_it(tmp_path, columns, mapping, two_joints):
    registry = load()
    assert registry.log_readers["parquet"].package == "hard-to-sim"
    file = tmp_path / "walk.parquet"
    parquet.write_table(pa.table(columns), file)
    assert read_log(registry, [file], {**mapping, "reader": "parquet"}, two_joints).num_samples == 20


@pytest.mark.parametrize("kind", [pa.list_(pa.float64()), pa.list_(pa.float64(), 2), pa.large_list(pa.float64())])
def test_entries_of_a_list_are_columns(read, columns, kind):
    columns["tau"] = pa.array([[i / 2, -i / 2] for i in STEPS], kind)
    draw = {"columns": "amps", "unit": "A", "idle": 1.5}
    torque = {"columns": "tau[0..1]", "unit": "N*m"}
    recording = read(columns, joint_order=["knee", "hip"], channels={"joint_torque": torque, "draw": draw})
    np.testing.assert_allclose(recording.values("joint_torque"), np.stack([-STEPS, STEPS], 1) / 2)


def test_stamps_may_be_dates_and_keep_their_nanoseconds(read, columns):
    start = 1_763_146_355_421_617_551
    columns["t"] = pa.array(start + 20_000_000 * STEPS, pa.timestamp("ns", tz="UTC"))
    recording = read(columns, time={"column": "t", "unit": "iso"})
    np.testing.assert_allclose(recording.values("draw"), 2 + STEPS / 10, atol=1e-6)
    with pytest.raises(RecordingError, match="begins with .*2025-11-14.*say unit: iso"):
        read(columns)


@pytest.mark.parametrize("zone", ["", "Z", "+01:00"])
@pytest.mark.parametrize("kind", [pa.string(), pa.large_string()])
def test_stamps_may_be_dates_written_as_text(read, columns, kind, zone):
    """As a table of Python's isoformat() has them: without a fraction where it is 0."""
    text = [f"2026-03-01T12:00:00{f'.{20 * step:03d}' if step else ''}{zone}" for step in STEPS.tolist()]
    columns["t"] = pa.array(text, kind)
    recording = read(columns, time={"column": "t", "unit": "iso"})
    np.testing.assert_allclose(recording.values("draw"), 2 + STEPS / 10, atol=1e-6)
    columns["t"] = pa.array([*text[:-1], "noon"], kind)
    with pytest.raises(RecordingError, match="does not hold dates and times.*in a later row 'noon'"):
        read(columns, time={"column": "t", "unit": "iso"})


def test_nothing_in_a_cell_is_a_gap_and_noted(read, columns):
    columns["amps"] = pa.array([None if i == 7 else 2 + i / 10 for i in STEPS])
    columns["K_tau"] = pa.array([float("nan") if i == 3 else i / 2 for i in STEPS])
    recording = read(columns)
    np.testing.assert_allclose(recording.values("draw"), 2 + STEPS / 10, rtol=1e-6)
    assert recording.notes["incomplete_rows_filled"] == "joint_torque 1, draw 1"


def wrong(columns: dict[str, pa.Array]) -> dict[str, tuple[dict[str, pa.Array], dict, str]]:
    lists = pa.array([[1.0]] * 20)
    torque, draw = {"columns": "{joint}_tau", "unit": "N*m"}, {"unit": "A", "idle": 1.5}

    def drawn(column: str) -> dict:
        return {"channels": {"joint_torque": torque, "draw": {**draw, "columns": column}}}

    return {
        "no such column": (columns, drawn("amp"), "No column named 'amp'. Did you mean 'amps'?"),
        "text": ({**columns, "amps": pa.array(["x"] * 20)}, {}, "column 'amps' holds string, not numbers"),
        "a list as a number": ({**columns, "amps": lists}, {}, r"holds lists. Name their entries: 'amps[0..11]'"),
        "an entry of no list": (columns, drawn("amps[0]"), "'amps[0]' is an entry of a list, but the column holds"),
        "an entry too far": ({**columns, "amps": lists}, drawn("amps[4]"), "'amps[4]' is not in every row"),
        "time goes back": (
            {**columns, "t": pa.array(np.r_[0:15, 3:8] * 20)},
            {},
            "time does not increase in row 16 of the data: column 't' reads 280, then 60",
        ),
        "no time": ({**columns, "t": pa.nulls(20)}, {}, "no row has a time"),
        "infinite": ({**columns, "amps": pa.array([np.inf] * 20)}, {}, "column 'amps' is infinite in row 1"),
    }


@pytest.mark.parametrize("name", list(wrong({})))
def test_a_wrong_log_is_one_line_with_the_file(read, columns, name):
    given, changes, expected = wrong(columns)[name]
    with pytest.raises(RecordingError) as refused:
        read(given, **changes)
    assert "walk.parquet: " in str(refused.value) and expected in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("content", [b"", b"PAR1", b"PAR1" + bytes(200) + b"PAR1", b"t,amps\n1,2\n"])
def test_a_file_that_is_no_parquet_is_refused(tmp_path, mapping, two_joints, content):
    file = tmp_path / "walk.parquet"
    file.write_bytes(content)
    with pytest.raises(RecordingError, match=r"walk\.parquet: not a whole Parquet file"):
        make({}).read([file], mapping, two_joints)
    with pytest.raises(RecordingError, match="none.parquet: cannot be read"):
        make({}).read([tmp_path / "none.parquet"], mapping, two_joints)


def test_a_truncated_file_is_refused(tmp_path, mapping, two_joints, columns):
    file = tmp_path / "walk.parquet"
    parquet.write_table(pa.table(columns), file)
    whole = file.read_bytes()
    for length in (10, len(whole) // 2, len(whole) - 1):
        file.write_bytes(whole[:length])
        with pytest.raises(RecordingError, match="not a whole Parquet file"):
            make({}).read([file], mapping, two_joints)


def test_without_pyarrow_it_says_so_in_one_line(tmp_path, mapping, two_joints, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setattr("hts.recordings.arrow.find_spec", lambda name: None)
    with pytest.raises(RecordingError, match="needs pyarrow, which is not installed"):
        make({}).read([tmp_path / "walk.parquet"], mapping, two_joints)
