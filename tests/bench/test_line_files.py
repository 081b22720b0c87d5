"""Files of lines: what is no UTF-8, what only looks like the end of a line, a last newline, and locks."""

from __future__ import annotations

import errno
import fcntl
import importlib.util
from pathlib import Path

import pytest
from batch.lines import append, read_lines
from batch.queue import _busy
from fake_lines import line

from hts.errors import RunError

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def test_a_byte_that_is_no_utf_8_is_named_with_its_line(tmp_path):
    path = tmp_path / "lines.jsonl"
    append(path, line(seed=0))
    path.write_bytes(
        path.read_bytes()
        + line(seed=1).model_dump_json().replace("ours", "o\udcff", 1).encode("utf-8", "surrogateescape")
        + b"\n"
    )
    with pytest.raises(
        RunError, match=r"lines\.jsonl, line 2: the line: Invalid JSON: .*Take the file as it was"
    ) as error:
        read_lines([path])
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("mark", ["\x85", "\u2028", "\u2029"])
def test_only_a_newline_ends_a_line(tmp_path, mark):
    path = tmp_path / "lines.jsonl"
    append(path, line(status="failed", error=f"boom{mark}bang", result=None))
    append(path, line(seed=1, key="other"))
    assert [row.error for row in read_lines([path])] == [f"boom{mark}bang", None]


def test_a_last_line_that_lacks_only_its_newline_is_a_line_and_gets_it(tmp_path):
    path = tmp_path / "lines.jsonl"
    append(path, line(seed=0))
    append(path, line(seed=1))
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    assert [row.seed for row in read_lines([path])] == [0, 1]
    append(path, line(seed=2))
    assert path.read_bytes().startswith(whole) and [row.seed for row in read_lines([path])] == [0, 1, 2]


@pytest.mark.parametrize("cut", [1, 2, 40], ids="{} bytes lost".format)
def test_a_last_line_that_lacks_more_is_none_and_goes(tmp_path, cut):
    path = tmp_path / "lines.jsonl"
    append(path, line(seed=0))
    first = path.read_bytes()
    append(path, line(seed=1))
    path.write_bytes(path.read_bytes()[: -1 - cut])
    assert [row.seed for row in read_lines([path])] == [0]
    append(path, line(seed=2))
    assert path.read_bytes().startswith(first) and [row.seed for row in read_lines([path])] == [0, 2]


def test_a_table_of_such_a_file_is_one_line_too(tmp_path, capsys):
    spec = importlib.util.spec_from_file_location("realities", BENCHMARKS / "realities.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    (tmp_path / "lines.jsonl").write_bytes(b'{"version": 1, "key": "\xff"}\n')
    assert module.main(["table", "--lines", str(tmp_path / "lines.jsonl")]) != 0
    assert "lines.jsonl, line 1: " in capsys.readouterr().err


def test_where_there_are_no_locks_lines_are_added_and_no_folder_is_busy(tmp_path, monkeypatch):
    (tmp_path / ".lock").touch()
    with (tmp_path / ".lock").open("r+") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert _busy(tmp_path) and not _busy(tmp_path / "nothing")

    def refuse(handle, operation):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    assert not _busy(tmp_path)
    append(tmp_path / "lines.jsonl", line(seed=3))
    assert [row.seed for row in read_lines([tmp_path / "lines.jsonl"])] == [3]
