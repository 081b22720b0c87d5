"""Packages to start from, as `hts new KIND NAME` writes them: they install, pass `hts check`, test and run as they are.

A package is one of the kit's own examples under another name, so what is written is what the kit itself is tested with.
"""

from __future__ import annotations

import keyword
import re
from pathlib import Path
from string import Template

from hts import __version__
from hts.errors import ConfigError, RunError, unknown_name
from hts.plugins import load
from hts.testing.packages import kit_installed

HERE = Path(__file__).parent

EXAMPLES = {"objective": "fake", "measurement-model": "fading", "robot": "tiny", "selector": "plain"}
"""Kind -> what the example of that kind is called in its own code."""

RUN = {
    "objective": "hts run --objective $name --robot ROBOT --preset smoke",
    "measurement-model": "hts run --objective OBJECTIVE --set objectives.OBJECTIVE.model=$name --robot ROBOT "
    "--preset smoke",
    "robot": "hts run --objective OBJECTIVE --robot $name --preset smoke",
    "selector": "hts run --objective OBJECTIVE --robot ROBOT --preset smoke --set selection.selector.name=$name",
}
"""Kind -> the first run to try; `hts plugins` lists what may stand in place of the capitals."""


def write_starter(kind: str, name: str, parent: Path) -> Path:
    """Write a package for one objective, measurement model, robot or selector into `parent`/hts-NAME; the folder.

    Raises ConfigError for a kind or name that cannot be, RunError if the folder exists or cannot be written.
    """
    if kind not in EXAMPLES:
        raise ConfigError(unknown_name("kind of package", kind, EXAMPLES))
    if not re.fullmatch(r"[a-z][a-z0-9]*([-_][a-z0-9]+)*", name) or keyword.iskeyword(name):
        article = "an" if kind[0] in "aeiou" else "a"
        raise ConfigError(
            f"'{name}' cannot name {article} {kind}: lower-case letters, digits and single - or _ between them, a "
            "letter first, no Python keyword."
        )
    _refuse_taken(kind, name)
    module = f"hts_{_field(name)}"
    folder = parent / module.replace("_", "-")
    if folder.exists():
        raise RunError(f"{folder}: exists already. Choose another name, or another place with --to DIR.")
    words = {
        "name": name,
        "Name": _class_name(name),
        "module": module,
        "package": folder.name,
        "kind": kind.replace("-", " "),
        "Names": ", ".join(sorted([_class_name(name), "Settings"])),
        "version": __version__,
        "run": first_run(kind, name),
    }
    files = {
        f"{module}/{file.name}": _renamed(file, kind, words) for file in (HERE / "examples" / _field(kind)).glob("*.py")
    }
    for file, template in (
        ("pyproject.toml", "pyproject.toml"),
        ("README.md", "README.md"),
        (f"tests/test_{_field(name)}.py", f"test_{kind}.py"),
    ):
        text = (HERE / "templates" / f"{template}.tmpl").read_text(encoding="utf-8")
        files[file] = Template(text).substitute(words)
    try:
        for file, text in files.items():
            path = folder / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise RunError(
            f"{folder}: cannot be written ({error.strerror}). Choose another place with --to DIR."
        ) from error
    if kind == "robot":
        from hts.testing.tiny_policy import write_drive_policy

        write_drive_policy(folder / module / "policies" / "pretrained.safetensors", name)
    return folder


def first_run(kind: str, name: str) -> str:
    """The command of the first run to try; words in capitals are to be filled in."""
    return Template(RUN[kind]).substitute(name=name)


def _refuse_taken(kind: str, name: str) -> None:
    """Two things of one kind and name would stop every command, so that name is refused now."""
    with kit_installed():  # whose names tests of the package need
        entry = load().offered(f"{_field(kind)}s").get(name)
    if entry is not None:
        raise ConfigError(f"'{name}' is taken: {entry.package} offers the {kind} of that name. Choose another one.")


def _field(kind: str) -> str:
    """A kind or a name as Python names it: folder of the example, module, and without the s the field of the
    registry."""
    return kind.replace("-", "_")


def _class_name(name: str) -> str:
    return "".join(part.capitalize() for part in _field(name).split("_"))


def _renamed(file: Path, kind: str, words: dict[str, str]) -> str:
    """The example's source with the new name in place of its own."""
    own = EXAMPLES[kind]
    text = file.read_text(encoding="utf-8").replace(f"hts.testing.examples.{_field(kind)}", words["module"])
    text = re.sub(rf"\b{own.capitalize()}\b", words["Name"], text)
    text = re.sub(rf"\b{own}(?=_)", _field(words["name"]), text)  # part of a channel's name, which is an identifier
    return re.sub(rf"\b{own}\b", words["name"], text)
