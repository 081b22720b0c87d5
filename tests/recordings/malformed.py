"""Logs and mappings that are not what they should be, by kind: a table, and what makes a case of each.

Every kind takes a whole log and its mapping and spoils one thing. `BAD` must be refused, `GOOD` is unusual and must be
stored as it is, `EITHER` flips bits or cuts binary files, where damage may lie in what nobody reads.
"""

from __future__ import annotations

import io
import json
import os
import random
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import yaml

ROWS = 120
NAMES = ("t", "H_tau", "K_tau", "amps")


@dataclass
class Case:
    """files: to import; mapping: text of the mapping; both as the kind spoiled them."""

    folder: Path
    chance: random.Random
    rows: list[list[str]] = field(default_factory=list)
    names: list[str] = field(default_factory=lambda: list(NAMES))
    given: dict[str, Any] = field(default_factory=dict)
    text: str | bytes | None = None
    files: list[Path] = field(default_factory=list)

    def table(self) -> str:
        return "\n".join([",".join(self.names), *(",".join(row) for row in self.rows)]) + "\n"

    def write(self, content: str | bytes | None = None, name: str = "log.csv") -> Path:
        path = self.folder / name
        content = self.table() if content is None else content
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        self.files = [path]
        return path

    def place(self, first: int = 5) -> int:
        return self.chance.randrange(first, len(self.rows) - 5)


def case(folder: Path, seed: int) -> Case:
    """A whole log of two joints and its mapping, of its own phase."""
    made = Case(folder, random.Random(seed))
    phase = made.chance.random()
    for step in range(ROWS):
        hip, knee = np.sin(step / 9 + phase), np.cos(step / 7 + phase)
        made.rows.append([str(1000 + 20 * step), f"{5 * hip:.4f}", f"{4 * knee:.4f}", f"{3 + hip**2:.4f}"])
    made.given = {
        "time": {"column": "t", "unit": "ms"},
        "rate_hz": 50,
        "joints": {"hip": "H", "knee": "K"},
        "channels": {
            "joint_torque": {"columns": "{joint}_tau", "unit": "N*m"},
            "draw": {"columns": "amps", "unit": "A", "idle": 1.9},
        },
    }
    return made


def columns(made: Case) -> dict[str, np.ndarray]:
    values = np.array([[float(cell) for cell in row] for row in made.rows])
    return dict(zip(made.names, values.T, strict=True))


Kind = Callable[[Case], None]
BAD: dict[str, Kind] = {}
GOOD: dict[str, Kind] = {}
EITHER: dict[str, Kind] = {}


def bad(spoil: Kind) -> Kind:
    BAD[spoil.__name__] = spoil
    return spoil


def good(spoil: Kind) -> Kind:
    GOOD[spoil.__name__] = spoil
    return spoil


def either(spoil: Kind) -> Kind:
    EITHER[spoil.__name__] = spoil
    return spoil


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
def cut_in_the_middle_of_a_row(made: Case) -> None:
    whole = made.table()
    made.write(whole[: whole.rindex(",", 0, whole.rindex(","))])


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


# -------------------------------------------------------------------------------------------------------- mappings


def mappings(name: str, *changes: Callable[[dict[str, Any]], Any]) -> None:
    """A kind that changes the mapping in one of several ways."""

    def spoil(made: Case) -> None:
        made.write()
        made.chance.choice(changes)(made.given)

    BAD[name] = spoil


def channel(name: str, **what: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda given: given["channels"][name].update(what)


mappings("misspelt_key", lambda g: g.update(rate_htz=50), lambda g: g.pop("time"), channel("draw", unti="A"))
mappings("unit_nobody_knows", *(channel("draw", unit=one) for one in ("Nm", "ampère?", "9**9**9", "", "A" * 100)))
mappings("unit_of_another_quantity", channel("joint_torque", unit="A"), channel("joint_torque", unit="rad/s"))
mappings("joint_nobody_has", lambda g: g["joints"].update(ankle="A"), lambda g: g["joints"].pop("hip"))
mappings("no_idle_level", lambda g: g["channels"]["draw"].pop("idle"), channel("draw", idle="CHECK"))
mappings("no_channel", lambda g: g.update(channels={}), lambda g: g.pop("channels"), lambda g: g.update(channels=3))
mappings(
    "rate_that_is_none", *(lambda g, r=r: g.update(rate_hz=r) for r in (0, -5, float("nan"), float("inf"), "fast"))
)
mappings("rate_beyond_the_log", *(lambda g, r=r: g.update(rate_hz=r) for r in (1e3, 1e9, 1e300)))
mappings("numbers_that_are_none", channel("draw", scale=float("nan")), channel("draw", offset=float("inf")))
mappings("limits_turned_round", channel("draw", limits=[9, 1]), channel("draw", limits=[1]))
mappings("limits_that_do_not_hold", channel("draw", limits=[0, 1]), channel("joint_torque", limits=[-1e-3, 1e-3]))
mappings("cut_beside_the_log", lambda g: g.update(cut=[50, 90]), lambda g: g.update(cut=[2, 1]))
mappings("range_that_is_none", *(channel("draw", columns=one) for one in ("0..999999", "5..1", "q[1..", "..")))
mappings("reader_nobody_knows", lambda g: g.update(reader="csvv"), lambda g: g.update(reader="../../etc"))
mappings("runs_of_nothing", lambda g: g.update(runs={"column": "run"}), lambda g: g.update(runs={"gap_seconds": -1}))
mappings("labels_without_a_file", lambda g: g.update(labels={"file": "labels"}))
mappings(
    "gains_for_other_joints", lambda g: g.update(recording={"kp": [1.0]}), lambda g: g.update(recording={"kd": [1] * 9})
)
mappings(
    "facts_that_are_none", lambda g: g.update(recording={"mass_kg": -1}), lambda g: g.update(recording={"role": "x"})
)


def texts(name: str, make: Callable[[Case], str | bytes]) -> None:
    """A kind whose mapping is such a text."""

    def spoil(made: Case) -> None:
        made.write()
        made.text = make(made)

    BAD[name] = spoil


def bomb(made: Case) -> str:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, made.chance.randrange(9, 30))]
    return "\n".join(lines)


texts("key_twice", lambda made: yaml.safe_dump(made.given) + "rate_hz: 51\n")
texts("bottomless_nesting", lambda made: "a: " + made.chance.choice("[{") * made.chance.randrange(1000, 20_000))
texts("aliases_that_explode", bomb)
texts("alias_of_itself", lambda made: "a: &a [*a]\n")
texts("code_in_a_mapping", lambda made: f"a: !!python/object/apply:os.system ['touch {made.folder}/ran']\n")
texts("no_yaml", lambda made: made.chance.choice(["a: [", "{", "a: b: c", "\t- a", "'", "!!binary x: y", "%YAML 9.9"]))
texts("no_mapping_at_all", lambda made: made.chance.choice(["", "- 1", "3", "null", "text", "--- \n---\n"]))
texts("mapping_of_bytes", lambda made: b"\xff\xfe" + made.chance.randbytes(200))


# -------------------------------------------------------------------------------------------------- binary formats


def parquet(made: Case, table: dict[str, Any] | None = None) -> bytes:
    import pyarrow as pa
    from pyarrow import parquet as pq

    written = io.BytesIO()
    pq.write_table(pa.table(columns(made) if table is None else table), written)
    made.given["reader"] = "parquet"
    return written.getvalue()


def npz(made: Case, **changes: Any) -> bytes:
    written = io.BytesIO()
    np.savez_compressed(written, **{**columns(made), **changes})
    made.given["reader"] = "npz"
    return written.getvalue()


def flipped(made: Case, whole: bytes) -> bytes:
    data = bytearray(whole)
    for _ in range(made.chance.randrange(1, 6)):
        data[made.chance.randrange(len(data))] ^= 1 << made.chance.randrange(8)
    return bytes(data)


def shortened(made: Case, whole: bytes) -> bytes:
    return whole[: made.chance.randrange(1, len(whole) - 10)]


@bad
def parquet_cut_short(made: Case) -> None:
    made.write(shortened(made, parquet(made)), "log.parquet")


@either
def parquet_with_flipped_bits(made: Case) -> None:
    made.write(flipped(made, parquet(made)), "log.parquet")


@bad
def parquet_of_words(made: Case) -> None:
    table = {**columns(made), "amps": [str(cell) for cell in columns(made)["amps"]]}
    made.write(parquet(made, table), "log.parquet")


@bad
def parquet_of_lists(made: Case) -> None:
    table = {**columns(made), "amps": [[cell] * 3 for cell in columns(made)["amps"]]}
    made.write(parquet(made, table), "log.parquet")


@bad
def csv_called_parquet(made: Case) -> None:
    made.given["reader"] = made.chance.choice(["parquet", "npz"])
    made.write()


class Runs:
    """A pickle that makes a file."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self) -> Any:
        return (os.system, (f"touch {self.file}",))


@bad
def npz_of_objects(made: Case) -> None:
    objects = np.array([Runs(made.folder / "ran")] * ROWS, dtype=object)
    made.write(npz(made, amps=objects), "log.npz")


@bad
def npz_cut_short(made: Case) -> None:
    made.write(shortened(made, npz(made)), "log.npz")


@either
def npz_with_flipped_bits(made: Case) -> None:
    made.write(flipped(made, npz(made)), "log.npz")


@bad
def npz_that_announces_too_much(made: Case) -> None:
    written = io.BytesIO()
    shape = (1 << made.chance.randrange(8, 50),)
    np.lib.format.write_array_header_1_0(written, {"descr": "<f8", "fortran_order": False, "shape": shape})
    whole = columns(made)
    whole.pop("amps")
    made.given["reader"] = "npz"
    np.savez(made.folder / "log.npz", **whole)
    with zipfile.ZipFile(made.folder / "log.npz", "a") as file:
        file.writestr("amps.npy", written.getvalue() + b"\0" * 100)
    made.files = [made.folder / "log.npz"]


@bad
def npz_of_other_lengths(made: Case) -> None:
    made.write(npz(made, amps=np.arange(made.chance.randrange(0, ROWS))), "log.npz")


@bad
def npz_of_squeezed_zeros(made: Case) -> None:
    made.write(npz(made, amps=np.zeros(1 << 24)), "log.npz")


def mcap(made: Case, plain: bool = False) -> bytes:
    from mcap.writer import CompressionType
    from mcap_ros2.writer import Writer

    written = io.BytesIO()
    packing = CompressionType.NONE if plain else made.chance.choice(list(CompressionType))
    size = made.chance.choice([512, 1 << 20])
    writer = Writer(written, chunk_size=size, compression=packing, enable_crcs=not plain)
    kind = writer.register_msgdef("lab/msg/State", "float64 h_tau\nfloat64 k_tau\nfloat64 amps\n")
    for row in made.rows:
        content = dict(zip(("h_tau", "k_tau", "amps"), map(float, row[1:]), strict=True))
        writer.write_message("/state", kind, content, log_time=int(row[0]) * 10**6)
    writer.finish()
    made.given |= {"reader": "ros", "topic": "/state", "time": {"column": "log_time", "unit": "ns"}}
    made.given["joints"] = {"hip": "h", "knee": "k"}
    return written.getvalue()


if find_spec("mcap_ros2"):

    @bad
    def mcap_cut_short(made: Case) -> None:
        made.write(shortened(made, mcap(made)), "log.mcap")

    @either
    def mcap_with_flipped_bits(made: Case) -> None:
        made.write(flipped(made, mcap(made)), "log.mcap")

    @bad
    def mcap_without_the_topic(made: Case) -> None:
        made.write(mcap(made), "log.mcap")
        made.given["topic"] = made.chance.choice(["/stat", "", "/state/", "/state\x1b[2J"])

    @bad
    def mcap_without_the_field(made: Case) -> None:
        made.write(mcap(made), "log.mcap")
        wrong = ["amps[3]", "amps.value", "__class__", "a b", "amps.__init__.__globals__", "[0]"]
        made.given["channels"]["draw"]["columns"] = made.chance.choice(wrong)

    @bad
    def mcap_of_another_definition(made: Case) -> None:
        other = [b"float64 bmps", b"string  amps", b"float64 am=p", b"float64 Amps", b"float64[] ap", b"lab/X   amps"]
        text = mcap(made, plain=True).replace(b"float64 amps", made.chance.choice(other))
        made.write(text, "log.mcap")

    @good
    def mcap_as_it_is(made: Case) -> None:
        made.write(mcap(made), "log.mcap")


def lerobot(made: Case) -> Path:
    from hts.recordings.csv_reader import make
    from hts.recordings.lerobot_writer import write_dataset

    recording = make({}).read([made.write()], made.given, ROBOT()).replace(id="x")
    folder = made.folder / "set"
    write_dataset([recording], folder)
    made.files = [folder]
    made.given = {
        "reader": "lerobot",
        "rate_hz": 50,
        "joints": {"hip": "hip", "knee": "knee"},
        "channels": {
            "joint_torque": {"columns": "observation.joint_torque[{joint}]", "unit": "N*m"},
            "draw": {"columns": "observation.draw", "unit": "A", "idle": 1.9},
        },
    }
    return folder


def ROBOT() -> Any:  # noqa: N802
    """Hip and knee: 20 N·m, 30 rad/s, ±3 rad."""
    from hts.channels import Channel
    from hts.contracts import LogOnlyRobot, RobotSpec

    limits = {"torque_limit": (20.0, 20.0), "velocity_limit": (30.0, 30.0), "position_limit": ((-3.0, 3.0),) * 2}
    spec = RobotSpec.log_only("logger", ("hip", "knee"), **limits, rate_hz=50.0)
    return LogOnlyRobot(spec, [Channel("joint_torque", "N*m", (2,))])


@bad
def lerobot_of_another_version(made: Case) -> None:
    info = lerobot(made) / "meta/info.json"
    version = made.chance.choice(["v2.1", "v1", "", None, 3, ["v3.0"]])
    info.write_text(json.dumps({**json.loads(info.read_text()), "codebase_version": version}))


@bad
def lerobot_without_a_part(made: Case) -> None:
    folder = lerobot(made)
    shutil.rmtree(folder / made.chance.choice(["meta", "data"]))


@bad
def lerobot_whose_json_is_none(made: Case) -> None:
    texts = ["", "{", "[]", '"v3.0"', "[" * 50_000, "\xff", '{"codebase_version": "v3.0"}']
    (lerobot(made) / "meta/info.json").write_text(made.chance.choice(texts))


# -------------------------------------------------------------------------------------------- unusual, yet all right


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


@good
def npz_as_it_is(made: Case) -> None:
    made.write(npz(made), "log.npz")


@good
def parquet_as_it_is(made: Case) -> None:
    made.write(parquet(made), "log.parquet")


@good
def lerobot_as_it_is(made: Case) -> None:
    lerobot(made)
