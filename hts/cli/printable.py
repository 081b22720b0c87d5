"""Text from files, made safe to print: a log, a store or a file's name may hold what a terminal would obey."""

from __future__ import annotations

import unicodedata
from typing import Any

KEPT = "\n\t"
UNSAFE = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Unicode categories: control characters, invisible ones that turn text around, bytes of no text, line ends."""


def printable(text: str) -> str:
    """The text with every character that a terminal would obey written as an escape, such as \\x1b."""
    if text.isprintable():
        return text
    return "".join(
        one.encode("unicode_escape").decode("ascii") if one not in KEPT and unicodedata.category(one) in UNSAFE else one
        for one in text
    )


def say(text: str, **how: Any) -> None:
    """Print such text; how: as of `typer.echo`."""
    import typer

    typer.echo(printable(text), **how)
