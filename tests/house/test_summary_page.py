"""docs/summary.md names the keys of summary.json, and no others."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "summary.md").read_text()
WRITES = ("run/summary.py", "run/front.py", "run/passed_over.py", "run/finals.py", "evaluation/head_to_head.py")
"""Sources whose dictionaries are the summary's, but for those of `OTHER`."""
OTHER = {"recordings", "samples", "speed_tolerance"}
NAMED = {"metrics", "metrics_ci95", "limits", "worst", "world_identity", "kept_out", "weights", "selection_score"}
NAMED |= {"metric_units", "proxy_held_out_r2", "proxy_elites", "proxy_rank_correlation", "refused_falls"}
"""Their keys are names of somebody's own."""


def documented() -> set[str]:
    spans = re.findall(r"`([^`\n]+)`", PAGE)
    return {part for span in spans for part in re.split(r"[.\[\]]+", span) if part}


def first_column() -> set[str]:
    rows = [line.split("|")[1] for line in PAGE.splitlines() if line.startswith("| `")]
    return {part for row in rows for span in re.findall(r"`([^`]+)`", row) for part in re.split(r"[.\[\]]+", span)}


def keys(found, own: set[str]):
    """All keys of a summary that are no names of somebody's own."""
    if isinstance(found, list):
        for one in found:
            yield from keys(one, own)
    elif isinstance(found, dict):
        for key, value in found.items():
            is_own = key in own or re.fullmatch(r"-?[\d.]+|\d\d-.*", key)
            if not is_own:
                yield key
            if key not in NAMED:
                yield from keys(value, own)


def literals(source: str) -> set[str]:
    """Keys of the dictionaries that functions of this source return or fill."""
    tree = ast.parse((ROOT / "hts" / source).read_text())
    found = {key.value for node in ast.walk(tree) if isinstance(node, ast.Dict) for key in node.keys if is_word(key)}
    return found | {
        target.slice.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign)
        for target in node.targets
        for target in (target.elts if isinstance(target, ast.Tuple) else [target])
        if isinstance(target, ast.Subscript) and is_word(target.slice)
    }


def is_word(node: ast.AST | None) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


@pytest.mark.parametrize("source", WRITES)
def test_every_key_that_these_sources_write_is_on_the_page(source):
    found = literals(source)
    assert found and found - OTHER <= documented()


def test_every_key_of_a_run_is_on_the_page(small_run):
    summary = json.loads((small_run.folder / "summary.json").read_text())
    found = set(keys(summary, set(summary["objectives"])))
    assert {"rank_correlation", "improvement_ci95", "reward_scale", "pretrained_sim_scores"} <= found
    assert found <= documented()


def test_the_page_names_no_key_that_is_not_written():
    core = "\n".join(path.read_text() for path in (ROOT / "hts").rglob("*.py"))
    made_up = [one for one in first_column() if one and not one.startswith("<") and one not in core]
    assert not made_up
