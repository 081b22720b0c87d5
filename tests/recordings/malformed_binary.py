"""Logs in binary formats, whole and damaged."""

from __future__ import annotations

import io
import json
import os
import shutil
import zipfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from malformed_case import ROBOT, ROWS, Case, bad, columns, either, good


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


@good
def npz_as_it_is(made: Case) -> None:
    made.write(npz(made), "log.npz")


@good
def parquet_as_it_is(made: Case) -> None:
    made.write(parquet(made), "log.parquet")


@good
def lerobot_as_it_is(made: Case) -> None:
    lerobot(made)
