"""The world `field`: rows of one comparison that were recorded on two days, told by their stamps."""

from __future__ import annotations

import pytest
from field_folder import SECONDS, bundle, field, fill_in, write_log

from hts.errors import WaitingForRobot
from hts.recordings.doubts import remarks
from hts.worlds.field_pause import NOTE, ORDER_NOTE, OVERLAP_NOTE, _begin

DAY = 86400.0


def told(run, policy, robot, begins, first="", note=NOTE) -> list[str]:
    """What is said of a head-to-head whose rows' logs begin at these stamps, s. first: the stamp of one more line in
    front of each log, without data."""

    def ask():
        return field(run).head_to_head(policy, policy, [0.8])

    with pytest.raises(WaitingForRobot):
        ask()
    fill_in(run)
    for row, begin in enumerate(begins):
        log = bundle(run) / "logs" / f"{row:02d}.csv"
        write_log(log, robot)
        head, *rows = (line.split(",", 1) for line in log.read_text().splitlines())
        moved = [",".join(head), *(f"{float(stamp) + begin:.6f},{rest}" for stamp, rest in rows)]
        lost = [first + "," * moved[0].count(",")] if first else []
        log.write_text("\n".join([moved[0], *lost, *moved[1:]]) + "\n")
    return [line for line in remarks(ask()) if note in line]


@pytest.mark.parametrize(
    ("begins", "said"),
    [
        ([7.0, 10.1, DAY, DAY + 3.1], "row 02 begins 24.0 h after row 01 had ended"),
        ([7.0, 10.1, 13.2, 2700.0], "row 03 begins 45 min after row 02 had ended"),
        ([DAY, DAY + 3.1, 5.0, 8.1], "row 02 begins before row 01"),
    ],
    ids=["the second half on another day", "a long break", "the computer began anew"],
)
def test_rows_of_two_visits_are_told_of(run, policy, robot, begins, said):
    (line,) = told(run, policy, robot, begins)
    assert line.startswith("note: recorded_apart of 4 of 4 recordings, the first 00.csv: session ")
    assert f"by its stamps {said}. Rows of a session balance" in line


@pytest.mark.parametrize("begins", [[0.0] * 4, [5.0 + (SECONDS + 1.0) * row for row in range(4)], [0.0, 60, 3, 200]])
def test_nothing_is_said_of_one_visit_nor_of_clocks_that_begin_with_each_log(run, policy, robot, begins):
    assert told(run, policy, robot, begins) == []


def test_a_log_whose_first_line_has_no_time_says_nothing(run, policy, robot):
    assert told(run, policy, robot, [7.0, 10.1, DAY, DAY + 3.1], first="nan") == []


TODAY = 1.8e9  # s since 1970
IN_ORDER = [TODAY + 5.0 * row for row in range(4)]


@pytest.mark.parametrize(
    ("order", "said"), [([0, 2, 3, 1], "in the order 00, 03, 01, 02, planned was 00, 01, 02, 03"), ([0, 1, 2, 3], "")]
)
def test_rows_that_were_walked_in_another_order_are_told_of(run, policy, robot, order, said):
    lines = told(run, policy, robot, [IN_ORDER[place] for place in order], note=ORDER_NOTE)
    assert [said in line for line in lines] == ([True] if said else [])


@pytest.mark.parametrize(("shift", "expected"), [(-3.0, 1), (-2.3, 0), (0.0, 0)])
def test_logs_that_have_seconds_in_common_are_told_of(run, policy, robot, shift, expected):
    begins = [*IN_ORDER[:2], IN_ORDER[2] + shift, IN_ORDER[3]]  # logs of 3 s
    lines = told(run, policy, robot, begins, note=OVERLAP_NOTE)
    assert len(lines) == expected
    assert all("rows 01 and 02 have 1.0 s in common, which count twice then" in line for line in lines)


def test_a_stretch_that_a_mapping_cuts_out_begins_where_it_is_cut(run, policy, robot):
    assert told(run, policy, robot, [TODAY] * 4, note=OVERLAP_NOTE) != []
    mapping = {"reader": "csv", "time": {"column": "time", "unit": "s"}}
    log = bundle(run) / "logs" / "00.csv"
    assert _begin([log], {**mapping, "cut": [2.5, 9.0]}) == _begin([log], mapping) + 2.5
