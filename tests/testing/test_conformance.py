"""The conformance kit on our plugins, and on what `test_broken_plugins` leaves out: worlds, log readers, commands."""

from __future__ import annotations

import json
import subprocess
import sys
from types import SimpleNamespace

import pytest

from hts.cli.commands import COMMANDS
from hts.cli.main import main
from hts.errors import ConfigError, PluginError
from hts.plugins import KINDS, Entry, load
from hts.testing.checks import CHECKS
from hts.testing.checks.objectives import reward_remembers_no_data
from hts.testing.checks.rewards import clips_nothing
from hts.testing.conformance import Finding, check_package, package_of
from hts.testing.examples.objective.objective import Fake
from hts.testing.packages import KIT, kit_installed

OURS = ["hard-to-sim-power", "hard-to-sim-noise", "hard-to-sim-go1", KIT]


def faults(package: str) -> list[str]:
    """Lines of everything that is not kept."""
    found = check_package(load(), package, reserved=COMMANDS)
    assert found
    return [finding.line() for finding in found if finding.fault is not None]


@pytest.mark.parametrize("package", OURS)
def test_our_own_plugins_keep_the_contracts(package):
    with kit_installed():
        assert faults(package) == []


@pytest.mark.slow
def test_what_the_core_offers_keeps_the_contracts():
    assert faults("hard-to-sim") == []  # the world `twin` among it, which starts processes


def test_every_kind_has_checks_and_every_check_a_demand_of_one_paragraph():
    assert set(CHECKS) == set(KINDS)
    for checks in CHECKS.values():
        assert checks
        for check in checks:
            assert check.__doc__ and check.__doc__.strip().endswith(".") and "\n\n" not in check.__doc__.strip()


@pytest.mark.parametrize(
    "reward",
    [lambda z: -z.tanh(), lambda z: (-20 * z).sigmoid(), lambda z: -(z - 1).relu(), lambda z: (1 - z.abs()).relu()],
)
def test_a_reward_that_saturates_is_not_called_clipped(reward):
    clips_nothing(Entry("odd", lambda settings: SimpleNamespace(reward=reward), "odd-lab"), load())


class Held(Fake):
    """Wants a level of 3 W, which it knows in standard deviations once weights_for was asked."""

    wanted = 0.0

    def weights_for(self, spread, recordings):
        self.wanted = (3.0 - float(recordings[0].values("fake_level").mean())) / spread
        return self.weights

    def reward(self, prediction):
        return -(prediction - self.wanted).square()


def test_a_reward_that_hangs_on_what_weights_for_saw_is_found():
    with kit_installed():
        reward_remembers_no_data(Entry("fake", lambda settings: Fake(), "odd-lab"), load())
        with pytest.raises(PluginError, match="reward gives other numbers once weights_for was asked"):
            reward_remembers_no_data(Entry("fake", lambda settings: Held(), "odd-lab"), load())


# -------------------------------------------------------------------------------------------------- worlds

WORLD = """
from hts import hookimpl

HTS_API = 2


def make(settings, context):
    from hts.testing import known_world

    made = known_world.make_known(settings, context)
    made.name = "odd"
    collect, head_to_head = made.collect, made.head_to_head
{changes}
    return made


@hookimpl
def hts_worlds(register):
    register("odd", make)
"""


def offering_world(install, *changes: str) -> list[str]:
    source = WORLD.format(changes="\n".join(f"    {line}" for line in changes))
    install("odd-lab", {"odd_lab": source}, {"odd": "odd_lab"})
    return faults("odd-lab")


def test_a_sound_world_passes(install):
    assert offering_world(install) == []


ROVER = """

import dataclasses
from hts.errors import WorldError
from hts.testing.examples.robot.robot import Tiny


class Rover(Tiny):
    spec = dataclasses.replace(Tiny.spec, name="rover")

    def pretrained_policy(self):
        from pathlib import Path

        from hts.testing.tiny_policy import write_drive_policy

        path = Path("FOLDER") / "pretrained.safetensors"
        if not path.exists():
            write_drive_policy(path, "rover")
        return path


def make_odd(settings, context):
    if context.robot != "rover":
        raise WorldError(f"This world has a rover and no '{context.robot}'.")
    return make(settings, context)


@hookimpl
def hts_robots(register):
    register("rover", lambda settings: Rover())
"""


def test_a_world_of_one_machine_needs_no_objective_in_its_package(install, tmp_path):
    source = WORLD.format(changes="").replace('"odd", make)', '"odd", make_odd)') + ROVER.replace(
        "FOLDER", str(tmp_path)
    )
    install("odd-lab", {"odd_lab": source}, {"odd": "odd_lab"})
    assert [line for line in faults("odd-lab") if "world 'odd'" in line] == []


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        (["made.collect = lambda p, s: collect(p, s)[:1]"], "gives 1 recordings for 2 policies"),
        (["made.name = 'even'"], "calls itself 'even'"),
        (["made.simulated = None"], "does not say whether it is simulated"),
        (["made.cost = lambda seconds: {}"], "says that 60 s of walking cost {}"),
        (["context.objectives['more'] = {}"], "changes its context in place"),
        (
            ["if context.folder.is_dir():", "    (context.folder / 'x').write_text('')"],
            "writes files when it is made",
        ),
        (
            ["def again(p, s):", "    made.seed += 1", "    return collect(p, s)", "made.collect = again"],
            "is another one when asked again",
        ),
        (
            ["made.head_to_head = lambda p, r, v: sorted(head_to_head(p, r, v), key=lambda x: x.role)"],
            "roles of its blocks are ['policy', 'policy', 'policy', 'policy']",
        ),
        (
            ["made.head_to_head = lambda p, r, v: [x.replace(session='one') for x in head_to_head(p, r, v)]"],
            "2 speeds are 1 session(s)",
        ),
        (["made.settings = made.settings.model_copy(update={'level': float('nan')})"], "fake_level"),
        (
            ["made.head_to_head = lambda p, r, v: [x.replace(notes={}) for x in head_to_head(p, r, v)]"],
            "says that it holds the speed, and its recordings have no note",
        ),
        (
            [
                "def wandering(p, r, v):",
                "    notes = lambda x: {**x.notes, 'held_command': repr(0.8 + 0.01 * x.block)} if x.notes else x.notes",
                "    return [x.replace(notes=notes(x)) for x in head_to_head(p, r, v)]",
                "made.head_to_head = wandering",
            ],
            "noted a command of 0.81 m/s and sent 0.8 to 0.8",
        ),
        (["made.hold_speed = lambda hold: True"], "have no note"),
    ],
)
def test_a_faulty_world_is_named_with_its_fault(install, changes, fault):
    found = offering_world(install, *changes)
    assert any(f"odd-lab: world 'odd': {fault}" in line or fault in line for line in found), found
    assert all(line.startswith("odd-lab: world 'odd': ") and "\n" not in line for line in found)


# ------------------------------------------------------------------------------------ log readers and commands

READER = """
from hts import hookimpl
from hts.contracts import LogReader
from hts.config import Config
from hts.errors import RecordingError

HTS_API = 2


class Settings(Config):
    gap: float = 1.0


class Reader(LogReader):
    def read(self, files, mapping, robot):
        {body}


def make(settings):
    Settings(**settings)
    return Reader()


@hookimpl
def hts_log_readers(register):
    register("tape", make)
"""


@pytest.mark.parametrize(
    ("body", "fault"),
    [
        ("raise RecordingError(f'{files[0]}: not a tape.')", None),
        ("raise KeyError('time')", "missing.log ends in a traceback, KeyError: 'time'"),
        ("return None", "makes a recording of missing.log"),
        ("raise RecordingError('two\\nlines')", "says of missing.log in several lines"),
        ("mapping['x'] = 1; raise RecordingError('no')", "changes the mapping that it is given in place"),
    ],
)
def test_a_log_reader_is_honest_about_bad_files(install, body, fault):
    install("tapes", {"tapes": READER.format(body=body)}, {"tape": "tapes"})
    found = faults("tapes")
    assert (found == []) if fault is None else any(f"tapes: log reader 'tape': {fault}" in line for line in found), (
        found
    )


COMMAND = """
from hts import hookimpl

HTS_API = 2


def make():
    {doc}
    return {function}


def work(name: str = "x"):
    print(name)


@hookimpl
def hts_commands(register):
    register("{name}", make)
"""


@pytest.mark.parametrize(
    ("name", "doc", "function", "fault"),
    [
        ("tidy", "'''Tidies up.'''", "work", None),
        ("tidy", "", "work", "its factory has no docstring"),
        ("tidy", "'''Tidies up.'''", "3", "its factory gives a int, not a function"),
        ("run", "'''Runs.'''", "work", "'run' is a command of hts"),
        ("tidy up", "'''Tidies up.'''", "work", "is named 'tidy up'"),
    ],
)
def test_a_command_can_be_called_and_hides_none(install, name, doc, function, fault):
    install("tools", {"tools": COMMAND.format(name=name, doc=doc, function=function)}, {"tool": "tools"})
    found = faults("tools")
    assert (found == []) if fault is None else any(f"tools: command '{name}': {fault}" in line for line in found), found


# -------------------------------------------------------------------------------------------- the command itself


def test_a_package_that_is_not_installed_is_answered_with_the_closest():
    with pytest.raises(ConfigError, match="Did you mean 'hard-to-sim'"):
        check_package(load(), "hard-to-simm")


def test_a_package_that_registers_nothing_is_named(install):
    install("silent", {"silent": "HTS_API = 2"}, {"silent": "silent"})
    (line,) = faults("silent")
    assert line.startswith("silent: module silent: registers nothing. Expected: ")


def test_a_package_may_be_named_by_its_folder(tmp_path):
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "hard-to-sim-go1"\n')
    assert package_of(str(tmp_path)) == "hard-to-sim-go1"
    assert package_of("hard-to-sim-go1") == "hard-to-sim-go1"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("hts-nowhere", "package 'hts-nowhere' is not installed: pip install -e {folder}"),
        ("pydantic", "package 'pydantic' is installed and has no entry point of the group 'hts'"),
    ],
)
def test_a_folder_whose_package_is_not_there_is_told_how_to_be_installed(tmp_path, capsys, name, said):
    (tmp_path / "pyproject.toml").write_text(f'[project]\nname = "{name}"\n')
    assert main(["check", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and said.format(folder=tmp_path) in error and "Did you mean" not in error


@pytest.mark.parametrize("text", [None, "no toml [", "[project]\n"])
def test_a_folder_that_is_no_package_is_refused_in_one_line(tmp_path, text, capsys):
    if text is not None:
        (tmp_path / "pyproject.toml").write_text(text)
    assert main(["check", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "expected a pyproject.toml with a project name" in error


def test_the_command_speaks_json(capsys, install):
    install("stranger", {"stranger": "import no_such_library"}, {"odd": "stranger"})
    assert main(["check", "stranger", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert (found["package"], found["failed"]) == ("stranger", 1)
    (finding,) = found["findings"]
    assert finding["fault"] == "ModuleNotFoundError: No module named 'no_such_library'"


def test_a_finding_is_one_line_with_package_subject_fault_and_demand():
    finding = Finding("lab", "robot 'spot'", "It has four legs.", "has three legs.")
    assert finding.line() == "lab: robot 'spot': has three legs. Expected: It has four legs."
    asks = Finding("lab", "robot 'spot'", "It has four legs.", "gives None: is `return` missing?")
    assert asks.line() == "lab: robot 'spot': gives None: is `return` missing? Expected: It has four legs."


def test_the_kit_is_gone_when_it_is_no_longer_needed():
    before = list(sys.path)
    with kit_installed():
        assert "tiny" in load().robots and "known" in load().worlds
        code = "from hts.plugins import load; print('tiny' in load().robots)"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert done.stdout.strip() == "True"  # processes that are started see it too
    assert "tiny" not in load().robots
    assert sys.path == before
