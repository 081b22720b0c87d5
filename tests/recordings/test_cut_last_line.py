"""Logs whose last line has no end: of a logger that was killed it is left out, with a note; a whole one is kept."""

from __future__ import annotations

import numpy as np
import pytest
from two_joint_log import a_mapping, read

from hts.errors import RecordingError

HEADER = "t,K_tau,H_tau,amps\n"


def text(amps="{:.4f}", count=600, header=HEADER):
    rows = [f"{20 * i},{i % 7},{-(i % 5)},{amps.format(-1000.125 * (i % 9))}" for i in range(count)]
    return header + "\n".join(rows) + "\n"


def log(folder, content, name="log.csv"):
    file = folder / name
    file.write_text(content)
    return file


@pytest.mark.parametrize("end", ["1", "12000", "12000,", "12000,3,-2", "12000,3,-2,-", "12000,3,-2,1e", '12000,3,"-2'])
def test_a_last_line_that_is_cut_is_left_out_and_its_number_noted(tmp_path, end):
    whole = read(log(tmp_path, text(), "whole.csv"), a_mapping())
    cut = read(log(tmp_path, text() + end), a_mapping())
    assert cut.num_samples == whole.num_samples == 600
    for name in whole.channels:
        assert np.array_equal(cut.values(name), whole.values(name))
    assert cut.notes["last_line_dropped"] == (
        f"line 602, the last one, cut off as by a logger that is killed ('{end}')"
    )
    assert "last_line_dropped" not in whole.notes and "last_line_kept" not in whole.notes


@pytest.mark.parametrize("cut", ["-3000.37", "-3000.", "-3000", "-3"])
def test_a_number_with_fewer_decimals_than_all_others_is_cut(tmp_path, cut):
    found = read(log(tmp_path, text() + f"12000,3,-2,{cut}"), a_mapping())
    assert found.num_samples == 600 and f"'12000,3,-2,{cut}'" in found.notes["last_line_dropped"]


def test_a_whole_last_line_without_a_line_feed_is_kept(tmp_path):
    found = read(log(tmp_path, text() + "12000,3,-2,-3000.3750"), a_mapping())
    assert found.num_samples == 601 and found.values("draw")[-1] == pytest.approx(3.000375)
    assert not [key for key in found.notes if key.startswith("last_line")]


def test_a_short_number_among_numbers_of_any_length_is_kept_and_that_nobody_can_tell_is_noted(tmp_path):
    found = read(log(tmp_path, text("{:g}") + "12000,3,-2,-3"), a_mapping())
    assert found.num_samples == 601 and "last_line_dropped" not in found.notes
    said = "line 602 has no line feed: nobody can tell whether its last number, -3, is whole"
    assert found.notes["last_line_kept"] == said


def test_a_column_that_is_not_read_says_nothing(tmp_path):
    given = a_mapping()
    del given["channels"]["draw"]
    found = read(log(tmp_path, text() + "12000,3,-2,-30"), given)
    assert found.num_samples == 601 and not [key for key in found.notes if key.startswith("last_line")]


def test_a_time_that_is_cut_does_not_come_after_the_row_before(tmp_path):
    rows = "".join(f"{i % 7},{-(i % 5)},{-1000 * (i % 9)},{20 * i}\n" for i in range(600))
    found = read(log(tmp_path, "K_tau,H_tau,amps,t\n" + rows + "3,-2,-3000,120"), a_mapping())
    assert found.num_samples == 600 and "line 602" in found.notes["last_line_dropped"]


def test_a_table_without_a_header_line_and_with_text_before_it_has_its_lines_counted_all(tmp_path):
    given = a_mapping(header=False, preamble=2, time={"column": 0, "unit": "ms"}, joints=None)
    given["channels"] = {"joint_torque": {"columns": [2, 1], "unit": "N*m"}}
    found = read(log(tmp_path, text(header="a robot\nwalks\n") + "12000,3"), given)
    assert found.num_samples == 600 and "line 603" in found.notes["last_line_dropped"]


def test_other_lines_stay_refused(tmp_path):
    lines = text().splitlines(keepends=True)
    lines[300] = lines[300].rpartition(",")[0] + "\n"
    for content in ("".join(lines), "".join(lines) + "12000,3", text() + "12000,3,-2,ERR\n", text() + "1,2,3,4,5"):
        with pytest.raises(RecordingError, match="line (301|602)"):
            read(log(tmp_path, content), a_mapping())


def test_runs_before_the_last_one_have_no_note_of_it(tmp_path):
    from hts.recordings.csv_reader import make

    rows = text(header="t,K_tau,H_tau,amps,run\n").splitlines()
    rows = [rows[0], *(f"{row},{int(at >= 300)}" for at, row in enumerate(rows[1:]))]
    file = log(tmp_path, "\n".join(rows) + "\n12000,3")
    first, second = make({}).read_all([file], a_mapping(runs={"column": "run"}), _robot())
    assert "last_line_dropped" not in first.notes and "line 602" in second.notes["last_line_dropped"]


def _robot():
    from two_joint_log import TWO_JOINTS

    return TWO_JOINTS
