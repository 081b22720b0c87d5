"""The examples run, and do what they say."""

from __future__ import annotations

import ast
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
PUBLIC = ("hts.rl", "hts.channels", "hts.config", "hts.contracts", "hts.measurement", "hts.recordings")


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def test_algorithm_1_saves_on_the_toy_robot_what_its_simulation_does_not_know(capsys):
    saving = example("algorithm_1").main(iterations=1, batches=10, pretraining=40, seconds=15.0)
    printed = capsys.readouterr().out
    assert saving > 0.05, printed  # the optimum without a bound is 36 %: all effort where the winding is good
    assert "iteration 1: fit R²" in printed and f"best: {saving:.1%} less" in printed


@pytest.mark.filterwarnings("error:The env passed to Collector")  # who runs it should see the result alone
@pytest.mark.filterwarnings("ignore")  # TorchRL's and dm_control's own
def test_a_stock_script_pushes_less_and_still_balances(capsys):
    found = example("torchrl_ppo").main(pretraining=4, finetuning=6, weight=200.0)  # without the reward effort triples
    printed = capsys.readouterr().out
    assert found["effort_after"] < 0.8 * found["effort_before"], printed
    assert found["return_after"] > 0.9 * found["return_before"], printed
    assert 0.0 < found["kl"] < 1.5 * 0.5, printed


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_an_example_is_a_page_and_uses_public_names(path):
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 200
    modules = [node.module for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom) and node.module]
    ours = [module for module in modules if module.split(".")[0].startswith("hts")]
    assert ours and all(module.startswith(PUBLIC) for module in ours), ours
    assert not any(part.startswith("_") for module in ours for part in module.split("."))
