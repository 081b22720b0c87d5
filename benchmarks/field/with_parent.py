"""`python with_parent.py PARENT MODULE ARGUMENTS`: a module as `python -m`, killed when the process PARENT is gone."""

from __future__ import annotations

import ctypes
import os
import runpy
import signal
import sys

DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG of Linux; elsewhere a killed operator leaves what it started

if __name__ == "__main__":
    del sys.path[0]  # this folder
    parent, module = int(sys.argv[1]), sys.argv[2]
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(DIE_WITH_PARENT, signal.SIGKILL)
        if os.getppid() != parent:  # it was quicker
            sys.exit(1)
    del sys.argv[:2]
    runpy.run_module(module, run_name="__main__", alter_sys=True)
