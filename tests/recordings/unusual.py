"""Logs in text that are unusual, yet all right."""

from __future__ import annotations

from malformed_case import Case, good


@good
def as_it_is(made: Case) -> None:
    made.write()


@good
def lines_as_windows_ends_them(made: Case) -> None:
    made.write(made.table().replace("\n", "\r\n"))


@good
def byte_order_mark(made: Case) -> None:
    made.write(b"\xef\xbb\xbf" + made.table().encode())


@good
def no_last_line_end(made: Case) -> None:
    made.write(made.table().rstrip("\n"))


@good
def columns_in_another_order(made: Case) -> None:
    order = made.chance.sample(range(4), 4)
    made.names = [made.names[at] for at in order]
    made.rows = [[row[at] for at in order] for row in made.rows]
    made.write()


@good
def more_columns(made: Case) -> None:
    made.names.append("märk")
    for row in made.rows:
        row.append(made.chance.choice(["", "x", "1", '"a,b"']))
    made.write()


@good
def quoted_cells(made: Case) -> None:
    made.names = [f'"{name}"' for name in made.names]
    made.write()


@good
def scientific_numbers(made: Case) -> None:
    for row in made.rows:
        row[1:] = [f"{float(cell):.8e}" for cell in row[1:]]
    made.write()


@good
def an_empty_row(made: Case) -> None:
    made.rows[made.place()][1:] = ["", "", ""]
    made.write()


@good
def a_cell_missing(made: Case) -> None:
    made.rows[made.place()][made.chance.choice([1, 2, 3])] = made.chance.choice(["", "nan", "NULL"])
    made.write()
