"""Standard output that nobody reads, that is full or has no words for a name, and signals that end a run."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys

import pytest

SCRIPT = """
import sys, time
from pathlib import Path
import typer
import hts.cli.group
from hts.cli.main import main
from hts.cli.one_line import resumable
from hts.guarded import guarded
from hts.run.progress import Progress

folder = Path(sys.argv[1])

def work():
{work}

class Group:
    def main(self, **given):
        try:
            with resumable(folder):
                return work()
        except typer.Exit as end:
            return end.exit_code

hts.cli.group.hts_group = Group
sys.exit(main(["run"]))
"""
TELLS = """
    def collect():
        for i in range(400):
            Progress(1).say("a line of many " * 20)
    guarded("World 'far': collect()", collect)
    (folder / "done").touch()
"""
WAITS = """
    try:
        print("ready", flush=True)
        time.sleep(60)
    finally:
        (folder / "cleared").touch()
"""

INTERRUPTED = """
    try:
        print("ready", flush=True)
        time.sleep(60)
    except KeyboardInterrupt as error:
        raise ImportError("numpy.core.multiarray failed to import") from error
"""
SLOWLY = """
    try:
        print("ready", flush=True)
        time.sleep(60)
    finally:
        print("ready", flush=True)
        time.sleep(60)
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "config.yaml").touch()
    return tmp_path


def hears():
    """A suite that a shell began in the background ignores Ctrl-C, one after `nohup` a hang-up; children inherit it."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def began(folder, work, **given):
    command = [sys.executable, "-c", SCRIPT.format(work=work), str(folder)]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **{"preexec_fn": hears, **given})


def hts(*arguments, **given):
    command = [sys.executable, "-m", "hts.cli.main", *arguments]
    return subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False, timeout=300, **given)


def test_a_run_whose_reader_is_gone_stops_with_a_line_that_blames_nobody_else(folder):
    reader, writer = os.pipe()
    run = began(folder, TELLS, stdout=writer)
    os.close(writer)
    os.read(reader, 10)
    os.close(reader)
    _, err = run.communicate(timeout=300)
    said = "nobody reads it any more. Write it to a file, such as with `> FILE`."
    assert err == f"error: standard output: {said} `hts resume {folder}` then goes on.\n"
    assert run.returncode == 2 and not (folder / "done").exists()


def test_a_run_whose_terminal_is_gone_goes_on(folder):
    master, terminal = pty.openpty()
    run = began(folder, TELLS, stdout=terminal)
    os.close(terminal)
    os.read(master, 10)
    os.close(master)
    _, err = run.communicate(timeout=300)
    assert (run.returncode, err) == (0, "")
    assert (folder / "done").exists()


def test_a_full_disk_under_standard_output_is_not_told_of_the_runs_folder(folder):
    with open("/dev/full", "w") as full:
        run = began(folder, TELLS, stdout=full)
        _, err = run.communicate(timeout=300)
    assert err.startswith("error: standard output: the disk is full.") and err.count("\n") == 1, err
    assert f"`hts resume {folder}` then goes on" in err
    assert run.returncode == 2


@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["plugins"]])
def test_what_cannot_be_printed_is_one_line(arguments):
    with open("/dev/full", "w") as full:
        done = hts(*arguments, stdout=full)
    assert done.stderr.startswith("error: standard output: the disk is full.") and done.stderr.count("\n") == 1
    assert done.returncode == 2


def test_a_command_whose_reader_has_read_enough_says_nothing():
    reader, writer = os.pipe()
    os.close(reader)
    done = hts("plugins", stdout=writer)
    os.close(writer)
    assert (done.stderr, done.returncode) == ("", 1)


@pytest.mark.parametrize(
    ("encoding", "shown"),
    [("latin-1", b"\xfc \\u03bb \xff\n"), ("utf-8", "ü λ ".encode() + b"\xff\n"), ("ascii:replace", b"? ? ?\n")],
)
def test_what_an_encoding_has_no_words_for_is_printed_as_an_escape(folder, encoding, shown):
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(work='    print("\\u00fc \\u03bb \\udcff")'), str(folder)],
        capture_output=True,
        check=False,
        env={**os.environ, "PYTHONIOENCODING": encoding},
    )
    assert (run.returncode, run.stderr, run.stdout) == (0, b"", shown)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_run_that_is_told_to_end_says_how_to_go_on_and_clears_up(folder, number):
    run = began(folder, WAITS, stdout=subprocess.PIPE)
    assert run.stdout.readline() == "ready\n"
    run.send_signal(number)
    _, err = run.communicate(timeout=300)
    assert err == f"\nstopped by {number.name}: `hts resume {folder}` goes on\n"
    assert run.returncode == 128 + number
    assert (folder / "cleared").exists()


@pytest.mark.parametrize(
    ("number", "status", "by"), [(signal.SIGTERM, 143, " by SIGTERM"), (signal.SIGINT, 130, "")], ids=["TERM", "INT"]
)
def test_a_library_that_makes_an_error_of_its_own_of_the_end_shows_no_traceback(folder, number, status, by):
    run = began(folder, INTERRUPTED, stdout=subprocess.PIPE)
    assert run.stdout.readline() == "ready\n"
    run.send_signal(number)
    _, err = run.communicate(timeout=300)
    assert (run.returncode, err) == (status, f"\nstopped{by}: `hts resume {folder}` goes on\n")


def test_a_second_ctrl_c_ends_the_clearing_up_too(folder):
    run = began(folder, SLOWLY, stdout=subprocess.PIPE)
    for _ in range(2):
        assert run.stdout.readline() == "ready\n"
        run.send_signal(signal.SIGINT)
    _, err = run.communicate(timeout=300)
    assert (run.returncode, err) == (130, f"\nstopped: `hts resume {folder}` goes on\n")


def test_a_run_after_nohup_hears_of_no_terminal(folder):
    run = began(folder, WAITS, stdout=subprocess.PIPE, preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
    assert run.stdout.readline() == "ready\n"
    run.send_signal(signal.SIGHUP)
    with pytest.raises(subprocess.TimeoutExpired):
        run.wait(timeout=1)
    run.send_signal(signal.SIGTERM)
    _, err = run.communicate(timeout=300)
    assert "stopped by SIGTERM" in err


def ended(code):
    """Status and errors of a Python that runs it."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    return done.returncode, done.stderr


def test_ctrl_c_while_modules_are_imported_shows_no_traceback():
    code = (
        "import sys\n"
        "class Stop:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'typer': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Stop())\n"
        "from hts.cli.main import main\n"
        "sys.exit(main(['plugins']))\n"
    )
    assert ended(code) == (130, "")


def test_ctrl_c_of_which_an_import_makes_an_error_of_its_own_shows_no_traceback():
    code = (
        "import os, signal, sys\n"
        "class Stop:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name != 'hts.cli.group': return\n"
        "        try: os.kill(os.getpid(), signal.SIGINT)\n"
        "        except KeyboardInterrupt as error: raise ImportError('initialization failed') from error\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)  # the suite may ignore it\n"
        "sys.meta_path.insert(0, Stop())\n"
        "from hts.cli.main import main\n"
        "sys.exit(main(['plugins']))\n"
    )
    assert ended(code) == (130, "")
