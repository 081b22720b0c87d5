"""Every Python and console example of the documentation does what the page says.

A page is followed from top to bottom in an empty folder of its own, in an environment that sees everything that is
installed here and that may install more without leaving anything behind:

    ```python                   is run as a program; those that follow each other in one process, which loads torch once
    ```python title="FILE"      is written to FILE, as are toml and yaml blocks with a title, and imported if it is a
                                module
    ```console                  lines that begin with "$ " are typed; the others are what must be seen: a line "..."
                                stands for any lines, an "…" in a line for any text
    <!-- exit 1 -->             before a console block: its last command must end with that status
    <!-- not run: REASON -->    before a block that cannot be run here; the page must say "Not run" to its reader
    <!-- run by TEST -->        before a block that TEST runs
"""

from __future__ import annotations

import ast
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs"
PAGES = [REPOSITORY / "README.md", *sorted(DOCS.glob("*.md")), *sorted(DOCS.glob("authors/*.md"))]
FENCE = re.compile(
    r"(?P<marks>(?:^<!-- [^\n]*-->\n)*)^```(?P<head>[^\n]*)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL
)
RUNNABLE = ("python", "console")


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, the file that it is (or ""), its text, and the comments right before it."""

    line: int
    language: str
    title: str
    text: str
    marks: str

    @property
    def runs(self) -> bool:
        return self.language in RUNNABLE or bool(self.title)

    @property
    def elsewhere(self) -> str:
        """Why it is not run here, or the test that runs it; "" if it is run here."""
        found = re.search(r"<!-- (not run: .*?|run by .*?) -->", self.marks)
        return found.group(1) if found else ""

    @property
    def status(self) -> int:
        found = re.search(r"<!-- exit (\d+) -->", self.marks)
        return int(found.group(1)) if found else 0


def blocks(text: str) -> list[Block]:
    """All fenced blocks of a page, in order."""
    result = []
    for match in FENCE.finditer(text):
        language, _, rest = match["head"].partition(" ")
        title = re.search(r'title="([^"]+)"', rest)
        line = text.count("\n", 0, match.start("head")) + 1
        result.append(Block(line, language, title.group(1) if title else "", match["text"], match["marks"]))
    return result


def commands(text: str) -> list[tuple[str, str]]:
    """(command, what is shown after it) of a console block; a command goes on where a line ends in a backslash."""
    result: list[tuple[str, str]] = []
    going_on = False
    for line in text.splitlines():
        if going_on:
            command, shown = result.pop()
            result.append((f"{command}\n{line}", shown))
        elif line.startswith("$ "):
            result.append((line[2:], ""))
        else:
            if not result:
                raise ValueError(f"a console block begins with {line!r}, not with a command")
            command, shown = result.pop()
            result.append((command, shown + line + "\n"))
            continue
        going_on = line.endswith("\\")
    return result


def matches(shown: str, seen: str) -> bool:
    """Whether a page shows what was seen; trailing blanks do not count."""
    pattern = ""
    for line in shown.splitlines():
        if line == "...":
            pattern += r"(?:[^\n]*\n)*?"
        else:
            pattern += (
                ".*?".join(re.escape(part.strip() if line == "…" else part) for part in line.rstrip().split("…"))
                + r"\n"
            )
    seen = "".join(line.rstrip() + "\n" for line in seen.splitlines())
    return re.fullmatch(pattern, seen) is not None


# --------------------------------------------------------------------------------------------------- following a page


class Reader:
    """Somebody who follows a page: an empty folder, and an environment on top of this one."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "empty"
        self.folder.mkdir(parents=True)
        self.here = self.folder
        place = folder / "environment"
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(place)], check=True)
        (packages,) = place.glob("lib/python3*/site-packages")
        below = [path for path in sys.path if path.endswith("site-packages")]
        (packages / "below.pth").write_text(
            "import site; " + "; ".join(f"site.addsitedir({path!r})" for path in below) + "\n"
        )
        for name, module in (("pip", "pip"), ("hts", "hts.cli.main"), ("pytest", "pytest")):
            script = place / "bin" / name
            script.write_text(f'#!/bin/sh\nexec "{place}/bin/python" -m {module} "$@"\n')
            script.chmod(0o755)
        dropped = ("PYTHONPATH", "PYTEST_CURRENT_TEST", "PYTEST_XDIST_WORKER", "PYTEST_ADDOPTS")
        self.environment = {name: value for name, value in os.environ.items() if name not in dropped}
        self.environment |= {
            "PATH": f"{place}/bin{os.pathsep}{os.environ['PATH']}",
            "VIRTUAL_ENV": str(place),
            "OMP_NUM_THREADS": "1",
            "PIP_NO_BUILD_ISOLATION": "0",
            "PIP_NO_INDEX": "1",
            "PIP_DISABLE_PIP_VERSION_CHECK": "1",
            "COLUMNS": "160",
            "NO_COLOR": "1",
        }

    def follow(self, *group: Block) -> None:
        """Do what a block says, or several of Python. Fails with what went wrong."""
        block = group[0]
        if block.language == "console":
            typed = commands(block.text)
            for number, (command, shown) in enumerate(typed):
                self._type(command, shown, block.status if number == len(typed) - 1 else 0)
        elif block.language == "python":
            self._python(group)
        else:
            file = self.folder / block.title
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(block.text, encoding="utf-8")

    def _type(self, command: str, shown: str, status: int) -> None:
        remember = self.folder.parent / "here"
        script = (
            f"cd {shlex.quote(str(self.here))}\n{command}\nstatus=$?\npwd > {shlex.quote(str(remember))}\nexit $status"
        )
        done = subprocess.run(
            ["bash", "-c", script],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=self.environment,
            timeout=1000,
            check=False,
        )
        said = f"$ {command}\n{done.stdout}"
        assert done.returncode == status, f"status {done.returncode}, expected {status}:\n{said}"
        assert matches(shown, done.stdout), f"the page shows\n{shown}\nbut there is\n{said}"
        self.here = Path(remember.read_text().strip())

    def _python(self, group: Sequence[Block]) -> None:
        python = str(self.folder.parent / "environment/bin/python")
        done = subprocess.run(
            [python, "-W", "error", "-W", "ignore::DeprecationWarning", "-c", PROGRAMS],
            input=json.dumps([(f"line {block.line}", block.title, block.text) for block in group]),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=self.folder,
            env=self.environment,
            timeout=1000,
            check=False,
        )
        assert done.returncode == 0, done.stdout


PROGRAMS = """
import importlib, json, sys, types
from pathlib import Path

for place, title, code in json.load(sys.stdin):
    if title:
        file = Path(title)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(code, encoding="utf-8")
        importlib.invalidate_caches()
        code = "" if "/" in title else f"import {file.stem}"
    sys.modules["__main__"] = types.ModuleType("__main__")
    exec(compile(code, place, "exec"), vars(sys.modules["__main__"]))
"""
"""Blocks of Python one after the other, each a program of its own."""


def groups(text: str) -> list[list[Block]]:
    """Blocks that are run here; of Python, those that follow each other together, but no file that comes anew."""
    result: list[list[Block]] = []
    for block in blocks(text):
        if not block.runs or block.elsewhere:
            continue
        before = result[-1] if result and result[-1][0].language == block.language == "python" else []
        if before and not (block.title and block.title in {one.title for one in before}):
            before.append(block)
        else:
            result.append([block])
    return result


def has_examples(page: Path) -> bool:
    return any(block.runs and not block.elsewhere for block in blocks(page.read_text()))


# The README's one block is a part of the manual's, see below.
@pytest.mark.slow
@pytest.mark.timeout(2400)
@pytest.mark.parametrize("page", [page for page in PAGES[1:] if has_examples(page)], ids=lambda page: page.stem)
def test_following_a_page_gives_what_it_shows(page, tmp_path):
    reader = Reader(tmp_path)
    for group in groups(page.read_text()):
        try:
            reader.follow(*group)
        except AssertionError as error:
            pytest.fail(f"{page.name}, line {group[0].line}: {error}", pytrace=False)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_is_not_run_says_so_to_the_reader_and_is_python_at_least(page):
    text = page.read_text()
    for block in blocks(text):
        if block.elsewhere.startswith("not run"):
            assert "Not run" in text, page
            if block.language == "python":
                ast.parse(block.text)
        elif block.elsewhere:
            file, _, name = block.elsewhere.removeprefix("run by ").partition("::")
            assert f"def {name}(" in (REPOSITORY / file).read_text(), f"{page.name}: {block.elsewhere}"


def test_the_readme_shows_a_part_of_the_manuals_objective():
    def bare(code: str) -> str:
        lines = (re.sub(r"\s+#.*", "", line).rstrip() for line in code.splitlines())
        return "\n".join(line for line in lines if line)

    (shown,) = [block for block in blocks((REPOSITORY / "README.md").read_text()) if block.language == "python"]
    (whole,) = [block for block in blocks((DOCS / "plugins.md").read_text()) if block.language == "python"]
    assert bare(shown.text) in bare(whole.text)


# ------------------------------------------------------------------------------------------------ the reader itself


@pytest.fixture(scope="module")
def reader(tmp_path_factory) -> Reader:
    return Reader(tmp_path_factory.mktemp("reader"))


def test_blocks_are_found_with_their_file_and_their_remarks():
    page = 'Text\n\n<!-- exit 2 -->\n```console\n$ false\n```\n\n```python title="a.py"\nx = 1\n```\n```\nplain\n```\n'
    console, python, plain = blocks(page)
    assert (console.language, console.status, console.line) == ("console", 2, 4)
    assert (python.title, python.text, python.runs) == ("a.py", "x = 1\n", True)
    assert not plain.runs


def test_python_that_follows_python_is_run_with_it_but_a_file_that_comes_anew_is_not():
    program, file, again = (f"```python{title}\n1\n```\n" for title in ("", ' title="a.py"', ' title="a.py"'))
    found = groups(program + file + program + again + "```console\n$ true\n```\n" + program)
    assert [[block.line for block in group] for group in found] == [[1, 4, 7], [10], [13], [16]]


def test_commands_are_told_from_what_they_show():
    assert commands("$ a \\\n  b\nshown\n$ c\n") == [("a \\\n  b", "shown\n"), ("c", "")]
    with pytest.raises(ValueError, match="not with a command"):
        commands("shown\n")


def test_dots_stand_for_lines_and_for_text():
    assert matches("a\n...\nd\n", "a\nb\nc\nd\n")
    assert matches("...\nd …\n", "d 12 s\n")
    assert matches("", "")
    assert not matches("a\n", "a\nb\n")
    assert not matches("", "a\n")
    assert not matches("a …\n", "b 1\n")


def test_a_command_that_shows_something_else_is_noticed(reader):
    with pytest.raises(AssertionError, match="the page shows"):
        reader.follow(Block(1, "console", "", "$ echo one\ntwo\n", ""))


def test_a_command_that_fails_is_noticed_and_one_that_should_fail_too(reader):
    with pytest.raises(AssertionError, match="status 1, expected 0"):
        reader.follow(Block(1, "console", "", "$ false\n", ""))
    with pytest.raises(AssertionError, match="status 0, expected 1"):
        reader.follow(Block(1, "console", "", "$ true\n", "<!-- exit 1 -->"))


def test_python_that_raises_is_noticed(reader):
    with pytest.raises(AssertionError, match="ZeroDivisionError"):
        reader.follow(Block(1, "python", "", "1 / 0\n", ""))
    with pytest.raises(AssertionError, match="ZeroDivisionError"):
        reader.follow(Block(1, "python", "broken_module.py", "1 / 0\n", ""))
    with pytest.raises(AssertionError, match='File "line 7", line 1'):
        reader.follow(Block(1, "python", "", "x = 1\n", ""), Block(7, "python", "", "x\n", ""))


def test_the_reader_starts_in_an_empty_folder_and_keeps_its_place(tmp_path):
    reader = Reader(tmp_path)
    reader.follow(Block(1, "console", "", "$ ls\n$ mkdir a\n$ cd a\n$ basename $PWD\na\n", ""))
    reader.follow(Block(1, "console", "", "$ basename $PWD\na\n", ""))
