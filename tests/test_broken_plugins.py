"""Plugins that are broken, each in one way: `hts check` says which and why in one line; unbroken, the plugin passes.

Every package here is what `hts new` writes, with one text in one file replaced by another, found by its entry point.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from hts.cli.main import main
from hts.testing.packages import write_package
from hts.testing.starters import write_starter

NAMES = {"objective": "heat", "robot": "hopper", "selector": "steady"}


@dataclass(frozen=True)
class Said:
    """What `hts check` printed, and its exit status."""

    status: int
    text: str

    @property
    def faults(self) -> list[str]:
        return [line for line in self.text.splitlines() if line.startswith(("FAIL", "error:"))]


@pytest.fixture
def check(tmp_path, monkeypatch, capsys) -> Callable[..., Said]:
    """check(kind, file, before, after, also=(package, kind)): that kind's package, one text replaced, checked."""

    def written(kind: str, package: str) -> Path:
        folder = write_starter(kind, NAMES[kind], tmp_path / package)
        module = f"hts_{NAMES[kind]}"
        write_package(folder, package, {}, {NAMES[kind]: f"{module}.plugin"})
        return folder

    def run(kind: str, file: str = "", before: str = "", after: str = "", also: str = "") -> Said:
        folder = written(kind, f"broken-{kind}")
        if file:
            place = folder / f"hts_{NAMES[kind]}" / file
            text = place.read_text()
            assert before in text, f"{file} has no {before!r}"
            place.write_text(text.replace(before, after))
        for one in (folder, *([written(kind, also)] if also else [])):
            monkeypatch.syspath_prepend(str(one))
        monkeypatch.setenv("PYTHONPATH", str(folder))  # for what is tried in a process of its own
        status = main(["check", f"broken-{kind}", "--quiet"])
        out = capsys.readouterr()
        return Said(status, out.out + out.err)

    yield run
    for name in [name for name in sys.modules if name.split(".")[0] in {f"hts_{name}" for name in NAMES.values()}]:
        del sys.modules[name]


@pytest.mark.parametrize("kind", NAMES)
def test_the_same_plugin_unbroken_passes(check, kind):
    said = check(kind)
    assert (said.status, said.faults) == (0, []), said.text
    assert re.search(rf"broken-{kind}: \d+ checks, 0 failed", said.text)


HOOK = "def hts_objectives(register):"
REWARD = "return -prediction"
BROKEN = {
    "misspelt hook": ("objective", "plugin.py", HOOK, "def hts_objectivs(register):", "hts_objectivs"),
    "wrong shape of a score": (
        "objective",
        "objective.py",
        ".mean(axis=1)",
        ".mean()",
        "objective 'heat': score 'gross' has shape ()",
    ),
    "wrong shape of a reward": (
        "objective",
        "objective.py",
        REWARD,
        f"{REWARD}.unsqueeze(-1)",
        "objective 'heat': reward has shape (3, 4, 1)",
    ),
    "wrong shape of a reading": (
        "objective",
        "meter.py",
        "self.level + self.settings.noise * self.rng.standard_normal(self.level.shape)",
        "self.level[:1]",
        "instrument 'heat_meter': 'heat_level' has shape (1,) for 3 robots",
    ),
    "wrong shape of a spec": (
        "robot",
        "robot.py",
        "kp=(0.1, 0.1)",
        "kp=(0.1,)",
        "robot 'hopper': spec.kp has 1 entries for 2 joints",
    ),
    "unit that nobody knows": ("objective", "objective.py", '"W", ()', '"wattage", ()', "No unit named 'wattage'"),
    "unit of the improvement": (
        "objective",
        "objective.py",
        'unit = "1"',
        'unit = "percentage"',
        "objective 'heat': No unit named 'percentage'",
    ),
    "unit of the instrument": (
        "objective",
        "meter.py",
        "    channels = (TARGET,)",
        '    channels = (__import__("dataclasses").replace(TARGET, unit="J"),)',
        "'heat_level' is W () here and J () in 'heat_meter'",
    ),
    "unit of a standard channel": (
        "robot",
        "robot.py",
        "return standard_channels(self.spec.num_joints, len(self.spec.foot_sites))",
        "return {**standard_channels(2, 2), 'joint_torque': Channel('joint_torque', 'N', (2,))}",
        "robot 'hopper': channel 'joint_torque' is N (2,)",
    ),
    "NaN for ordinary numbers": (
        "objective",
        "objective.py",
        REWARD,
        "return -prediction.log()",
        "objective 'heat': reward gives NaN",
    ),
    "NaN turned into a number": (
        "objective",
        "objective.py",
        REWARD,
        "return -prediction.nan_to_num()",
        "objective 'heat': reward makes -0 of a NaN",
    ),
    "NaN left out of a score": (
        "objective",
        "objective.py",
        "segments.values(self.target.name).mean(axis=1)",
        "__import__('numpy').nanmean(segments.values(self.target.name), axis=1)",
        "objective 'heat': score makes a number of a NaN",
    ),
    "NaN in a reading": (
        "objective",
        "meter.py",
        "self.settings.noise * self",
        "np.nan * self",
        "instrument 'heat_meter': 'heat_level' is not finite",
    ),
    "import error": (
        "objective",
        "plugin.py",
        "from hts import hookimpl",
        "import no_such_library\nfrom hts import hookimpl",
        "No module named 'no_such_library'",
    ),
    "torch at import": (
        "objective",
        "plugin.py",
        "from hts import hookimpl",
        "import torch\nfrom hts import hookimpl",
        "imports torch when it is loaded",
    ),
    "torch when it is asked": (
        "objective",
        "plugin.py",
        f"{HOOK}\n",
        f"{HOOK}\n    import torch\n\n    torch.manual_seed(0)\n",
        "imports torch when it is loaded",
    ),
    "reward of the crowd": (
        "objective",
        "objective.py",
        REWARD,
        "return -(prediction - prediction.mean())",
        "objective 'heat': reward of candidate 0 depends on the candidates beside it",
    ),
    "proxy of the crowd": (
        "objective",
        "objective.py",
        ".abs().sum(-1)",
        ".abs().sum(-1).cumsum(0)",
        "objective 'heat': proxy of candidate 1 depends on the candidates beside it",
    ),
    "reading of the crowd": (
        "objective",
        "meter.py",
        "torque, speed = sample.motor_torque,",
        "torque, speed = sample.motor_torque.mean(0, keepdims=True) + 0 * sample.motor_torque,",
        "instrument 'heat_meter': 'heat_level' of a robot depends on the robots beside it",
    ),
    "random numbers of the crowd": (
        "robot",
        "robot.py",
        "config, channels=(), seeds=None):",
        "config, channels=(), seeds=None):\n        seeds = [sum(seeds)] * num_candidates",
        "is another one alone than in a crowd",
    ),
    "physics steps that are not kept": (
        "robot",
        "robot.py",
        "config, channels=(), seeds=None):",
        "config, channels=(), seeds=None):\n        channels = [c for c in channels if c[:3] != 'sub'] or ['command']",
        "robot 'hopper': keeps_physics_steps is set, and of channels ",
    ),
    "settings changed in place": (
        "objective",
        "plugin.py",
        "    from hts_heat import objective\n",
        "    from hts_heat import objective\n\n    settings.setdefault('hidden', 32)\n",
        "objective 'heat': changes its settings in place: setdefault('hidden')",
    ),
    "env's config changed in place": (
        "robot",
        "robot.py",
        "changed = config.model_copy(",
        "config.reward_weights['pose'] = 0.0\n        changed = config.model_copy(",
        "robot 'hopper': make_env changes the env's configuration in place",
    ),
    "prediction changed in place": (
        "objective",
        "objective.py",
        REWARD,
        "return prediction.neg_()",
        "objective 'heat': reward changes 'prediction' in place",
    ),
    "recordings changed in place": (
        "objective",
        "objective.py",
        "        gross = ",
        "        segments.recordings[0].channels[self.target.name].values[:] *= 2\n        gross = ",
        "objective 'heat': score changes 'heat_level' of the recordings in place",
    ),
    "physics changed in place": (
        "objective",
        "meter.py",
        "        torque, speed",
        "        sample.motor_torque *= 2\n        torque, speed",
        "instrument 'heat_meter': step() changes motor_torque in place",
    ),
    "candidates sorted in place": (
        "selector",
        "selector.py",
        "        def rank(",
        "        candidates.sort(key=lambda c: c.id, reverse=True)\n\n        def rank(",
        "selector 'steady': elites changes the list that it is given in place",
    ),
    "unknown channel": (
        "objective",
        "objective.py",
        '"joint_torque", "joint_velocity")',
        '"joint_torqe", "joint_velocity")',
        "objective 'heat': No channel named 'joint_torqe'. Did you mean 'joint_torque'?",
    ),
    "reward against the score": (
        "objective",
        "objective.py",
        REWARD,
        "return prediction",
        "objective 'heat': reward pays for more of the target, compare for less of it",
    ),
    "any setting goes": (
        "objective",
        "objective.py",
        "class Settings(Config):",
        "class Settings(Config, extra='ignore'):",
        "objective 'heat': takes the setting 'no_such_setting_of_anything'",
    ),
    "dishonest error": (
        "robot",
        "plugin.py",
        "robot.Settings(**settings)",
        "robot.Settings(policy=settings and settings['policy'] or None)",
        "robot 'hopper': a wrong setting 'no_such_setting_of_anything' ends in a traceback, KeyError",
    ),
    "another name": (
        "objective",
        "objective.py",
        'name = "heat"',
        'name = "warmth"',
        "objective 'heat': calls itself 'warmth'",
    ),
    "reward leaves the device": (
        "objective",
        "objective.py",
        REWARD,
        "import numpy, torch\n\n        return -torch.from_numpy(numpy.asarray(prediction))",
        "objective 'heat': reward leaves the device",
    ),
    "too many elites": (
        "selector",
        "selector.py",
        "key=rank)[:count]",
        "key=rank)",
        "selector 'steady': 1 were asked for, elites are",
    ),
    "the fallen first": (
        "selector",
        "selector.py",
        "(unknown, candidate.falls > 0,",
        "(unknown, False,",
        "selector 'steady': takes a candidate with score 9, 2 falls",
    ),
    "clipped reward": (
        "objective",
        "objective.py",
        REWARD,
        "return -prediction.clamp(-5, 5)",
        "objective 'heat': reward is the same for all predictions below -5 and above 5 standard deviations",
    ),
    "weights of one number": (
        "objective",
        "objective.py",
        "= self.settings.weights",
        "= 1.0",
        "objective 'heat': its weights are 1.0, expected a tuple of numbers",
    ),
    "policy of another robot": (
        "robot",
        "robot.py",
        "kd=(1.0, 1.0)",
        "kd=(2.0, 2.0)",
        "made for kd (1.0, 1.0), robot 'hopper' has (2.0, 2.0)",
    ),
    "model without the trunk": ("robot", "robot.py", 'trunk_body="trunk"', 'trunk_body="chassis"', "no body 'chassis'"),
}
"""What is broken -> kind, file, text, what takes its place, and what the line must say."""


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_plugin_is_named_with_its_cause_in_one_line(check, what):
    kind, file, before, after, cause = BROKEN[what]
    said = check(kind, file, before, after)
    assert said.status != 0
    assert "Traceback" not in said.text
    telling = [line for line in said.faults if cause in line]
    assert telling, said.text
    assert all(f"broken-{kind}" in line and "Expected: " in line for line in telling), telling
    assert len(said.text.splitlines()) == len(said.faults) + 1, said.text  # one line each, and the count


def test_two_plugins_of_one_name_are_named_both(check):
    said = check("robot", also="second-lab")
    assert said.status != 0
    assert said.text.count("\n") == 1 and "Traceback" not in said.text
    assert said.text.startswith("error: Two robots are named 'hopper': one from broken-robot, one from second-lab.")


def test_a_plugin_that_ends_the_process_is_named(check):
    said = check(
        "robot", "plugin.py", "from hts import hookimpl", "import sys\nfrom hts import hookimpl\n\nsys.exit(3)"
    )
    assert said.status == 1
    assert [line for line in said.faults if "broken-robot: entry point 'hopper': SystemExit: 3" in line], said.text


ALONE = {
    "a unit": ("objective.py", '"W", ()', '"wattage", ()', 2),  # the instrument imports it too
    "an input": ("objective.py", '"joint_torque", "joint_velocity")', '"joint_torqe", "joint_velocity")', 1),
    "a reward of numpy": ("objective.py", REWARD, f"{REWARD}.numpy()", 1),
    "a reward of all samples": ("objective.py", REWARD, f"{REWARD}.mean()", 1),
    "an instrument's name": ("objective.py", 'instrument = "heat_meter"', 'instrument = "heat_metre"', 1),
    "weights of one number": ("objective.py", "= self.settings.weights", "= 1.0", 1),
}
"""One mistake -> where, what for what, and in how many lines it may be said: once for each thing that has it."""


@pytest.mark.parametrize("what", ALONE)
def test_one_mistake_is_one_line_and_what_needs_it_waits(check, what):
    file, before, after, lines = ALONE[what]
    said = check("objective", file, before, after)
    assert len(said.faults) == lines, said.text
    assert re.search(rf"checks, {lines} failed, \d+ wait until these are kept", said.text)
    assert "is float32" not in said.text and "KeyError" not in said.text


FAILS = ("objective.py", "        gross = segments", "        gross = {}['no such key'] or segments")


def test_a_mistake_is_told_with_its_line_in_the_package(check, tmp_path):
    said = check("objective", *FAILS)
    (file,) = tmp_path.glob("broken-objective/**/hts_heat/objective.py")
    number = file.read_text().partition("no such key")[0].count("\n") + 1
    assert f"KeyError: 'no such key' (at {file}:{number})" in said.text
    assert "Traceback" not in said.text


def test_the_traceback_is_shown_where_it_is_asked_for(check, monkeypatch):
    monkeypatch.setenv("HTS_DEBUG", "1")
    said = check("objective", *FAILS)
    assert "Traceback (most recent call last)" in said.text and "in score" in said.text
