"""Logs in text that are not what they should be."""

from __future__ import annotations

import os
from collections.abc import Callable

from malformed_case import BAD, Case, bad


def cells(name: str, column: int, value: Callable[[Case, str], str], every: bool = False) -> None:
    """A kind that changes one cell of a column, or all of them."""

    def spoil(made: Case) -> None:
        rows = range(len(made.rows)) if every else [made.place()]
        for row in rows:
            made.rows[row][column] = value(made, made.rows[row][column])
        made.write()

    BAD[name] = spoil


cells("word_in_a_cell", 1, lambda made, was: made.chance.choice(["high", "n.a.", "--", "1.2.3", "0x1F", "1e", "°"]))
cells("infinity_in_a_cell", 2, lambda made, was: made.chance.choice(["inf", "-inf", "1e999", "Infinity"]))
cells("terminal_escape_in_a_cell", 3, lambda made, was: "\x1b]0;mine\x07" + was)
cells("null_byte_in_a_cell", 3, lambda made, was: "\0" + was)
cells("row_without_a_stamp", 0, lambda made, was: "")
cells("stamp_that_is_a_word", 0, lambda made, was: "noon")
cells("stamp_twice", 0, lambda made, was: "1000")
cells("clock_that_jumps_ahead", 0, lambda made, was: str(10 ** made.chance.randrange(9, 18)))
cells("gauge_that_stands_still", 3, lambda made, was: "58", every=True)
cells("gauge_of_zeros", 3, lambda made, was: "0", every=True)
cells("empty_gauge", 3, lambda made, was: "", every=True)
cells("gauge_of_words", 3, lambda made, was: "on", every=True)
cells("gauge_in_milliamperes", 3, lambda made, was: str(1000 * float(was)), every=True)
cells("gauge_counted_the_other_way", 3, lambda made, was: str(-float(was)), every=True)
cells("torque_in_another_unit", 1, lambda made, was: str(1000 * float(was) + 100), every=True)
cells("temperatures_called_torques", 2, lambda made, was: str(53 + int(float(was)) % 2), every=True)
cells("one_sample_that_no_machine_makes", 1, lambda made, was: str(made.chance.choice([-1, 1]) * 292_000))
cells("seconds_called_milliseconds", 0, lambda made, was: str(float(was) / 1000), every=True)
cells("nanoseconds_called_milliseconds", 0, lambda made, was: str(int(was) * 10**6), every=True)
cells("dates_called_milliseconds", 0, lambda made, was: f"2026-03-01 12:00:{int(was) / 1000:06.3f}", every=True)


@bad
def ragged_row(made: Case) -> None:
    row = made.rows[made.place()]
    row.append("7") if made.chance.random() < 0.5 else row.pop()
    made.write()


@bad
def cut_in_the_middle_of_a_row_and_gone_on_with(made: Case) -> None:
    at = made.place()
    made.rows[at : at + 2] = [[*made.rows[at][:2], *made.rows[at + 1]]]
    made.write()


@bad
def rows_out_of_order(made: Case) -> None:
    at = made.place()
    made.rows[at], made.rows[at + 1] = made.rows[at + 1], made.rows[at]
    made.write()


@bad
def long_gap(made: Case) -> None:
    at = made.place(20)
    del made.rows[at - 10 : at]
    made.write()


@bad
def slow_log(made: Case) -> None:
    made.rows = made.rows[:: made.chance.randrange(2, 5)]
    made.write()


@bad
def nothing(made: Case) -> None:
    made.write("")


@bad
def header_alone(made: Case) -> None:
    made.rows = []
    made.write()


@bad
def one_row(made: Case) -> None:
    made.rows = made.rows[:1]
    made.write()


@bad
def column_renamed(made: Case) -> None:
    at = made.chance.randrange(4)
    made.names[at] += "_"
    made.write()


@bad
def column_twice(made: Case) -> None:
    made.names[2] = "H_tau"
    made.given["joints"]["knee"] = "H"
    made.write()


@bad
def columns_swapped(made: Case) -> None:
    for row in made.rows:
        row[0], row[3] = row[3], row[0]
    made.write()


@bad
def random_bytes(made: Case) -> None:
    made.write(made.chance.randbytes(made.chance.randrange(1, 5000)))


@bad
def another_encoding(made: Case) -> None:
    made.write(made.table().encode(made.chance.choice(["utf-16", "utf-32"])))


@bad
def latin_1_in_a_name(made: Case) -> None:
    made.names[1] = "H_täu"
    made.given["joints"]["hip"] = "Hä"
    made.write(made.table().encode("latin-1"))


@bad
def decimal_commas(made: Case) -> None:
    text = "\n".join([";".join(made.names), *(";".join(row).replace(".", ",") for row in made.rows)])
    made.given["delimiter"] = ";"
    made.write(text)


@bad
def semicolons(made: Case) -> None:
    made.write(made.table().replace(",", ";"))


@bad
def units_row_unsaid(made: Case) -> None:
    made.rows.insert(0, ["ms", "N*m", "N*m", "A"])
    made.write()


@bad
def preamble_unsaid(made: Case) -> None:
    made.write("log of a robot\nmade today\n" + made.table())


@bad
def no_header(made: Case) -> None:
    made.write("\n".join(",".join(row) for row in made.rows))


@bad
def endless_line(made: Case) -> None:
    made.write("t,H_tau,K_tau,amps\n" + "9" * made.chance.randrange(100_000, 2_000_000))


@bad
def unclosed_quote(made: Case) -> None:
    made.rows[made.place()][1] = '"5'
    made.write()


@bad
def folder_for_a_file(made: Case) -> None:
    (made.folder / "log.csv").mkdir()
    made.files = [made.folder / "log.csv"]


@bad
def file_that_is_not_there(made: Case) -> None:
    made.files = [made.folder / f"none{made.chance.random()}.csv"]


@bad
def pipe(made: Case) -> None:
    os.mkfifo(made.folder / "log.csv")
    made.files = [made.folder / "log.csv"]


@bad
def link_to_itself(made: Case) -> None:
    (made.folder / "log.csv").symlink_to(made.folder / "log.csv")
    made.files = [made.folder / "log.csv"]


@bad
def two_files_of_different_clocks(made: Case) -> None:
    first = made.write(name="walk.csv")
    for row in made.rows:
        row[0] = str(int(row[0]) + 1_700_000_000_000)
    made.files = [first, made.write(name="gauge.csv")]
    made.given["files"] = {"walk": "walk*", "gauge": "gauge*"}
    made.given["channels"]["joint_torque"]["file"] = "walk"
    made.given["channels"]["draw"]["file"] = "gauge"
