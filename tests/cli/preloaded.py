"""python preloaded.py MODULES COMMAND...: a command whose `hts` need not load the same modules again and again.

MODULES: imported first, separated by commas. Then COMMAND runs, and finds two pipes, $HTS_ASKED and $HTS_ANSWERED: into
the first go the id of a process, a folder and the words of a command line, each ended by a zero byte; `hts` runs in a
child of this process, in that folder, with the output of that process; its exit status comes back as a line. No words
end it, and COMMAND's status is the exit status.
"""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

from hts.cli.main import main


def run(process: str, folder: str, words: list[str]) -> int:
    """Exit status of `hts` with these words."""
    child = os.fork()
    if not child:
        status = 1
        try:
            os.chdir(folder)
            for stream in (1, 2):
                os.dup2(os.open(f"/proc/{process}/fd/{stream}", os.O_WRONLY | os.O_APPEND), stream)
            status = main(words)
            sys.stdout.flush()
        except BaseException:  # noqa: BLE001 - ends the child, as it would end a process of its own
            traceback.print_exc()
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def serve(modules: str, command: list[str]) -> int:
    for name in filter(None, modules.split(",")):
        importlib.import_module(name)
    with tempfile.TemporaryDirectory() as folder:
        asked, answered = Path(folder, "asked"), Path(folder, "answered")
        for pipe in (asked, answered):
            os.mkfifo(pipe)
        names = {"HTS_ASKED": str(asked), "HTS_ANSWERED": str(answered)}
        with subprocess.Popen(command, env={**os.environ, **names}) as started:
            while request := asked.read_text().split("\0")[:-1]:
                process, place, *words = request
                answered.write_text(f"{run(process, place, words)}\n")
        return started.returncode


if __name__ == "__main__":
    sys.exit(serve(sys.argv[1], sys.argv[2:]))
