"""Every field of a pydantic model says what it is, and the API page says it as it lies in the repository."""

from __future__ import annotations

import ast
import importlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest
from pydantic import BaseModel, Field

from hts import api, contracts
from hts.channels import Channel
from hts.config import Config, EnvConfig, RunConfig
from hts.plugin_settings import type_text
from hts.policies.files import Policy, PolicyCard
from hts.testing.contract_tables import fields_table, has_fields, signature_list, without_meaning
from hts.testing.field_tables import PART, SIGNATURES, field_table, main, model_of, renewed
from hts.training.sweep import Candidate

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = REPOSITORY / "docs/authors/api.md"
FOLDERS = {
    "hts": "hts",
    "hts_power": "plugins/power/hts_power",
    "hts_noise": "plugins/noise/hts_noise",
    "hts_go1": "robots/go1/hts_go1",
}


def modules_with_models() -> list[str]:
    """Modules of ours in which some class derives from a pydantic model, or from one of ours, by its base's name."""
    found = []
    for package, folder in FOLDERS.items():
        for path in sorted((REPOSITORY / folder).rglob("*.py")):
            inside = path.relative_to(REPOSITORY / folder)
            if "templates" in inside.parts:
                continue
            classes = [node for node in ast.parse(path.read_text()).body if isinstance(node, ast.ClassDef)]
            bases = {ast.unparse(base) for one in classes for base in one.bases}
            if any(base.endswith(("BaseModel", "Config", "Settings", "Parameters")) for base in bases):
                found.append(".".join((package, *inside.with_suffix("").parts)))
    return found


@pytest.mark.parametrize("module", modules_with_models())
def test_every_field_of_every_model_has_a_description(module):
    models = {
        name: one
        for name, one in vars(importlib.import_module(module)).items()
        if isinstance(one, type) and issubclass(one, BaseModel) and one.__module__ == module
    }
    assert models
    silent = [
        f"{name}.{key}"
        for name, one in models.items()
        for key, field in one.model_fields.items()
        if not (field.description or "").strip()
    ]
    assert silent == []


def test_the_tables_of_the_api_page_are_those_of_the_models():
    text = PAGE.read_text(encoding="utf-8")
    assert renewed(text) == text, "type: make fields"


def test_the_page_has_the_table_of_every_section_of_a_run():
    def sections(model: type[BaseModel]) -> set[type[BaseModel]]:
        inner = {field.annotation for field in model.model_fields.values()}
        found = {one for one in inner if isinstance(one, type) and issubclass(one, BaseModel)}
        return {model}.union(*(sections(one) for one in found))

    shown = {model_of(part[2]) for part in PART.finditer(PAGE.read_text(encoding="utf-8"))}
    assert sections(RunConfig) <= shown


def test_a_table_gives_name_type_default_bounds_and_meaning():
    class Mine(Config):
        """Settings of nobody."""

        gain: float = Field(2.0, gt=0, le=5, description="of the loop, 1|s")
        mode: Literal["fast", "slow"] = Field("fast", description="how")
        speeds: tuple[float, ...] = Field(min_length=1, description="m/s")
        env: EnvConfig = Field(default_factory=EnvConfig, description="the env")

    assert field_table(Mine).splitlines()[2:] == [
        "| `gain` | `float` | `2.0` | > 0, ≤ 5 | of the loop, 1\\|s |",
        '| `mode` | `"fast" \\| "slow"` | `"fast"` |  | how |',
        "| `speeds` | `tuple[float, ...]` | needed | at least 1 of them | m/s |",
        "| `env` | `EnvConfig` | `{…}` |  | the env |",
    ]


def test_types_are_written_as_one_would_write_them():
    assert type_text(int | None) == "int | None"
    assert type_text(dict[str, tuple[float, ...]]) == "dict[str, tuple[float, ...]]"


def test_a_stale_page_is_renewed_in_place_and_the_rest_of_it_is_kept(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- fields: hts.config.Command -->\nold\n<!-- end of fields -->\nafter\n")
    main([str(page)])
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("after\n") and "old" not in text
    assert "| `seconds` | `float` | needed | > 0 | duration, s |" in text


def public_dataclasses() -> list[type]:
    """What the contracts are written in, and what else a plugin's author or a caller from Python gets to see."""
    given = [one for one in (getattr(contracts, name) for name in contracts.__all__) if has_fields(one)]
    return [*given, Channel, Policy, PolicyCard, api.Run, Candidate]


@pytest.mark.parametrize("made", public_dataclasses(), ids=lambda one: one.__name__)
def test_the_page_has_the_fields_of_every_public_dataclass_and_each_says_what_it_is(made):
    shown = [model_of(part[2]) for part in PART.finditer(PAGE.read_text(encoding="utf-8"))]
    assert made in shown
    assert without_meaning(made) == []


def test_the_page_has_the_signatures_of_what_is_called_from_python():
    shown = {part[2] for part in SIGNATURES.finditer(PAGE.read_text(encoding="utf-8"))}
    assert {"hts.api", "hts.rl", "hts.policies.files", "hts.policies.export", "hts.policies.modules"} <= shown
    lines = signature_list("hts.api").splitlines()
    assert any(line.startswith("- `load(folder: Path | str) -> Run`: A run, finished or not.") for line in lines)
    assert not any("_run_folder" in line or "RunError" in line for line in lines)
    own = signature_list("hts.measurement.torch_model.TorchModel").splitlines()
    assert "- `num_features`: G: inputs and their products." in own
    assert any(line.startswith("- `scaled_features(self, inputs: Tensor) -> Tensor`: Inputs (..., F)") for line in own)
    assert not any("_before_statistics" in line or "load_tensors" in line for line in own)


def test_a_table_of_a_dataclass_takes_meanings_from_its_docstring_or_the_comment_beside_a_field():
    @dataclass
    class Mine:
        """Something: of somebody.

        low, high: bounds, m; either may be missing. gain N·m/rad; not a field: of nobody.
        ``shape``: of a sample, (W, 3).

        Raises low where it must.
        """

        low: float
        high: float | None
        gain: float = 2.0
        shape: tuple[int, ...] = ()
        notes: dict[str, str] = field(default_factory=dict)  # anything | else
        silent: int = 0

    assert fields_table(Mine).splitlines()[2:] == [
        "| `low` | `float` | needed | bounds, m; either may be missing |",
        "| `high` | `float \\| None` | needed | bounds, m; either may be missing |",
        "| `gain` | `float` | `2.0` | N·m/rad; not a field: of nobody |",
        "| `shape` | `tuple[int, ...]` | `()` | of a sample, (W, 3) |",
        "| `notes` | `dict[str, str]` | `{}` | anything \\| else |",
        "| `silent` | `int` | `0` |  |",
    ]
    assert without_meaning(Mine) == ["silent"]
