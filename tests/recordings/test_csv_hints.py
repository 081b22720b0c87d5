"""CSV files that cannot be read: what is wrong with them, where, and the command that mends them."""

from __future__ import annotations

import bz2
import gzip
import lzma
import shlex
import shutil
import subprocess

import numpy as np
import pytest
from two_joint_log import TWO_JOINTS, a_log, a_mapping, read

from hts.errors import ConfigError, HtsError, RecordingError
from hts.recordings.suggest import suggested_mapping

ROWS = [f"{20 * i},{i % 7},{-(i % 5)},{-1000 * (i % 9)}" for i in range(600)]
TEXT = "t,K_tau,H_tau,amps\n" + "\n".join(ROWS) + "\n"


def refusal(log, mapping=None):
    with pytest.raises(HtsError) as refused:
        read(log, mapping or a_mapping())
    assert "\n" not in str(refused.value)
    return str(refused.value)


def written(folder, content, name="log.csv"):
    log = folder / name
    log.write_bytes(content if isinstance(content, bytes) else content.encode())
    return log


def run(said):
    """What the advice does, given to a shell."""
    command = said.split("`")[1]
    subprocess.run(["sh", "-c", command], check=True)
    return shlex.split(command)[-1]


# ------------------------------------------------------------------------------------------------ hints where they fit


def test_a_word_far_below_is_no_line_of_units(tmp_path):
    said = refusal(written(tmp_path, TEXT.replace("\n10000,3,", "\n10000,ERR,")))
    assert "line 502 of the file" in said and "invalid value 'ERR'" in said and "units_row" not in said


def test_a_word_among_the_stamps_is_shown(tmp_path):
    said = refusal(written(tmp_path, TEXT.replace("\n10000,", "\nERR,")))
    assert "time column 't' does not hold numbers (in a later row 'ERR')" in said


def test_a_ragged_row_below_numbers_is_no_text_before_the_table(tmp_path):
    said = refusal(written(tmp_path, TEXT.replace("\n80,", "\n80,3,")))
    assert "line 6 of the file: Expected 4 columns, got 5" in said and "preamble" not in said


def test_several_lines_of_text_before_the_table_are(tmp_path):
    assert "say preamble: the number" in refusal(written(tmp_path, "a robot\nwalks\nagain\n" + TEXT))


@pytest.mark.parametrize("end", ["\n12\n", "\n12000,3\n", "\n12000,3,-2\n\n"])
def test_a_last_line_that_lacks_cells_but_has_an_end_is_called_cut_off_and_the_command_leaves_it_out(tmp_path, end):
    log = written(tmp_path, TEXT.rstrip() + end, "my log.csv")
    said = refusal(log)
    assert "line 602, the last one, is cut off" in said and "preamble" not in said and "units_row" not in said
    assert np.array_equal(
        read(type(log)(run(said)), a_mapping()).values("draw"),
        read(written(tmp_path, TEXT), a_mapping()).values("draw"),
    )


def test_a_whole_last_line_with_a_word_in_it_is_not_cut_off(tmp_path):
    said = refusal(written(tmp_path, TEXT + "12000,3,-2,ERR\n"))
    assert "line 602 of the file" in said and "cut off" not in said


# ------------------------------------------------------------------------------------------------ no UTF-8


@pytest.mark.parametrize(
    ("encoding", "expected"),
    [
        ("utf-16", "begins with the bytes ff fe, which is UTF-16."),
        ("utf-32", "begins with the bytes ff fe 00 00, which is UTF-32."),
        ("utf-16-be", "every second byte is 0, so it is UTF-16BE."),
        ("latin-1", "line 1 holds the byte 0xb0, which is no UTF-8; in LATIN1 it is '°'."),
        ("cp1252", "line 1 holds the byte 0x80, which is no UTF-8; in WINDOWS-1252 it is '€'."),
    ],
)
def test_another_encoding_is_named_and_the_command_converts_it(tmp_path, encoding, expected):
    sign = {"latin-1": "°", "cp1252": "€"}.get(encoding, "")
    log = written(tmp_path, TEXT.replace("K_tau", f"K_tau{sign}").encode(encoding), "my log.csv")
    mapping = a_mapping(joints={"hip": "H", "knee": "K"})
    mapping["channels"]["joint_torque"]["columns"] = ["H_tau", f"K_tau{sign}"]
    said = refusal(log, mapping)
    assert said.startswith(f"{log}: {expected} Convert it: `iconv -f ")
    with pytest.raises(RecordingError) as refused:
        suggested_mapping(log, TWO_JOINTS)
    assert str(refused.value) == said
    assert run(said) == str(log)  # logs of a bundle are known by their names, and a second file would be one of the row
    assert [path.name for path in tmp_path.iterdir()] == [log.name]
    assert read(log, mapping).num_samples == 600


def test_a_byte_that_is_no_text_in_a_wanted_cell_is_named(tmp_path):
    said = refusal(written(tmp_path, TEXT.replace("\n80,4,", "\n80,°,").encode("latin-1")))
    assert "line 6 holds the byte 0xb0" in said


@pytest.mark.parametrize(
    ("pack", "tool", "ending"),
    [(gzip.compress, "gunzip", ".gz"), (bz2.compress, "bunzip2", ".bz2"), (lzma.compress, "unxz", ".xz")],
)
@pytest.mark.parametrize("named", [True, False])
def test_a_packed_log_is_to_be_unpacked_and_none_of_it_is_printed(tmp_path, pack, tool, ending, named):
    log = written(tmp_path, pack(TEXT.encode()), f"my log.csv{ending if named else ''}")
    said = refusal(log)
    assert said.startswith(f"{log}: packed (") and f"Unpack it first: `{tool} " in said
    with pytest.raises(RecordingError) as refused:
        suggested_mapping(log, TWO_JOINTS)
    assert str(refused.value) == said
    if shutil.which(tool):
        run(said)
        (left,) = tmp_path.iterdir()
        assert left.name == "my log.csv" and read(left, a_mapping()).num_samples == 600


def test_what_a_terminal_would_obey_is_not_in_the_message(tmp_path):
    assert refusal(written(tmp_path, TEXT.replace("\n80,4,", "\n80,\x1b[2J4,"))).isprintable()


# ------------------------------------------------------------------------------------------------ files, units, dates


def test_several_files_for_one_recording_are_named(tmp_path):
    files = [a_log(tmp_path, name=name) for name in ("01.csv", "01.bak.csv")]
    with pytest.raises(ConfigError) as refused:
        read(files, a_mapping())
    assert f"2 files for one recording: {files[0]}, {files[1]}. Take away those that are no log" in str(refused.value)


def test_a_unit_that_is_none_ends_one_sentence(tmp_path):
    mapping = a_mapping()
    mapping["channels"]["joint_torque"]["unit"] = "Nm"
    said = refusal(a_log(tmp_path), mapping)
    assert "Did you mean 'N*m'?" in said and said.endswith("(hts.units.define), found 'Nm'.")


@pytest.mark.parametrize(("minutes", "told"), [(60, True), (10, False)])
def test_dates_that_go_back_are_shown_as_dates_and_an_hour_is_daylight_saving(tmp_path, minutes, told):
    start = np.datetime64("2025-10-26T02:59:59.000")
    steps = np.arange(100) * np.timedelta64(20, "ms")
    steps[50:] -= np.timedelta64(minutes, "m")
    rows = [f"{start + step},{i % 7},{-(i % 5)},{-1000 * (i % 9)}" for i, step in enumerate(steps)]
    said = refusal(a_log(tmp_path, rows), a_mapping(time={"column": "t", "unit": "iso"}))
    then = "02:00:00" if told else "02:50:00"
    assert f"line 52 of the file: column 't' reads 2025-10-26 02:59:59.98, then 2025-10-26 {then}. " in said
    assert ("daylight saving" in said) == told


@pytest.mark.parametrize(
    ("stamps", "told"),
    [
        ([0, 20, 20, 40], "Two rows share a stamp: take out the one that is a copy, or write stamps with more digits"),
        ([0, 20, 40, 10, 30], "where the clock was set back, cut the log there, since sorting mixes them"),
    ],
)
def test_stamps_that_do_not_increase_are_not_just_to_be_sorted(tmp_path, stamps, told):
    assert told in refusal(written(tmp_path, "t,K_tau,H_tau,amps\n" + "".join(f"{one},1,2,-2000\n" for one in stamps)))


def test_a_parquet_file_that_is_read_as_text_is_called_one(tmp_path):
    import pyarrow
    from pyarrow import parquet

    from hts.recordings.encoding import not_plain

    parquet.write_table(pyarrow.table({"t": [0.0, 1.0]}), tmp_path / "walk.parquet")
    assert not_plain(tmp_path / "walk.parquet").startswith("a Parquet file, expected text. Write `reader: parquet`")
