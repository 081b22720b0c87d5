"""The world `field`: rows of one comparison that were recorded on two days, told by their stamps."""

from __future__ import annotations

import pytest
import yaml
from field_folder import SECONDS, bundle, field, fill_in, write_log

from hts.errors import WaitingForRobot
from hts.recordings.doubts import remarks
from hts.worlds.field_pause import BEGAN, BOOT, NOTE, ORDER_NOTE, OVERLAP_NOTE, _begin, with_pauses

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


def noted(run, policy, robot, begins, dates, boots) -> dict[str, str]:
    """What is said of rows whose logs' clock shows these stamps, s, where a runtime noted the rest."""
    told(run, policy, robot, begins)
    recordings = field(run).head_to_head(policy, policy, [0.8])
    files = {f"{row:02d}": [bundle(run) / "logs" / f"{row:02d}.csv"] for row in range(4)}
    mapping = yaml.safe_load((run / "field" / "mapping.yaml").read_text())
    with_notes = [
        recording.replace(notes={**recording.notes, BEGAN: date, **({BOOT: boot} if boot else {})})
        for recording, date, boot in zip(recordings, dates, boots, strict=True)
    ]
    found = with_pauses(with_notes, files, [mapping] * 4)[0].notes
    return {key: found[key] for key in (NOTE, ORDER_NOTE, OVERLAP_NOTE) if key in found}


UPTIMES = [300.0, 304.0, 308.0, 312.0]  # s
MORNINGS = [f"2026-11-{day}T09:00:{second:02d}.000+01:00" for day, second in ((29, 0), (29, 4), (30, 0), (30, 4))]


def test_two_mornings_on_which_the_computer_had_run_as_long_are_told_apart_by_their_dates(run, policy, robot):
    said = noted(run, policy, robot, UPTIMES, MORNINGS, ["a", "a", "b", "b"])
    assert list(said) == [NOTE] and "row 02 begins 24.0 h after row 01 had ended" in said[NOTE]


def test_dates_in_other_time_zones_and_over_midnight_are_one_visit(run, policy, robot):
    dates = [
        "2026-11-29T23:59:56.000+01:00",
        "2026-11-30T00:00:00.000+01:00",
        "2026-11-29T23:00:04+0000",
        "2026-11-30T01:00:08+02:00",
    ]
    assert noted(run, policy, robot, UPTIMES, dates, ["a", "a", "b", "b"]) == {}


def test_a_date_that_was_set_in_the_midst_of_a_visit_says_nothing_against_the_clock_itself(run, policy, robot):
    dates = ["1970-01-01T00:05:00+00:00", *["2026-11-30T12:00:00+00:00"] * 3]
    assert noted(run, policy, robot, UPTIMES, dates, ["a"] * 4) == {}


def test_rows_that_a_runtime_walked_in_another_order_are_told_by_its_own_clock(run, policy, robot):
    said = noted(run, policy, robot, [300.0, 308.0, 312.0, 304.0], MORNINGS, ["a"] * 4)
    assert list(said) == [ORDER_NOTE] and "in the order 00, 03, 01, 02" in said[ORDER_NOTE]


@pytest.mark.parametrize("date", ["yesterday", "2026-13-45", ""])
def test_a_date_that_is_none_is_passed_over(run, policy, robot, date):
    assert noted(run, policy, robot, UPTIMES, [date] * 4, ["", "", "", ""]) == {}
