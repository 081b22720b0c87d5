"""Packages to start from, as `hts new KIND NAME` writes them: they install, pass `hts check`, test and run as they are.

A package is one of the kit's own examples under another name, so what is written is what the kit itself is tested with.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import keyword
import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from string import Template

from hts import __version__
from hts.errors import ConfigError, RunError, unknown_name
from hts.plugins import load
from hts.testing.packages import kit_installed

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Starter:
    """What `hts new` writes for a kind. own: what the example is called in its own code; offered: the kind under which
    the registry has it; run: the first command to try, words in capitals are to be filled in (`hts plugins` lists what
    may stand there), FOLDER is the package's."""

    own: str
    offered: str
    run: str


LOG_ONLY = "log-only-robot"

STARTERS = {
    "objective": Starter("fake", "objectives", "hts run --objective $name --robot ROBOT --preset smoke"),
    "measurement-model": Starter(
        "fading",
        "measurement_models",
        "hts run --objective OBJECTIVE --set objectives.OBJECTIVE.model=$name --robot ROBOT --preset smoke",
    ),
    "robot": Starter("tiny", "robots", "hts run --objective OBJECTIVE --robot $name --preset smoke"),
    LOG_ONLY: Starter(
        "logged",
        "robots",
        "hts import FOLDER/walk.csv --robot $name --mapping FOLDER/mapping.yaml --to data.zarr",
    ),
    "world": Starter("hoist", "worlds", "hts run --objective OBJECTIVE --robot ROBOT --world $name --preset smoke"),
    "instrument": Starter(
        "warmth",
        "instruments",
        "hts run --objective OBJECTIVE --robot ROBOT --preset smoke --set world.instruments.$name.noise=0.1",
    ),
    "selector": Starter(
        "plain",
        "selectors",
        "hts run --objective OBJECTIVE --robot ROBOT --preset smoke --set selection.selector.name=$name",
    ),
    "reader": Starter(
        "jsonl",
        "log_readers",
        "hts import FOLDER/walk.jsonl --robot ROBOT --mapping FOLDER/mapping.yaml --to data.zarr",
    ),
}
KINDS = tuple(kind for kind in STARTERS if kind != LOG_ONLY)
"""As they are typed; a log-only robot is a robot with an option."""
LONGEST = 50
"""Characters of a name, which is typed, and stands in paths and in the lines of the package."""


def write_starter(kind: str, name: str, parent: Path, log_only: bool = False) -> Path:
    """Write a package for one thing of a kind (`KINDS`) into `parent`/hts-NAME; the folder.

    log_only: a robot that is known by its logs, without a model. Raises ConfigError for a kind or name that cannot be,
    RunError if the folder exists or cannot be written.
    """
    kind = _checked_kind(kind, log_only)
    if not re.fullmatch(r"[a-z][a-z0-9]*([-_][a-z0-9]+)*", name) or keyword.iskeyword(name):
        article = "an" if _word(kind)[0] in "aeiou" else "a"
        raise ConfigError(
            f"'{name}' cannot name {article} {_word(kind)}: lower-case letters, digits and single - or _ between "
            "them, a letter first, no Python keyword."
        )
    if len(name) > LONGEST:
        raise ConfigError(
            f"'{name[:LONGEST]}…' has {len(name)} characters, expected {LONGEST} at most: it is typed on the command "
            "line, and files and folders are named after it. Choose a shorter one."
        )
    module = f"hts_{_field(name)}"
    _refuse_taken(kind, name, module)
    folder = parent / module.replace("_", "-")
    if folder.exists():
        raise RunError(f"{folder}: exists already. Choose another name, or another place with --to DIR.")
    words = {
        "name": name,
        "Name": _class_name(name),
        "module": module,
        "package": folder.name,
        "kind": _word(kind),
        "Names": ", ".join(sorted([_class_name(name), "Settings"])),
        "version": __version__,
        "run": first_run(kind, name, Path(".")),
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
    files |= _log_to_try(kind, name)
    try:
        parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=parent) as beside:
            _write(files, Path(beside, folder.name), (module, name) if kind == "robot" else None)
            Path(beside, folder.name).rename(folder)  # whole or not at all
    except OSError as error:
        raise RunError(
            f"{folder}: cannot be written ({error.strerror}). Free some space, or choose another place with --to DIR."
        ) from error
    return folder


def _write(files: Mapping[str, str], folder: Path, robot: tuple[str, str] | None) -> None:
    """The package's files. robot: module and name of one, which ships a policy. Raises OSError."""
    for file, text in files.items():
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    if robot is not None:
        from hts.testing.tiny_policy import write_drive_policy

        module, name = robot
        write_drive_policy(folder / module / "policies" / "pretrained.safetensors", name)


def first_run(kind: str, name: str, folder: Path, log_only: bool = False) -> str:
    """The command of the first run to try; words in capitals are to be filled in. folder: of the package."""
    run = STARTERS[_checked_kind(kind, log_only)].run.replace("FOLDER/", "" if folder == Path(".") else f"{folder}/")
    return Template(run).substitute(name=name)


def _checked_kind(kind: str, log_only: bool) -> str:
    """The key in STARTERS. Raises ConfigError for a kind that is none, or that cannot be log-only."""
    if kind not in STARTERS:
        raise ConfigError(unknown_name("kind of package", kind, KINDS))
    if log_only and kind not in ("robot", LOG_ONLY):
        raise ConfigError(f"--log-only is for robots, found 'hts new {kind}'. Leave it out.")
    return LOG_ONLY if log_only else kind


def _word(kind: str) -> str:
    """The kind as a sentence has it."""
    return {LOG_ONLY: "robot", "reader": "log reader"}.get(kind, kind.replace("-", " "))


def _log_to_try(kind: str, name: str) -> dict[str, str]:
    """A log and its mapping, for what reads logs: file -> text."""
    from hts.testing.made_up_logs import as_csv, as_json_lines, walk_columns

    if kind not in (LOG_ONLY, "reader"):
        return {}
    template = (HERE / "templates" / "mapping.yaml.tmpl").read_text(encoding="utf-8")
    mapping = Template(template).substitute(reader="csv" if kind == LOG_ONLY else name)
    log = {"walk.csv": as_csv} if kind == LOG_ONLY else {"walk.jsonl": as_json_lines}
    return {"mapping.yaml": mapping, **{file: write(walk_columns()) for file, write in log.items()}}


def _refuse_taken(kind: str, name: str, module: str) -> None:
    """Two things of one kind and name would stop every command, so that name is refused now; so is a module, or a
    distribution, of that name that is installed, in whose place the new one would be imported."""
    with kit_installed():  # whose names tests of the package need
        entry = load().offered(STARTERS[kind].offered).get(name)
    if entry is not None:
        raise ConfigError(f"'{name}' is taken: {entry.package} offers the {_word(kind)} of that name. Choose another.")
    distribution = module.replace("_", "-")
    installed = importlib.util.find_spec(module) is not None
    if installed or any(True for _ in importlib.metadata.Distribution.discover(name=distribution)):
        what = f"a module {module}" if installed else f"a package {distribution}"
        raise ConfigError(
            f"'{name}' is taken: {what} is installed, which the new one would replace. Choose another, such as "
            f"{name}-{kind.split('-')[-1]}."
        )


def _field(kind: str) -> str:
    """A kind or a name as Python names it: folder of the example, and module."""
    return kind.replace("-", "_")


def _class_name(name: str) -> str:
    return "".join(part.capitalize() for part in _field(name).split("_"))


def _renamed(file: Path, kind: str, words: dict[str, str]) -> str:
    """The example's source with the new name in place of its own."""
    own = STARTERS[kind].own
    text = file.read_text(encoding="utf-8").replace(f"hts.testing.examples.{_field(kind)}", words["module"])
    text = re.sub(rf"\b{own.capitalize()}\b", words["Name"], text)
    text = re.sub(rf"\b{own}(?=_)", _field(words["name"]), text)  # part of a channel's name, which is an identifier
    return re.sub(rf"\b{own}\b", words["name"], text)
