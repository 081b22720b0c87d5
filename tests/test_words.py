"""The core names no objective and no robot.

Everything in `hts/` that a person may read is looked at: identifiers, imports, strings, comments, and files that
are not Python. Words are cut at underscores, capitals and digits' edges, so `battery_current` and `BatteryGauge` both
contain "battery".

What counts as naming one:
  a quantity that somebody improves, or its sensor: battery, power, wattage, microphone, loudness, footfall, stepping noise
  a robot that a plugin brings, or its maker: go1, go2, unitree
What does not: `np.power` and its like (mathematics), observation and exploration noise, "to the power of",
other machines in the source of a number.
"""

from __future__ import annotations

import io
import re
import tokenize
from pathlib import Path

import pytest

CORE = Path(__file__).resolve().parent.parent / "hts"
TEXT = {".py", ".html", ".j2", ".css", ".js", ".svg", ".json", ".yaml", ".yml", ".toml", ".txt", ".md", ".tmpl"}

WORDS = {
    "battery", "batteries", "power", "powers", "wattage", "microphone", "microphones", "loudness", "footfall",
    "footfalls", "go1", "go2", "unitree",
}  # fmt: skip
PHRASES = (
    re.compile(r"(stepping|footstep|walking)[ _-]noise|noise[ _-](objective|plugin|reward)", re.IGNORECASE),
    re.compile(r"hts_(noise|power|go1)"),
    re.compile(r"(battery|supply|phase|bus)[ _-]current", re.IGNORECASE),
)
MATHEMATICS = re.compile(r"\b(np|numpy|torch|math|tl|jnp)\.(power|float_power|matrix_power)\b|\bto the power of\b")

FILES = sorted(path for path in CORE.rglob("*") if path.suffix in TEXT and "__pycache__" not in path.parts)


def words_of(text: str) -> set[str]:
    """Lower-case words of a text; `BatteryGauge` and `battery_gauge` are two words each, `go1` stays one."""
    parted = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", text)
    return {word.lower() for word in re.findall(r"[A-Za-z]+[0-9]*", parted)}


def naming(text: str) -> list[str]:
    """What in a text names an objective or a robot."""
    text = MATHEMATICS.sub(" ", text)
    found = sorted(words_of(text) & WORDS)
    return found + [match.group(0) for phrase in PHRASES if (match := phrase.search(text))]


def pieces(path: Path) -> list[tuple[int, str]]:
    """(line, text) of everything to look at: tokens of Python that carry words, lines of other files."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return list(enumerate(text.splitlines(), start=1))
    spoken = {tokenize.NAME, tokenize.STRING, tokenize.COMMENT}
    spoken |= {getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING)}  # Python 3.12 cuts f-strings into pieces
    tokens = [t for t in tokenize.generate_tokens(io.StringIO(text).readline) if t.type in spoken or t.string == "."]
    found = []
    for index, token in enumerate(tokens):
        mathematics = index >= 2 and tokens[index - 1].string == "." and token.string == "power"
        if mathematics and tokens[index - 2].string in {"np", "numpy", "torch", "math"}:
            continue
        found.append((token.start[0], token.string))
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(CORE)))
def test_the_core_names_no_objective_and_no_robot(path):
    found = [f"{path.name}:{line}: {what}" for line, text in pieces(path) for what in naming(text)]
    assert not found, "say it in general words, or move it to a plugin: " + ", ".join(found)


def test_file_names_of_the_core_name_no_objective_and_no_robot():
    assert not [path for path in CORE.rglob("*") if naming(path.stem)]


@pytest.mark.parametrize(
    "text",
    [
        "battery_current",
        "BatteryGauge",
        "net_power",
        "from hts_power import plugin",
        "Go1Settings",
        "noise_objective",
        "stepping noise",
        "a go1 walks",
    ],
)
def test_the_word_list_sees(text):
    assert naming(text)


@pytest.mark.parametrize(
    "text",
    ["np.power(x, 2)", "observation_noise", "current directory", "the motor's torque", "powerful", "go on", "good"],
)
def test_the_word_list_lets_pass(text):
    assert not naming(text)


def test_the_word_list_reads_identifiers_strings_and_comments_but_lets_mathematics_pass(tmp_path):
    file = tmp_path / "module.py"
    file.write_text(
        "import numpy as np\nx = np.power(2, 3)  # of a battery\nnet_power = 'go1'\ny = f'{x} microphone'\n"
    )
    found = [(line, what) for line, text in pieces(file) for what in naming(text)]
    assert found == [(2, "battery"), (3, "power"), (3, "go1"), (4, "microphone")]
