"""The command line: what it lists, how it ends, and what it says when something is wrong."""

from __future__ import annotations

import errno
import json
import os
import sys
import threading
import types
from pathlib import Path

import pytest

from hts.cli.main import main
from hts.cli.one_line import disk_fault, one_line, resumable
from hts.config_loading import dump_config, load_config
from hts.errors import PolicyError, RunError, WaitingForRobot

FAKES = """
from hts import hookimpl
HTS_API = 2

def make_fake(settings):
    from hts.testing.examples.objective.objective import Fake
    return Fake()

def make_hopper(settings):
    from dataclasses import replace
    from hts.testing.examples.robot.robot import Tiny
    return type("Hopper", (Tiny,), {"spec": replace(Tiny.spec, name="hopper")})()

@hookimpl
def hts_objectives(register): register("fake", make_fake)
@hookimpl
def hts_robots(register): register("hopper", make_hopper)
"""


@pytest.fixture
def fakes(install):
    return install("lab", {"lab_plugin": FAKES}, {"lab": "lab_plugin"})


@pytest.fixture
def fake_run(monkeypatch):
    """Stands in for hts.run, which is tested elsewhere: remembers what it was called with, and may raise."""
    module = types.ModuleType("hts.run")
    module.calls = []
    module.error = None

    def start_run(config, out, *, dry_run=False, registry=None):
        module.calls.append((config, out, dry_run))
        if module.error:
            raise module.error

    module.start_run = start_run
    module.resume_run = lambda folder: module.calls.append(folder)
    monkeypatch.setitem(sys.modules, "hts.run", module)
    return module


RUN = ["run", "--objective", "fake", "--robot", "hopper"]


def one_line_of(capsys) -> str:
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1, err
    return err


def test_a_misspelt_command_is_answered_with_the_closest(capsys):
    assert main(["confg"]) == 2
    assert one_line_of(capsys).startswith("error: No command named 'confg'. Did you mean 'config'?")


def test_a_misspelt_option_ends_in_one_line(capsys):
    assert main(["run", "--objectve", "x"]) == 2
    assert "--objective" in one_line_of(capsys)


@pytest.mark.parametrize(
    ("arguments", "closest"),
    [
        (["--objective", "faek", "--robot", "hopper"], "fake"),
        (["--objective", "fake", "--robot", "hoper"], "hopper"),
        (["--objective", "fake", "--robot", "hopper", "--preset", "smoek"], "smoke"),
        (["--objective", "fake", "--robot", "hopper", "--set", "finetune.num_env=3"], "num_envs"),
    ],
)
def test_a_misspelt_name_ends_in_one_line_with_the_closest(fakes, capsys, arguments, closest):
    assert main(["run", *arguments]) == 2
    assert f"Did you mean '{closest}'?" in one_line_of(capsys)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([*RUN, "--reward", "foo"], "error: --reward: expected model or proxy, found 'foo'."),
        ([*RUN, "--set", "reward_source=foo"], "error: --set reward_source: expected model or proxy, found 'foo'."),
        ([*RUN, "--seed", "-3"], "error: --seed: expected at least 0, found -3."),
        ([*RUN, "--seed", "-3", "--set", "seed=-4"], "error: --set seed: expected at least 0, found -4."),
        ([*RUN, "--reward", "oracle"], "error: --reward (reward_source): `oracle` looks into the reality"),
        (["baseline", *RUN[1:], "--seed", "-3"], "error: --seed: expected at least 0, found -3."),
        (["config", "show", *RUN[1:], "--seed", "-3"], "error: --seed: expected at least 0, found -3."),
        (["oracle", *RUN[1:], "--steps", "0"], "error: --steps (finetune.steps): expected more than 0, found 0."),
        (["pretrain", "--robot", "go1", "--out", "x", "--seed", "-3"], "error: --seed: expected at least 0, found -3."),
    ],
)
def test_a_wrong_value_is_named_by_the_option_that_was_typed(fakes, tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").write_text("seed: 5\nreward_source: proxy\n")
    given = [] if arguments[0] == "pretrain" else ["--config", "mine.yaml"]  # what an option says wins over it
    assert main([*arguments, *given]) == 2
    assert one_line_of(capsys).startswith(said)


def test_a_run_goes_into_a_folder_named_after_it(fakes, fake_run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([*RUN, "--seed", "3"]) == 0
    ((config, folder, dry_run),) = fake_run.calls
    assert (folder, dry_run) == (Path("runs/fake-hopper-quick-3"), False)
    assert config.reward_source == "model"


def test_the_baseline_is_a_run_with_the_proxy(fakes, fake_run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["baseline", "--objective", "fake", "--robot", "hopper"]) == 0
    ((config, folder, _),) = fake_run.calls
    assert (config.reward_source, folder) == ("proxy", Path("runs/fake-hopper-proxy-quick-0"))


def test_a_folder_with_a_run_in_it_asks_for_resume_or_another(fakes, tmp_path, capsys):
    (tmp_path / "config.yaml").write_text("")
    assert main([*RUN, "--out", str(tmp_path)]) == 2
    line = one_line_of(capsys)
    assert f"hts resume {tmp_path}" in line and "--out" in line


def test_a_folder_with_anything_else_in_it_asks_for_another(fakes, tmp_path, capsys):
    (tmp_path / "thesis.tex").write_text("")
    assert main([*RUN, "--out", str(tmp_path)]) == 2
    assert "--out" in one_line_of(capsys)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_an_empty_folder_is_taken(fakes, fake_run, tmp_path):
    assert main([*RUN, "--out", str(tmp_path)]) == 0
    assert len(fake_run.calls) == 1


def test_a_dry_run_may_look_at_a_folder_that_is_taken(fakes, fake_run, tmp_path):
    (tmp_path / "config.yaml").write_text("")
    assert main([*RUN, "--out", str(tmp_path), "--dry-run"]) == 0
    assert fake_run.calls[0][2] is True


def test_a_dry_run_that_fails_does_not_speak_of_the_run_that_lies_there(fakes, fake_run, tmp_path, capsys):
    (tmp_path / "config.yaml").write_text("")
    fake_run.error = PolicyError("walk.json: no such file.")
    assert main([*RUN, "--out", str(tmp_path), "--dry-run"]) == 2
    assert one_line_of(capsys) == "error: walk.json: no such file.\n"


def test_resume_wants_a_run_folder(fake_run, tmp_path, capsys):
    assert main(["resume", str(tmp_path / "nowhere")]) == 2
    assert "there is no such folder" in one_line_of(capsys)
    assert main(["resume", str(tmp_path)]) == 2
    assert "no config.yaml" in one_line_of(capsys)
    resolved = load_config(objectives=["anything"], robot="go1", preset="smoke")
    (tmp_path / "config.yaml").write_text(dump_config(resolved))
    assert main(["resume", str(tmp_path)]) == 0
    assert fake_run.calls == [tmp_path]


def test_ctrl_c_says_how_to_go_on(fakes, fake_run, tmp_path, capsys):
    def start_run(config, out, *, dry_run=False, registry=None):
        (out / "config.yaml").write_text("")
        raise KeyboardInterrupt

    fake_run.start_run = start_run
    assert main([*RUN, "--out", str(tmp_path)]) == 130
    assert f"`hts resume {tmp_path}` goes on" in capsys.readouterr().err


def test_waiting_for_the_robot_is_not_an_error(fakes, fake_run, tmp_path, capsys):
    fake_run.error = WaitingForRobot("Now walk the robot, then: hts resume here")
    assert main([*RUN, "--out", str(tmp_path)]) == 75
    assert one_line_of(capsys) == "Now walk the robot, then: hts resume here\n"


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.EROFS, "read-only"),
        (errno.EACCES, "no permission"),
        (errno.ENOTDIR, "is a file, not a folder"),
        (errno.EEXIST, "exists already"),
        (errno.ENAMETOOLONG, "too long"),
        (errno.ENOSPC, "the disk is full"),
    ],
)
def test_a_disk_that_cannot_be_written_names_the_file_and_what_to_do(fakes, fake_run, tmp_path, capsys, number, words):
    fake_run.error = OSError(number, "system text", "/somewhere/data.zarr")
    assert main([*RUN, "--out", str(tmp_path)]) == 2
    line = one_line_of(capsys)
    assert line.startswith("error: /somewhere/data.zarr: ") and words in line
    assert "resume" not in line  # nothing was begun
    begun = tmp_path / "begun today"
    begun.mkdir()
    (begun / "config.yaml").touch()
    with pytest.raises(RunError, match=f"`hts resume '{begun}'` goes on"), resumable(begun):
        raise fake_run.error


def test_a_full_disk_that_names_no_file_names_the_run_folder(fakes, fake_run, tmp_path, capsys):
    fake_run.error = OSError(errno.ENOSPC, "No space left on device")
    main([*RUN, "--out", str(tmp_path)])
    assert one_line_of(capsys).startswith(f"error: {tmp_path}: the disk is full")


def test_a_full_disk_is_seen_through_the_error_of_a_library():
    try:
        try:
            raise OSError(errno.ENOSPC, "No space left on device", "/data/file")
        except OSError as error:
            raise RuntimeError("could not serialise") from error
    except RuntimeError as error:
        assert disk_fault(error).startswith("/data/file: the disk is full")
    assert disk_fault(RuntimeError("I/O error: No space left on device (os error 28)"), Path("run")).startswith("run: ")
    assert disk_fault(RuntimeError("something else")) is None
    assert disk_fault(FileNotFoundError(errno.ENOENT, "gone", "file")) is None


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.EFBIG, "larger than is allowed here (`ulimit -f`"),
        (errno.EIO, "input/output error"),
        (errno.ESTALE, "the network file system has lost it"),
        (errno.EMFILE, "too many files are open. Raise the limit (`ulimit -n`)"),
    ],
)
def test_other_faults_of_a_disk_are_one_line_too_and_seen_in_the_text_of_a_library(number, words):
    own = OSError(number, os.strerror(number), "/data/file")
    assert disk_fault(own).startswith("/data/file: ") and words in disk_fault(own)
    assert words in disk_fault(RuntimeError(f"I/O error: {os.strerror(number)} (os error {number})"), Path("run"))
    assert "error: /data/file: " in one_line(own)[0] and one_line(own)[1] == 2


def test_a_thread_that_the_disk_stopped_says_nothing_and_any_other_does(tmp_path, capsys):
    def stopped(error):
        raise error

    for error, words in ((OSError(errno.ENOSPC, "No space left on device"), ""), (ValueError("ours"), "ours")):
        with resumable(tmp_path):
            thread = threading.Thread(target=stopped, args=(error,))
            thread.start()
            thread.join()
        err = capsys.readouterr().err
        assert words in err and bool(err) == bool(words)


def test_a_bug_keeps_its_traceback(fakes, fake_run, tmp_path):
    fake_run.error = ZeroDivisionError("ours")
    with pytest.raises(ZeroDivisionError):
        main([*RUN, "--out", str(tmp_path)])


def test_debugging_shows_the_traceback_of_a_users_error_too(fakes, fake_run, tmp_path, monkeypatch):
    monkeypatch.setenv("HTS_DEBUG", "1")
    fake_run.error = RunError("half-written")
    with pytest.raises(RunError):
        main([*RUN, "--out", str(tmp_path)])


def test_config_show_prints_what_a_run_would_use(fakes, capsys):
    arguments = ["config", "show", *RUN[1:], "--preset", "smoke", "--set", "world.dynamics.trunk_mass_scale=1.08"]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "preset: smoke" in out
    assert "trunk_mass_scale: 1.08" in out


def test_config_schema_is_json(capsys):
    assert main(["config", "schema"]) == 0
    assert json.loads(capsys.readouterr().out)["properties"]["seed"]["type"] == "integer"


def test_plugins_lists_everything_and_what_broke(fakes, install, capsys):
    install("stranger", {"stranger": "import no_such_library"}, {"odd": "stranger"})
    assert main(["plugins"]) == 0
    out = capsys.readouterr().out
    for words in ("twin", "field", "hierarchical", "csv", "hopper", "lab", "stranger (odd): ModuleNotFoundError"):
        assert words in out
    assert main(["plugins", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert {"name": "hopper", "package": "lab", "summary": ""} in data["robots"]
    assert data["broken"] == [
        {
            "entry_point": "odd",
            "package": "stranger",
            "reason": "ModuleNotFoundError: No module named 'no_such_library'",
        }
    ]


COMMAND = '''
from hts import hookimpl
HTS_API = 2

@hookimpl
def hts_commands(register): register("weigh", make)

def make():
    """Say what a robot weighs."""
    def weigh(kilograms: float, pounds: bool = False) -> None:
        """Say it."""
        print(kilograms * 2 if pounds else kilograms)
    return weigh
'''


def test_a_plugin_may_bring_a_command(install, capsys):
    install("scales", {"scales": COMMAND}, {"scales": "scales"})
    assert main(["--help"]) == 0
    assert "Say what a robot weighs. [scales]" in capsys.readouterr().out
    assert main(["weigh", "3.5", "--pounds"]) == 0
    assert capsys.readouterr().out == "7.0\n"


def test_help_works_when_two_plugins_quarrel_and_says_so(install, capsys):
    install("scales", {"scales": COMMAND}, {"scales": "scales"})
    install("balance", {"balance": COMMAND}, {"balance": "balance"})
    assert main(["--help"]) == 0
    assert "Two commands are named 'weigh'" in " ".join(capsys.readouterr().out.split())
    assert main(["plugins"]) == 2
    assert "balance" in one_line_of(capsys)


@pytest.mark.parametrize("command", [["export", "--to", "new.onnx"], ["play", "--video", "new.mp4"]])
def test_without_a_run_a_policy_file_must_be_named(command, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hts.play._prepare_drawing", lambda: None)
    assert main(command) == 2
    assert "Give one: DIR, or --policy FILE.safetensors." in one_line_of(capsys)
    assert main([*command, "--policy", "best"]) == 2
    assert "best: expected a policy file that exists" in one_line_of(capsys)
    assert list(tmp_path.iterdir()) == []
