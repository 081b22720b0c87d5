"""Rules of the house that no tool has, and proof that rules and contracts see what they forbid.

Each rule is a function from a module's tree to what breaks it, so that it can be tried on an offending snippet.
"""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
SOURCES = sorted(
    path
    for folder in ("hts", "plugins", "robots", "integrations")
    for path in (REPOSITORY / folder).rglob("*.py")
    if not {"__pycache__", ".environment"} & set(path.parts)  # the second: what `make test-rsl-rl` installs
)
NAMES = {path: path.relative_to(REPOSITORY).as_posix() for path in SOURCES}
CORE = [path for path in SOURCES if NAMES[path].startswith("hts/")]
LEARNING = (
    "sim",
    "recordings",
    "envs",
    "policies",
    "rl",
    "training",
    "measurement",
    "evaluation",
    "selection",
    "run",
)

Rule = Callable[[ast.Module], Iterator[str]]


def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


# ---------------------------------------------------------------------------------------------------- rules


def runs_code(tree: ast.Module) -> Iterator[str]:
    """Pickle and its like, torch.load without weights_only=True, eval, exec."""
    pickles = {"pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [alias.name for alias in node.names] + [getattr(node, "module", None) or ""]
            yield from (f"line {node.lineno}: {name}" for name in pickles & set(names))
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            given = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
            if called == "torch.load" and given.get("weights_only") != "True":
                yield f"line {node.lineno}: {called} without weights_only=True"
            if called in {"eval", "exec"}:
                yield f"line {node.lineno}: {called}"


def swallows_errors(tree: ast.Module) -> Iterator[str]:
    """`except Exception: pass` and its like."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ExceptHandler):
            everything = node.type is None or ast.unparse(node.type) in {"Exception", "BaseException"}
            silent = all(isinstance(statement, ast.Pass | ast.Continue) for statement in node.body)
            if everything and silent:
                yield f"line {node.lineno}"


def shares_defaults(tree: ast.Module) -> Iterator[str]:
    """Lists, dicts and sets as default arguments."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            for default in [*node.args.defaults, *node.args.kw_defaults]:
                if isinstance(default, ast.List | ast.Dict | ast.Set):
                    yield f"line {node.lineno}"


def asks_by_name(tree: ast.Module) -> Iterator[str]:
    """`hasattr`, and `getattr` with a name that is written there: an ability is a method with a default."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            written = len(node.args) > 1 and isinstance(node.args[1], ast.Constant)
            if node.func.id == "hasattr" or (node.func.id == "getattr" and written):
                yield f"line {node.lineno}: {ast.unparse(node)}"


def writes_in_place(tree: ast.Module) -> Iterator[str]:
    """A file that is written where it can be seen half: everything goes through `hts.atomic`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            called = ast.unparse(node.func)
            if node.func.attr in ("write_text", "write_bytes") or called in ("os.replace", "os.rename", "shutil.move"):
                yield f"line {node.lineno}: {called}"


def reaches_for_an_instrument(tree: ast.Module) -> Iterator[str]:
    """Any word of code that has "instrument" in it, or the physics that instruments see."""
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = [alias.name for alias in node.names] + [getattr(node, "module", None) or ""]
        elif isinstance(node, ast.Name):
            names = [node.id]
        elif isinstance(node, ast.Attribute):
            names = [node.attr]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.isidentifier():
            names = [node.value]  # getattr(registry, "instruments")
        for name in names:
            if "instrument" in name.lower() or name == "PhysicsSample":
                yield f"line {getattr(node, 'lineno', 0)}: {name}"


def imports_of(tree: ast.Module) -> set[str]:
    """Every module that is imported, wherever in the file; of `from a import b` both a and a.b."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def base_names(tree: ast.Module) -> set[str]:
    """Last part of every base class in the file."""
    return {ast.unparse(base).split(".")[-1] for n in ast.walk(tree) if isinstance(n, ast.ClassDef) for base in n.bases}


@cache  # by the text: a package is a part of the one around it, and a test changes its files
def imports_and_bases(text: str) -> tuple[set[str], set[str]]:
    tree = ast.parse(text)
    return imports_of(tree), base_names(tree)


def objectives_that_see_instruments(package: Path) -> list[str]:
    """Modules with an Objective that reach, through imports inside their package, a module with an Instrument."""
    found = {
        f"{package.name}.{'.'.join(path.relative_to(package).with_suffix('').parts)}": imports_and_bases(
            path.read_text(encoding="utf-8")
        )
        for path in package.rglob("*.py")
        if "__pycache__" not in path.parts
    }
    imports = {name: imported & set(found) for name, (imported, _) in found.items()}
    bases = {name: derived for name, (_, derived) in found.items()}
    offending = []
    for start in (name for name, derived in bases.items() if "Objective" in derived):
        reached, waiting = set(), [start]
        while waiting:
            name = waiting.pop()
            if name not in reached:
                reached.add(name)
                waiting += imports[name]
        offending += [f"{start} reaches {name}" for name in sorted(reached) if "Instrument" in bases[name]]
    return offending


# ------------------------------------------------------------------------------------------------- the house


WHOLE_FOLDERS = {"hts/atomic.py", "hts/recordings/partial.py", "hts/worlds/field_bundle.py", "hts/cli/group.py"}
"""The one place where files are moved; folders written under another name and moved as a whole; help texts."""


def says_nothing(tree: ast.Module) -> Iterator[str]:
    """A file whose first line does not say what it is."""
    if not ast.get_docstring(tree):
        yield "line 1: no docstring"


RULES: dict[Rule, list[Path]] = {
    says_nothing: SOURCES,
    runs_code: SOURCES,
    swallows_errors: SOURCES,
    shares_defaults: SOURCES,
    writes_in_place: [
        path for path in CORE if NAMES[path] not in WHOLE_FOLDERS and not NAMES[path].startswith("hts/testing/")
    ],
    asks_by_name: CORE,
    reaches_for_an_instrument: [path for path in CORE if set(path.parts) & set(LEARNING)],
}
"""Rule -> the files for which it holds."""


@pytest.fixture(scope="module")
def broken() -> dict[Rule, list[str]]:
    """Rule -> FILE: what breaks it there. Each file is read into a tree once, for all rules, and the tree then dropped:
    all trees at once would take a lot of memory."""
    found: dict[Rule, list[str]] = {rule: [] for rule in RULES}
    kept = {rule: set(paths) for rule, paths in RULES.items()}
    for path in SOURCES:
        tree = tree_of(path)
        for rule, paths in kept.items():
            if path in paths:
                found[rule] += [f"{NAMES[path]}: {what}" for what in rule(tree)]
    return found


def test_a_file_holds_one_idea():
    lengths = {NAMES[path]: len(path.read_text(encoding="utf-8").splitlines()) for path in SOURCES}
    assert {name: lines for name, lines in lengths.items() if lines > 400} == {}, "find the second idea and move it out"


def test_no_scratch_file_lies_in_the_root():
    assert [path.name for path in REPOSITORY.glob("*.py")] == [], "modules belong into a package"


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_the_rules_hold(broken, rule):
    assert not broken[rule], "\n".join(broken[rule])


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_a_rule_has_files_to_look_at(rule):
    assert len(RULES[rule]) > 100


def test_the_objectives_of_our_plugins_do_not_see_their_instruments():
    packages = [path.parent for path in SOURCES if path.name == "__init__.py" and path.parts[-4:-3] != ("hts",)]
    packages += [REPOSITORY / "hts" / "testing" / "examples" / "objective"]
    names = {package.name for package in packages}
    assert {"hts_power", "hts_noise"} <= names
    for package in packages:
        assert objectives_that_see_instruments(package) == []


# --------------------------------------------------------------------------------- the rules see what they forbid


@pytest.mark.parametrize(
    ("rule", "source"),
    [
        (says_nothing, "x = 1"),
        (runs_code, "import pickle"),
        (runs_code, "from dill import loads"),
        (runs_code, "def f(p):\n    import torch\n    return torch.load(p)"),
        (runs_code, "import torch\ntorch.load('x', weights_only=False)"),
        (runs_code, "eval('1')"),
        (swallows_errors, "try:\n    f()\nexcept Exception:\n    pass"),
        (swallows_errors, "for x in y:\n    try:\n        f()\n    except:\n        continue"),
        (shares_defaults, "def f(x=[]): ..."),
        (shares_defaults, "f = lambda *, x={}: x"),
        (writes_in_place, "path.write_text('half')"),
        (writes_in_place, "import os\nos.replace(part, path)"),
        (asks_by_name, "hasattr(world, 'watch')"),
        (asks_by_name, "getattr(env, 'engine', None)"),
        (reaches_for_an_instrument, "from hts.contracts import Instrument"),
        (reaches_for_an_instrument, "from hts.contracts import PhysicsSample as S"),
        (reaches_for_an_instrument, "def f(r):\n    return r.make_instrument('x', {}, None)"),
        (reaches_for_an_instrument, "def f(r):\n    return getattr(r, 'instruments')"),
        (reaches_for_an_instrument, "def f(objective):\n    return objective.instrument"),
    ],
)
def test_a_rule_sees(rule: Rule, source):
    assert list(rule(ast.parse(source)))


@pytest.mark.parametrize(
    ("rule", "source"),
    [
        (runs_code, "import torch\ntorch.load('x', weights_only=True)\nmodel.eval()"),
        (swallows_errors, "try:\n    f()\nexcept KeyError:\n    pass"),
        (swallows_errors, "try:\n    f()\nexcept Exception as error:\n    raise ValueError from error"),
        (shares_defaults, "def f(x=(), y=None): ..."),
        (asks_by_name, "fields = [getattr(spec, name) for name in PER_JOINT]"),
        (reaches_for_an_instrument, "def f(robot):\n    '''As an instrument sees it.'''\n    return robot.channels()"),
    ],
)
def test_a_rule_lets_pass(rule: Rule, source):
    assert list(rule(ast.parse(source))) == []


@pytest.mark.parametrize("where", ["objective", "proxy"])
def test_an_objective_that_reaches_its_instrument_is_seen(tmp_path, where):
    package = tmp_path / "hts_heat"
    package.mkdir()
    files = {
        "objective": "from hts_heat import proxy\nclass Heat(contracts.Objective): ...",
        "proxy": "x = 1",
        "meter": "from hts_heat.objective import Heat\nclass Meter(Instrument): ...",
    }
    for name, text in files.items():
        (package / f"{name}.py").write_text(text)
    assert objectives_that_see_instruments(package) == []  # the other way round is allowed
    offending = files[where] + "\ndef peek():\n    from hts_heat import meter\n    return meter"
    (package / f"{where}.py").write_text(offending)
    assert objectives_that_see_instruments(package) == ["hts_heat.objective reaches hts_heat.meter"]


# ------------------------------------------------------------------------------------------------- the floors


def test_the_floors_hold():
    from importlinter.cli import lint_imports

    assert lint_imports(str(REPOSITORY / "pyproject.toml"), no_cache=True) == 0


def contracts() -> dict[str, dict]:
    settings = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    return {contract["name"]: contract for contract in settings["contracts"]}


def test_every_module_of_the_core_has_its_floor():
    (floors,) = [contract for contract in contracts().values() if contract["type"] == "layers"]
    placed = {word.strip("() ") for layer in floors["layers"] for word in layer.replace("|", ":").split(":")}
    modules = {path.stem for path in (REPOSITORY / "hts").glob("*.py")} - {"__init__"}
    modules |= {path.parent.name for path in (REPOSITORY / "hts").glob("*/__init__.py")}
    assert {f"hts.{name}" for name in modules} - placed == set()


def test_all_learning_code_is_kept_from_worlds():
    kept = contracts()["Learning code cannot look into a world"]
    assert set(kept["source_modules"]) == {f"hts.{name}" for name in LEARNING}
    assert kept["forbidden_modules"] == ["hts.worlds"]


OFFENCES = {
    "hts/sim/engine.py": ("hts.sim.engine -> hts.rl.kl_bound", "from hts.rl import kl_bound"),
    "hts/errors.py": (
        "hts.errors -> hts.channels",
        "def late():\n    from hts.channels import Channel\n    return Channel",
    ),
    "hts/cores.py": ("hts.cores -> hts.run", "import hts.run"),
    "hts/rl/kl_bound.py": ("hts.rl.kl_bound -> hts.worlds.twin.model", "from hts.worlds.twin.model import build"),
    "hts/report/table.py": ("hts.report.table -> hts_power.battery", "from hts_power.battery import Battery"),
    "robots/go1/hts_go1_runtime/link.py": ("hts_go1_runtime.link -> hts.channels", "from hts.channels import Channel"),
    "plugins/noise/hts_noise/objective.py": ("hts_noise.objective -> hts.worlds.base", "from hts.worlds import base"),
}
"""File -> the import that the linter must name, and the lines that make it."""


def test_a_forbidden_import_is_named(tmp_path):
    roots = {"hts": "hts", "plugins/power/hts_power": "", "plugins/noise/hts_noise": "", "robots/go1/hts_go1": ""}
    roots |= {"robots/go1/hts_go1_runtime": "", "robots/go1/hts_go1_stand_in": ""}
    ignore = shutil.ignore_patterns("__pycache__", "*.safetensors", "*.json")
    for folder in roots:
        shutil.copytree(REPOSITORY / folder, tmp_path / folder, ignore=ignore)
    shutil.copy(REPOSITORY / "pyproject.toml", tmp_path)
    for file, (_, lines) in OFFENCES.items():
        with (tmp_path / file).open("a") as text:
            text.write(f"\n{lines}\n")
    path = os.pathsep.join(str((tmp_path / folder).parent) for folder in roots)
    code = (
        "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports('pyproject.toml', no_cache=True))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    named = done.stdout.replace("\n", " ")
    missed = [link for link, _ in OFFENCES.values() if link not in named]
    assert not missed, done.stdout[-4000:]
