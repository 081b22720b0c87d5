"""What a plugin answers with, where it is of another kind than the contract says: `hts check` names it in one line, and
what needs that answer waits."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from hts.channels import Channel
from hts.cli.main import main
from hts.errors import RecordingError
from hts.testing.packages import write_package
from hts.testing.starters import write_starter

NAMES = {"objective": "warmth", "robot": "trolley", "selector": "plodder", "world": "bench"}
FILES = {"objective": "objective.py", "robot": "robot.py", "selector": "selector.py", "world": "world.py"}


@pytest.fixture
def faults(tmp_path, monkeypatch, capsys) -> Callable[..., list[str]]:
    """faults(kind, before, after): what `hts check` finds in what `hts new` writes, one text replaced; the last line is
    the count."""

    def found(kind: str, before: str, after: str) -> list[str]:
        name = NAMES[kind]
        folder = write_starter(kind, name, tmp_path / "lab")
        write_package(folder, "lab", {}, {name: f"hts_{name}.plugin"})
        file: Path = folder / f"hts_{name}" / FILES[kind]
        text = file.read_text()
        assert before in text, f"{file} has no {before!r}"
        file.write_text(text.replace(before, after))
        monkeypatch.syspath_prepend(str(folder))
        monkeypatch.setenv("PYTHONPATH", str(folder))
        main(["check", "lab", "--quiet"])
        said = capsys.readouterr()
        return (said.out + said.err).splitlines()

    yield found
    for name in [name for name in sys.modules if name.split(".")[0] in {f"hts_{name}" for name in NAMES.values()}]:
        del sys.modules[name]


IDS = "return [candidate.id for candidate in sorted(candidates, key=rank)[:count]]"
BEST = "return max(better, key=lambda name: better[name]) if better else None"
ANSWERS = {
    "candidates for ids": (
        "selector",
        IDS,
        "return sorted(candidates, key=rank)[:count]",
        "elites gives a list with a SimulatedCandidate, expected one of ids",
    ),
    "nothing for ids": ("selector", IDS, "pass", "elites gives a NoneType, expected a list of ids"),
    "one id for several": ("selector", IDS, "return candidates[0].id", "elites gives a str, expected a list of ids"),
    "a candidate for the best": (
        "selector",
        BEST,
        "return tested[0] if better else None",
        "best gives a TestedCandidate, expected an id or None",
    ),
    "a check that fails": (
        "selector",
        "    def best(",
        "    def check(self, objectives):\n        self.settings.objective\n\n    def best(",
        "AttributeError: 'Settings' object has no attribute 'objective'",
    ),
    "a score that is an array": (
        "objective",
        'return {"net": gross - segments.idle(self.target.name), "gross": gross}',
        "return gross",
        "score gives a ndarray, expected names with arrays",
    ),
    "a score of nobody": (
        "objective",
        'return {"net": gross - segments.idle(self.target.name), "gross": gross}',
        "pass",
        "score gives a NoneType, expected names with arrays",
    ),
    "a comparison that is a number": (
        "objective",
        "return Comparison(saved, saved,",
        "return saved, (saved,",
        "compare() gave tuple, expected Comparison",
    ),
    "a target of twelve": (
        "objective",
        "    target = TARGET\n",
        "    target = Channel(TARGET.name, 'W', (12,))\n",
        "a model predicts one.",
    ),
    "an input that is no tuple": (
        "objective",
        'inputs = ("joint_torque", "joint_velocity")',
        'inputs = "joint_torque"',
        "its inputs are 'joint_torque', expected names of channels, such as ('joint_torque',)",
    ),
    "a unit of a metric": (
        "objective",
        '    unit = "1"',
        '    metric_units = {"net": "wats"}\n    unit = "1"',
        "metric_units of 'net': No unit named 'wats'",
    ),
    "a text for a model": (
        "robot",
        "return build()",
        "return build().to_xml_string()",
        "mjcf() gives a str, expected a tree of dm_control",
    ),
    "a text for a path": (
        "robot",
        "return self.settings.policy or POLICY",
        "return str(POLICY)",
        "pretrained_policy() gives a str, expected a pathlib.Path",
    ),
    "a robot without a spec": ("robot", "    spec = SPEC\n", "", "its class sets no spec, a hts.contracts.RobotSpec"),
    "a list for channels": (
        "robot",
        "return standard_channels(self.spec.num_joints, len(self.spec.foot_sites))",
        "return list(standard_channels(2, 2).values())",
        "channels() gives a list, expected names with hts.channels.Channel",
    ),
    "a range the wrong way round": (
        "robot",
        "position_limit=((-1e4, 1e4), (-1e4, 1e4))",
        "position_limit=((-1e4, 1e4), (1e4, -1e4))",
        "spec.position_limit of 'right' is 10000 to -10000, expected the lower end first",
    ),
    "a motor without a constant": (
        "robot",
        "torque_constant=(0.05, 0.05)",
        "torque_constant=(0.05, 0.0)",
        "spec.motors.torque_constant of 'right' is 0, expected a number above 0",
    ),
    "an objective without a target": ("objective", "    target = TARGET\n", "", "its class sets no target"),
    "a world without a name": ("world", '    name = "bench"\n', "", 'does not say its name: add `name = "bench"`'),
    "a generator for recordings": (
        "world",
        "        return [\n            self._recording(self._machine",
        "        yield from [\n            self._recording(self._machine",
        "collect gives a generator, expected a list of recordings",
    ),
}
"""What is wrong -> kind, text, what takes its place, and what the one line must say."""


@pytest.mark.parametrize("what", ANSWERS)
def test_an_answer_of_another_kind_is_one_line(faults, what):
    kind, before, after, said = ANSWERS[what]
    *lines, count = faults(kind, before, after)
    assert len(lines) == 1 and said in lines[0], lines
    assert f"{kind} '{NAMES[kind]}'" in lines[0] and "Traceback" not in lines[0]
    assert re.search(r": \d+ checks, 1 failed", count)


@pytest.mark.parametrize("shape", [1, [12], (12.0,), "12", (-1,), None])
def test_a_shape_that_is_no_tuple_of_whole_numbers_is_refused_with_the_channels_name(shape):
    with pytest.raises(RecordingError, match=r"Channel 'heat': shape is .*, expected a tuple of whole numbers"):
        Channel("heat", "W", shape)
