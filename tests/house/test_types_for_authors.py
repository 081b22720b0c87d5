"""Whoever types a plugin, and checks it with mypy --strict as mypy comes, finds the same types as hts's own checks."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
PROJECTS = [
    path
    for kind in (".", "plugins/*", "robots/*", "integrations/*")
    for path in REPOSITORY.glob(f"{kind}/pyproject.toml")
]

PLUGIN = """\
from pydantic import Field

from hts.config import Config, EnvConfig, Named
from hts.policies.export import to_onnx, to_torchscript
from hts.policies.files import load_policy, save_policy


class Settings(Config):
    hidden: int = Field(32, ge=1, description="units")


model = Named(name="lstm", hidden=Settings().hidden)
config = EnvConfig(seed=3)
policy = load_policy("best.safetensors")
written = save_policy("mine.safetensors", policy), to_onnx(policy, "mine.onnx"), to_torchscript(policy, "mine.pt")
"""

# torch is slow to check, and of no interest here.
MYPY = """\
[mypy]
strict = true
follow_imports = silent
[mypy-torch.*,numpy.*,safetensors.*,onnx.*,onnxscript.*,pint.*]
follow_imports = skip
ignore_missing_imports = true
"""


def test_what_the_pages_show_passes_a_strict_type_checker_that_knows_nothing_of_pydantic(tmp_path):
    (tmp_path / "plugin.py").write_text(PLUGIN, encoding="utf-8")
    (tmp_path / "mypy.ini").write_text(MYPY, encoding="utf-8")
    checked = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", "mypy.ini", "--cache-dir", os.devnull, "plugin.py"],
        cwd=tmp_path,
        env=os.environ | {"MYPYPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_every_package_says_that_it_has_types():
    packages = {
        path.parent / package
        for path in PROJECTS
        for package in tomllib.loads(path.read_text(encoding="utf-8"))["tool"]["hatch"]["build"]["targets"]["wheel"][
            "packages"
        ]
    }
    assert len(packages) >= 7
    assert not [str(package) for package in packages if not (package / "py.typed").is_file()]
