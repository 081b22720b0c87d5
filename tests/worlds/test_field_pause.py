"""The world `field`: rows of one comparison that were recorded on two days, told by their stamps."""

from __future__ import annotations

import pytest
from field_folder import SECONDS, bundle, field, fill_in, write_log

from hts.errors import WaitingForRobot
from hts.recordings.doubts import remarks
from hts.worlds.field_pause import NOTE

DAY = 86400.0


def told(run, policy, robot, begins, first="") -> list[str]:
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
    return [line for line in remarks(ask()) if NOTE in line]


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
