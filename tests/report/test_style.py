"""What a figure's two files hold."""

from __future__ import annotations

import re
import zlib

import matplotlib
import pytest

from hts.report import style

WORDS = "λ 0.5 of a field – Größe"


@pytest.fixture
def streams(tmp_path):
    """All streams of a figure's PDF, unpacked."""
    with matplotlib.rc_context(style.RC):
        drawing, axes = style.figure(2.0)
        axes[0, 0].set_title(WORDS)
        style.save(drawing, tmp_path, "words")
    found = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", (tmp_path / "words.pdf").read_bytes(), re.DOTALL)
    return [zlib.decompress(one) for one in found]


def test_text_in_a_pdf_stays_text(streams):
    said = {code for one in streams for code in characters(one)}
    assert {ord(letter) for letter in WORDS} <= said


def characters(stream):
    """Characters of a ToUnicode map: <first> <last> [<character> ...] or <first> <last> <character>."""
    for line in re.findall(rb"<[0-9a-f]+> <[0-9a-f]+> (?:\[([^]]*)\]|<([0-9a-f]+)>)", stream, re.IGNORECASE):
        yield from (int(code, 16) for code in re.findall(rb"[0-9a-fA-F]{4}", b" ".join(line)))


def test_a_pdf_has_truetype_fonts(tmp_path):
    """Type 3 fonts are refused by publishers."""
    with matplotlib.rc_context(style.RC):
        drawing, axes = style.figure(2.0)
        axes[0, 0].set_title(WORDS)
        style.save(drawing, tmp_path, "words")
    written = (tmp_path / "words.pdf").read_bytes()
    assert b"/FontFile2" in written and b"/Type3" not in written


def test_the_layout_that_was_found_for_the_svg_is_the_pdfs(tmp_path):
    with matplotlib.rc_context(style.RC):
        drawing, axes = style.figure(2.0)
        axes[0, 0].set_ylabel("a long name\nof two lines")
        before = axes[0, 0].get_position().bounds
        style.save(drawing, tmp_path, "placed")
        found = axes[0, 0].get_position().bounds
        drawing.canvas.draw()
    assert found != before and axes[0, 0].get_position().bounds == found
