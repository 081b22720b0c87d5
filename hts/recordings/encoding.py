"""What a file is that should be text and is none that can be read: packed, in UTF-16, in an old encoding."""

from __future__ import annotations

import shlex
from pathlib import Path

from hts.atomic import temporary_of

PACKED = {
    b"\x1f\x8b": ("gzip", ".gz", "gunzip"),
    b"BZh": ("bzip2", ".bz2", "bunzip2"),
    b"\xfd7zXZ\x00": ("xz", ".xz", "unxz"),
    b"\x28\xb5\x2f\xfd": ("zstd", ".zst", "unzstd --rm"),
}
"""First bytes -> what packed it, its ending, and the command that unpacks, with nothing packed left beside."""
MARKS = {
    b"\xff\xfe\x00\x00": "UTF-32",
    b"\x00\x00\xfe\xff": "UTF-32",
    b"\xff\xfe": "UTF-16",
    b"\xfe\xff": "UTF-16",
}
"""First bytes -> encoding; the longer ones come first."""
MOST_LINE = 1 << 20
HEAD = 4096
TEXT = (frozenset(range(0x20, 0x100)) | frozenset(b"\t\r\n\f")) - {0x7F}
"""Bytes that a line of text in a one-byte encoding is made of."""


def escaped(text: str) -> str:
    """Part of a file for a message: what a terminal would obey, or not show, written as Python escapes it."""
    return "".join(one if one.isprintable() else one.encode("unicode_escape").decode("ascii") for one in text)


def not_plain(path: Path) -> str:
    """What to say of a file that is packed, or whose characters have two bytes or four; "" for others."""
    try:
        with path.open("rb") as file:
            head = file.read(HEAD)
    except OSError:
        return ""
    for begin, (what, ending, command) in PACKED.items():
        if head.startswith(begin):
            named = path.suffix == ending  # the tools refuse another name
            unpack = f"`{command} {shlex.quote(str(path))}`" if named else in_place(f"{command.split()[0]} -c <", path)
            return f"packed ({what}), expected text. Unpack it first: {unpack}."
    if head.startswith(b"PAR1"):
        return (
            "a Parquet file, expected text. Write `reader: parquet` into its mapping, or import it with one of its own."
        )
    for begin, encoding in MARKS.items():
        if head.startswith(begin):
            return f"begins with the bytes {begin.hex(' ')}, which is {encoding}. {_converted(path, encoding)}"
    even, odd = head[0::2], head[1::2]
    for zeros, letters, encoding in ((even, odd, "UTF-16BE"), (odd, even, "UTF-16LE")):
        if len(head) > 7 and zeros.count(0) > 0.9 * len(zeros) and letters.count(0) == 0:
            return f"every second byte is 0, so it is {encoding}. {_converted(path, encoding)}"
    return ""


def not_utf8(path: Path) -> str:
    """What to say of text in an encoding of one byte a character: the first byte that is no UTF-8, and its line; ""
    for other files, such as binary ones."""
    with path.open("rb") as file:
        for number, line in enumerate(iter(lambda: file.readline(MOST_LINE), b""), 1):
            if not TEXT.issuperset(line):
                return ""
            try:
                line.decode("utf-8")
            except UnicodeDecodeError as error:
                byte = line[error.start]
                encoding = "LATIN1" if byte >= 0xA0 else "WINDOWS-1252"
                letter = bytes([byte]).decode("cp1252", "replace")
                return (
                    f"line {number} holds the byte 0x{byte:02x}, which is no UTF-8; in {encoding} it is '{letter}'. "
                    f"{_converted(path, encoding)}"
                )
    return ""


def in_place(command: str, path: Path) -> str:
    """For a shell: `path` replaced by what the command makes of it, once that is whole. A second file beside the log is
    of no use where logs are known by their names, and would count as another part of it."""
    log, part = shlex.quote(str(path)), shlex.quote(str(temporary_of(path)))
    return f"`{command} {log} > {part} && mv {part} {log}`"


def _converted(path: Path, encoding: str) -> str:
    return f"Convert it: {in_place(f'iconv -f {encoding} -t UTF-8', path)}."
