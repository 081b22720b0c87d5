"""Config files written by hand, one mistake each, and hts's answer in one line: the table of docs/configuration.md.

`python tests/test_config_mistakes.py` writes the table again.
"""

from __future__ import annotations

import tempfile
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import pytest

from hts.config_loading import check_names, load_config
from hts.errors import HtsError
from hts.plugins import GROUP, load
from hts.testing.packages import kit_installed

PAGE = Path(__file__).resolve().parents[1] / "docs" / "configuration.md"
START, END = "<!-- mistakes: written by tests/test_config_mistakes.py -->\n", "<!-- end of mistakes -->\n"

WHOLE = "objectives: fake\nrobot: tiny\n"
"""What makes each file below a whole one: the kit's own objective and robot."""

MISTAKES: dict[str, str] = {
    "a misspelt section": WHOLE + "finetunes: {num_envs: 64}\n",
    "a misspelt key": WHOLE + "finetune: {num_env: 64}\n",
    "a misspelt key far inside": WHOLE + "finetune: {ppo: {cliping: 0.2}}\n",
    "a misspelt key in a list": WHOLE + "collection: {schedule: {commands: [{seconds: 4, vx: 0.5, yawrate: 1}]}}\n",
    "a word for a number": WHOLE + "seed: three\n",
    "a number out of range": WHOLE + "iterations: 0\n",
    "a number that is none": WHOLE + "evaluation: {speed_tolerance: .nan}\n",
    "an endless length": WHOLE + "gate: {seconds: .inf}\n",
    "one number for two": WHOLE + "finetune: {env: {commands: {vx: 1.0}}}\n",
    "a value for a section": WHOLE + "measurement: 40\n",
    "a section without keys": WHOLE + "finetune:\n",
    "a key without a value": WHOLE + "finetune: {num_envs: }\n",
    "a number to the base 8": WHOLE + "seed: 010\n",
    "two mistakes": WHOLE + "sead: 3\niterations: many\n",
    "a key twice": WHOLE + "seed: 1\niterations: 2\nseed: 3\n",
    "a colon too many": WHOLE + "seed: 1: 2\n",
    "a tab": WHOLE + "finetune:\n\tnum_envs: 64\n",
    "a list for the whole file": "- objectives: fake\n- robot: tiny\n",
    "no robot": "objectives: fake\n",
    "a misspelt `robot`": "objectives: fake\nrobbot: tiny\n",
    "a robot that is not installed": "objectives: fake\nrobot: tinny\n",
    "an objective twice": "objectives: [fake, fake]\nrobot: tiny\n",
    "a misspelt preset": WHOLE + "preset: quik\n",
    "a misspelt setting of a world": WHOLE + "world: {name: twin, block_second: 40}\n",
    "a setting of another selector": WHOLE + "selection: {selector: {name: pareto, rounds: 3}}\n",
    "a parameter of the twin out of range": WHOLE + "world: {dynamics: {trunk_mass_scale: 13}}\n",
    "λ for an objective that is not in the run": WHOLE + "sweep: {weights: {faek: [1.0]}}\n",
    "every λ is zero": WHOLE + "sweep: {weights: {fake: [0.0]}}\n",
    "a critic that learns to the end": WHOLE + "finetune: {steps: 30_000, ppo: {warmup_batches: 20}}\n",
    "an engine that does not exist": WHOLE + "engine: wrap\n",
}


def ours() -> list[EntryPoint]:
    """The core and the kit alone, so that the lists of names do not depend on what else is installed."""
    return [point for point in entry_points(group=GROUP) if point.name in ("core", "kit")]


def answer(text: str) -> str:
    """What hts says of a file `mine.yaml` with this text."""
    with tempfile.TemporaryDirectory() as folder, kit_installed():
        file = Path(folder) / "mine.yaml"
        file.write_text(text, encoding="utf-8")
        with pytest.raises(HtsError) as caught:
            check_names(load_config(file=file), load(ours()))
        return str(caught.value).replace(str(file), "mine.yaml")


def table() -> str:
    """The mistakes, what is in the file, and the answer, as a table."""
    rows = ["| mistake | in the file | what hts says |", "|---|---|---|"]
    for title, text in MISTAKES.items():
        own = text.removeprefix(WHOLE).rstrip("\n").replace("\t", "→").split("\n")
        shown = "<br>".join(f"`{line}`" for line in own)
        rows.append(f"| {title} | {shown} | {answer(text).replace('|', chr(92) + '|')} |")
    return "\n".join(rows) + "\n"


@pytest.mark.parametrize("title", MISTAKES)
def test_one_mistake_is_one_line(title):
    text = answer(MISTAKES[title])
    assert "\n" not in text and 20 < len(text) < 700


@pytest.mark.parametrize(
    ("title", "expected"),
    [
        ("a misspelt section", "mine.yaml: finetunes: there is no key 'finetunes'. Did you mean 'finetune'?"),
        ("a misspelt key in a list", "Did you mean 'yaw_rate'?"),
        ("two mistakes", "Also: mine.yaml: iterations:"),
        ("a key without a value", "mine.yaml: finetune.num_envs: expected a whole number, found nothing."),
        ("a key twice", "mine.yaml:5: not YAML: the key 'seed' was written before, in line 3"),
        ("a misspelt `robot`", "mine.yaml: robbot: there is no key 'robbot'. Did you mean 'robot'?"),
        ("a setting of another selector", "there is no key 'rounds'"),
        ("a parameter of the twin out of range", "dynamics.trunk_mass_scale"),
        ("a robot that is not installed", "Did you mean 'tiny'?"),
    ],
)
def test_the_line_says_what_to_do(title, expected):
    assert expected in answer(MISTAKES[title])


def test_the_table_in_the_docs_is_what_hts_says():
    text = PAGE.read_text(encoding="utf-8")
    assert table() in text, f"{PAGE}: the table is not what hts says now; run: python {Path(__file__).name}"


if __name__ == "__main__":
    before = PAGE.read_text(encoding="utf-8")
    head, _, rest = before.partition(START)
    PAGE.write_text(head + START + "\n" + table() + "\n" + END + rest.partition(END)[2], encoding="utf-8")
