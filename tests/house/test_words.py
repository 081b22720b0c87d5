"""The core names no objective and no robot.

Everything in `hts/` that a person may read is looked at: identifiers, imports, strings, comments, and files that
are not Python. Words are cut at underscores, capitals and digits' edges, so `battery_current` and `BatteryGauge` both
contain "battery".

What counts as naming one:
  a quantity that somebody improves, or its sensor: battery, power, wattage, microphone, loudness, footfall, stepping
  noise a robot that a plugin brings, or its maker: go1, go2, unitree
What does not: `np.power` and its like (mathematics), observation and exploration noise, "to the power of",
other machines in the source of a number.

The word list is here and nowhere else; whatever our own plugins register must be in it.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

from hts.plugins import KINDS, load

CORE = Path(__file__).resolve().parents[2] / "hts"
TEXT = {".py", ".html", ".j2", ".css", ".js", ".svg", ".json", ".yaml", ".yml", ".toml", ".txt", ".md", ".tmpl"}

WORDS = {
    "battery",
    "batteries",
    "power",
    "powers",
    "wattage",
    "microphone",
    "microphones",
    "loudness",
    "footfall",
    "footfalls",
    "go1",
    "go2",
    "unitree",
}
PHRASES = (
    re.compile(r"(stepping|footstep|walking)[ _-]noise|noise[ _-](objective|plugin|reward)", re.IGNORECASE),
    re.compile(r"hts_(noise|power|go1)"),
    re.compile(r"(battery|supply|phase|bus)[ _-]current", re.IGNORECASE),
    re.compile(r"calibrate[ _-]twin"),
    re.compile(r"drive_train"),
)
AMBIGUOUS = {"noise"}
"""Ordinary words that are also the name of an objective: they name it where plugins are looked up or compared."""

MATHEMATICS = re.compile(
    r"\b(np|numpy|torch|math|tl|jnp)\.(power|float_power|matrix_power)\b|\bto the power of\b|\bpowers? of (two|ten)\b"
)


def files_of(root: Path) -> list[Path]:
    return sorted(path for path in root.rglob("*") if path.suffix in TEXT and "__pycache__" not in path.parts)


FILES = files_of(CORE)


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
        mathematics = (
            index >= 2 and tokens[index - 1].string == "." and token.string in {"power", "float_power", "matrix_power"}
        )
        if mathematics and tokens[index - 2].string in {"np", "numpy", "torch", "math"}:
            continue
        found.append((token.start[0], token.string))
    return found


def looked_up(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """(line, word) of ambiguous words where they can only be a plugin's name.

    That is: compared with something, given to a function of the registry, or a key of objectives, robots, instruments
    or weights.
    """
    for node in ast.walk(tree):
        places: list[ast.expr] = []
        if isinstance(node, ast.Compare):
            places = [node.left, *node.comparators]
        elif isinstance(node, ast.MatchValue):
            places = [node.value]
        elif isinstance(node, ast.Call) and re.search(r"(^|\.)(make_\w+|entry|register)$", ast.unparse(node.func)):
            places = node.args
        elif isinstance(node, ast.Subscript | ast.Call) and re.search(
            r"(objectives|robots|instruments|weights)(\.get)?$",
            ast.unparse(node.value if isinstance(node, ast.Subscript) else node.func),
        ):
            places = [node.slice] if isinstance(node, ast.Subscript) else node.args
        for place in places:
            inside = place.elts if isinstance(place, ast.Tuple | ast.List | ast.Set) else [place]
            for one in inside:
                if isinstance(one, ast.Constant) and one.value in AMBIGUOUS:
                    yield one.lineno, str(one.value)


def offences(path: Path) -> list[str]:
    """Everything in a file that names an objective or a robot, one line each."""
    found = [(line, what) for line, text in pieces(path) for what in naming(text)]
    if path.suffix == ".py":
        found += looked_up(ast.parse(path.read_text(encoding="utf-8")))
    return [f"{path.name}:{line}: {what}" for line, what in sorted(found)]


def test_the_core_names_no_objective_and_no_robot():
    found = [f"{path.relative_to(CORE).parent}/{named}" for path in FILES for named in offences(path)]
    assert not found, "say it in general words, or move it to a plugin: " + ", ".join(found)


def test_file_names_of_the_core_name_no_objective_and_no_robot():
    assert not [path for path in CORE.rglob("*") if naming(path.stem)]


def test_nothing_of_the_core_is_left_out():
    """A file of a kind that nobody looks at would be a place to hide in."""
    files = [path for path in CORE.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    assert {path.suffix for path in files if path.stat().st_size > 0} - TEXT <= {".safetensors"}
    assert len(FILES) > 100


def test_whatever_our_own_plugins_register_is_in_the_list():
    registry = load()
    ours = {"hard-to-sim-power", "hard-to-sim-noise", "hard-to-sim-go1"}
    names = {entry.name for kind in KINDS for entry in getattr(registry, kind).values() if entry.package in ours}
    channels = {registry.make_objective(name).target.name for name in ("power", "noise") if name in registry.objectives}
    assert {"power", "noise", "go1"} <= names
    assert "battery_current" in channels
    for name in names:
        assert naming(name) or name in AMBIGUOUS, f"add '{name}' to the word list"
    assert naming("battery_current")


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
        "Unitree",
        "powers of the motors",
    ],
)
def test_the_word_list_sees(text):
    assert naming(text)


@pytest.mark.parametrize(
    "text",
    [
        "np.power(x, 2)",
        "two to the power of three",
        "a power of two",
        "observation_noise",
        "current directory",
        "the motor's torque",
        "powerful",
        "go on",
        "good",
    ],
)
def test_the_word_list_lets_pass(text):
    assert not naming(text)


OFFENDING = {
    "import hts_power.battery": "power",
    "from hts_go1 import robot as machine": "go1",
    "def net_power(x): ...": "power",
    "class Go1Env: ...": "go1",
    "x = registry.objectives['power']": "power",
    "if name == 'noise': ...": "noise",
    "if name in ('noise', 'other'): ...": "noise",
    "match name:\n    case 'noise': ...": "noise",
    "registry.make_objective('noise', {})": "noise",
    "x = config.sweep.weights.get('noise')": "noise",
    "x = self.objectives['noise']": "noise",
    "x = f'{y} W of battery'": "battery",
    "x = 1  # as the microphone hears it": "microphone",
    "x.battery_current = 3": "battery",
    "torch.power_of(battery)": "power",
}


@pytest.mark.parametrize("source", OFFENDING)
def test_an_offending_line_is_seen(source, tmp_path):
    file = tmp_path / "module.py"
    file.write_text(f'"""A module."""\n\nx = 1\n{source}\n')
    assert any(line.endswith(f": {OFFENDING[source]}") for line in offences(file)), offences(file)


@pytest.mark.parametrize(
    "source",
    [
        "y = np.power(x, 2) + torch.matrix_power(a, 3)",
        "state['noise'] = self.noise.state_dict()",
        "parts = {'noise': 1, 'order': 2}",
        "def observe(self, noise): return x + noise  # exploration noise, sigma",
        "config = EnvConfig(observation_noise=0.0)",
    ],
)
def test_an_innocent_line_passes(source, tmp_path):
    file = tmp_path / "module.py"
    file.write_text(f"{source}\n")
    assert offences(file) == []


def test_lines_are_named_and_files_that_are_not_python_are_read(tmp_path):
    file = tmp_path / "module.py"
    file.write_text(
        "import numpy as np\nx = np.power(2, 3)  # of a battery\nnet_power = 'go1'\ny = f'{x} microphone'\n"
    )
    assert offences(file) == [
        "module.py:2: battery",
        "module.py:3: go1",
        "module.py:3: power",
        "module.py:4: microphone",
    ]
    page = tmp_path / "page.html"
    page.write_text("<p>\nPower of the Go1\n</p>")
    assert offences(page) == ["page.html:2: go1", "page.html:2: power"]
    assert files_of(tmp_path) == [file, page]
