"""The lines of a bundle's page that name places on this computer. A run folder that was copied or moved has a page that
would send a person to the old one, and what is measured with it."""

from __future__ import annotations

import hashlib
from pathlib import Path

from hts.atomic import atomic_write

PAGE, CHECKSUMS = "README.md", "SHA256SUMS"
INTO = "2. Write it, and the names of your log's columns, into `"
TYPE = "4. Type: `"


def into(mapping: Path) -> str:
    """Where the mapping is that a person fills in."""
    return f"{INTO}{mapping}`."


def then_type(command: str) -> str:
    """What goes on once the logs are there."""
    return f"{TYPE}{command}`"


def renew(bundle: Path, mapping: Path, command: str) -> None:
    """Let the page of a bundle that is there name the places of now, and nothing else be changed in it: what a person
    noted there stays, as do logs and plan. Raises OSError.

    The page's checksum comes first. Where only that was written, the page that comes next is the one that has it.
    """
    page, sums = bundle / PAGE, bundle / CHECKSUMS
    if not page.is_file():
        return
    lines = {INTO: into(mapping), TYPE: then_type(command)}
    before = page.read_bytes()
    after = b"\n".join(_with(line, lines) for line in before.split(b"\n"))
    if after == before:
        return
    if sums.is_file():
        said = sums.read_bytes()
        renewed = said.replace(_sum_of(before), _sum_of(after))
        if renewed != said:
            atomic_write(sums, renewed)
    atomic_write(page, after)


def _sum_of(page: bytes) -> bytes:
    """Its line among the checksums."""
    return f"{hashlib.sha256(page).hexdigest()}  {PAGE}\n".encode()


def _with(line: bytes, lines: dict[str, str]) -> bytes:
    """A line of the page, or the one that begins like it."""
    return next((new.encode() for start, new in lines.items() if line.startswith(start.encode())), line)
